"""Residuals of plain Coulomb friction against every recorded covariate, in one picture."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from slipstitch.criticise.inference.analysis import Analysis
from slipstitch.criticise.inference.generic import LABELS, LOGARITHMIC
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.report.verdict_pictures import (
    NULL_COLOUR,
    UNITS,
    pattern,
    relative_residuals,
    series,
)
from slipstitch.page.figures import new_figure, styled
from slipstitch.page.palette import FAINT, INK

COLUMNS = 3


@styled
def covariate_picture(analysis: Analysis) -> Figure | None:
    """A panel a covariate, with the strongest shape that was tested along it and its p.

    None where no covariate was recorded at more than one level.
    """
    panels = []
    residual, good = relative_residuals(analysis, analysis.null)
    for name in LABELS:
        x = _values(analysis, name)
        shown = good & np.isfinite(x) & np.isfinite(residual)
        if len(np.unique(x[shown])) > 1:
            panels.append((name, x[shown], residual[shown]))
    if not panels:
        return None
    rows = -(-len(panels) // COLUMNS)
    figure = new_figure(9.0, 2.5 * rows)
    grid = figure.subplots(rows, COLUMNS, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    outcome = analysis.null_outcome
    for axes, (name, x, y) in zip(grid.flat, panels, strict=False):
        series(axes, x, y, NULL_COLOUR, None)
        found = _strongest(outcome, name)
        if found is not None:
            p = outcome.adjusted[found]
            axes.set_title(f"p = {p:.2g}", color=INK if p < 0.05 else FAINT)
            if name != "operator":
                pattern(axes, analysis, name, outcome)
        log = "log₁₀ " if name in LOGARITHMIC else ""
        unit = f" ({UNITS[name]})" if name in UNITS else ""
        axes.set_xlabel(f"{log}{LABELS[name]}{unit}")
        if name == "operator":
            labels = sorted({o for o in analysis.measurements.rows["operator"] if o})
            axes.set_xticks(range(len(labels)), labels)
        axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
        axes.tick_params(labelsize=8)
    for row in grid:
        row[0].set_ylabel("% of friction")
    return figure


def _values(analysis: Analysis, name: str) -> np.ndarray:
    """A covariate as it is drawn; NaN where it was not recorded."""
    column = analysis.measurements.rows[name]
    if name == "operator":
        labels = sorted({o for o in column if o})
        return pd.Categorical(column, labels).codes.astype(float) + np.where(
            column == "", np.nan, 0
        )
    values = column.to_numpy(float)
    if name in LOGARITHMIC:
        return np.log10(np.where(values > 0, values, np.nan))
    return np.mod(values, 360.0) if name.endswith("_deg") else values


def _strongest(outcome: Outcome, name: str) -> int | None:
    own = [
        i
        for i, test in enumerate(outcome.tests)
        if test.covariate == name and test.family == "generic" and np.isfinite(outcome.log_p[i])
    ]
    return max(own, key=lambda i: outcome.log_p[i], default=None)
