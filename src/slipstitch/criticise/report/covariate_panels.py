"""Residuals of plain Coulomb friction against every recorded covariate, in one picture."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, plain_text, styled
from slipstitch.base.page.palette import FAINT, INK
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.structure import Outcome
from slipstitch.criticise.report.verdict_pictures import (
    NULL_COLOUR,
    drawn,
    pattern,
    relative_residuals,
    series,
)
from slipstitch.criticise.verdict import Analysis

COLUMNS = 3


@styled
def covariate_picture(analysis: Analysis) -> Figure | None:
    """A panel a covariate, with the strongest shape that was tested along it and its p.

    None where no covariate was recorded at more than one level.
    """
    panels = []
    residual, good = relative_residuals(analysis, analysis.null)
    for name in COVARIATES:
        x = drawn(analysis, name)
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
            if not COVARIATES[name].text:
                pattern(axes, analysis, name, outcome)
        axes.set_xlabel(COVARIATES[name].axis_label)
        if COVARIATES[name].text:
            labels = sorted({label for label in analysis.measurements.rows[name] if label})
            axes.set_xticks(range(len(labels)), map(plain_text, labels))
        axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
        axes.tick_params(labelsize=8)
    for row in grid:
        row[0].set_ylabel("% of friction")
    return figure


def _strongest(outcome: Outcome, name: str) -> int | None:
    own = [
        i
        for i, test in enumerate(outcome.tests)
        if test.covariate == name and test.family == "generic" and np.isfinite(outcome.log_p[i])
    ]
    return max(own, key=lambda i: outcome.log_p[i], default=None)
