"""The smooth factor on the coefficient with its band, and what each specimen says of it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, styled
from slipstitch.base.page.palette import FAINT, INK, INTERVAL, SERIES
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.discrepancy import along, specimen_factors
from slipstitch.criticise.verdict import Analysis

MOST_LABELS = 6


@styled
def discrepancy_picture(found: dict, analysis: Analysis) -> Figure:
    """``found`` is the verdict's ``discrepancy`` with a covariate."""
    figure = new_figure(6.4, 3.4)
    axes = figure.add_subplot()
    covariate = COVARIATES[found["covariate"]]
    first, last = covariate.searched(np.array(found["knots"])[[0, -1]])
    fine = np.linspace(float(first), float(last), 201)
    plain = 10**fine if covariate.logarithmic else fine
    low, high = np.array(found["ci95"]).T
    axes.fill_between(
        plain, along(found, plain, low), along(found, plain, high), color=INTERVAL, label="95 %"
    )
    axes.plot(plain, along(found, plain, found["factors"]), color=INK, lw=2, label="smooth factor")
    points = specimen_factors(found, analysis.measurements, analysis.null, analysis.null_state)
    for colour, (protocol, own) in zip(SERIES, points.groupby("protocol"), strict=False):
        axes.plot(own["at"], own["factor"], "o", ms=4, mew=0, alpha=0.6, color=colour)
        axes.plot([], [], "o", ms=4, color=colour, label=f"specimens of {protocol}")
    axes.axhline(1, color=FAINT, lw=0.8, zorder=0)
    if covariate.logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        if len(found["knots"]) <= MOST_LABELS:
            axes.set_xticks(found["knots"], minor=False)
            axes.set_xticks([], minor=True)
    unit = f" ({covariate.unit})" if covariate.unit else ""
    axes.set_xlabel(f"{covariate.title}{unit}")
    axes.set_ylabel("factor on the coefficient")
    axes.legend(frameon=False, fontsize=8)
    return figure
