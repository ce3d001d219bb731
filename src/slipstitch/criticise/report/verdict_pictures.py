"""The pictures of a verdict's page."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, plain_text, styled
from slipstitch.base.page.palette import BLUE, FAINT, INK, INTERVAL, PALE, SERIES, VERMILION
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.discrepancy import along, specimen_factors
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.mixed_model import total_variance
from slipstitch.criticise.protocols import QUANTITIES
from slipstitch.criticise.verdict import Analysis

QUANTITY = "quantity"
COLUMNS = 3  # of the picture of all covariates
MOST_LABELS = 6
SHOWN_RUNS = 3
MODELS = {"null": (VERMILION, "plain Coulomb"), "extended": (BLUE, "extended law")}


def _figure(width: float = 6.4, height: float = 3.4) -> tuple[Figure, Axes]:
    figure = new_figure(width, height)
    return figure, figure.add_subplot()


def telling_covariate(analysis: Analysis) -> str:
    """The covariate along which the model's failure is seen best."""
    if analysis.explanation:
        return MECHANISMS[analysis.explanation.causes[0]].covariate or QUANTITY
    outcome = analysis.left_over or analysis.null_outcome
    strongest = outcome.strongest("generic")
    return QUANTITY if strongest is None else outcome.tests[strongest].covariate or QUANTITY


def drawn(analysis: Analysis, name: str) -> np.ndarray:
    """A covariate as it is drawn, (n,); NaN where it was not recorded."""
    covariate, column = COVARIATES[name], analysis.measurements.rows[name]
    if covariate.text:
        labels = sorted({label for label in column if label})
        codes = pd.Categorical(column, labels).codes.astype(float)
        return codes + np.where(column == "", np.nan, 0)
    values = column.to_numpy(float)
    if covariate.logarithmic:
        return np.log10(np.where(values > 0, values, np.nan))
    return np.mod(values, 360.0) if covariate.periodic else values


def relative_residuals(analysis: Analysis, fitted: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Residuals in percent of friction, and the features for which that has a meaning."""
    m = analysis.measurements
    d = analysis.state.sensitivity
    good = analysis.state.measurements.usual & ~m.lower_bound & (np.abs(d) > 2.0 * m.u)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(good, 100 * (m.y - fitted.prediction) / d, np.nan), good


def standardised_residuals(analysis: Analysis, fitted: Fit) -> np.ndarray:
    """Residuals over their own total standard deviation."""
    m, state = analysis.measurements, analysis.state
    variance = total_variance(m.protocol, m.u, state.sensitivity, state.scatters)
    return (m.y - fitted.prediction) / np.sqrt(variance)


def series(axes, x, y, colour, label, seed=0):
    """Points, with means and their standard errors over levels or eighths of a covariate."""
    jitter = np.random.default_rng(seed).uniform(-0.008, 0.008, len(x))
    span = np.ptp(x) or 1.0
    axes.plot(x + jitter * span, y, "o", ms=3, color=colour, alpha=0.35, mew=0)
    levels, group = np.unique(np.round(x, 6), return_inverse=True)
    if len(levels) > 12:
        edges = np.unique(np.quantile(x, np.linspace(0, 1, 9)))
        group = np.searchsorted(edges, x, side="right").clip(1, max(len(edges) - 1, 1))
    table = pd.DataFrame({"x": x, "y": y}).groupby(group)
    means, error = table.mean(), (table["y"].std() / np.sqrt(table.size())).fillna(0.0)
    axes.errorbar(
        means["x"],
        means["y"],
        error,
        color=colour,
        lw=1.8,
        marker="o",
        ms=5,
        label=label,
        capsize=2,
    )


def _fits(analysis: Analysis) -> list[tuple[Fit, str, str]]:
    """Each fit that is drawn, with its colour and label."""
    fits, named = [(analysis.null, VERMILION, "plain Coulomb")], analysis.explanation
    return [*fits, (named.fitted, BLUE, "extended")] if named else fits


def _by_quantity(axes, analysis, fits):
    quantity = analysis.measurements.rows["quantity"].to_numpy()
    keep = analysis.state.measurements.usual
    names = [name for name in QUANTITIES if (quantity == name).any()]
    for k, (fitted, colour, label) in enumerate(fits):
        z = standardised_residuals(analysis, fitted)
        for i, name in enumerate(names):
            own, place = z[(quantity == name) & keep], i + (k - 0.5 * (len(fits) - 1)) * 0.28
            places, shown = np.full(len(own), place), np.clip(own, -8, 8)
            axes.plot(places, shown, "_", color=colour, alpha=0.5, ms=9)
            mean = [np.clip(own.mean(), -8, 8)]
            axes.plot([place], mean, "o", color=colour, ms=6, label=None if i else label)
    titles = [QUANTITIES[name].title for name in names]
    axes.set_xticks(range(len(names)), titles, rotation=35, ha="right")
    axes.set_ylabel("measured − model, in standard deviations")


@styled
def residual_picture(analysis: Analysis) -> Figure:
    """Residuals of the null (and of the extended model) against the telling covariate."""
    covariate = telling_covariate(analysis)
    figure, axes = _figure()
    fits = _fits(analysis)
    if covariate == QUANTITY or COVARIATES[covariate].text:
        _by_quantity(axes, analysis, fits)
    else:
        values = drawn(analysis, covariate)
        for fitted, colour, label in fits:
            residual, good = relative_residuals(analysis, fitted)
            good &= np.isfinite(values)
            if good.any():
                series(axes, values[good], residual[good], colour, label)
        if analysis.verdict == "unknown":
            pattern(axes, analysis, covariate, analysis.left_over or analysis.null_outcome)
        axes.set_xlabel(COVARIATES[covariate].axis_label)
        axes.set_ylabel("measured − model (% of friction)")
    axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False)
    return figure


def pattern(axes, analysis, covariate, outcome):
    """The shape that the strongest test along a covariate found, drawn through the residuals."""
    best = outcome.strongest_shapes().get(covariate)
    if best is None:
        return
    residual, good = relative_residuals(analysis, analysis.null)
    values = drawn(analysis, covariate)
    good &= np.isfinite(values) & np.isfinite(residual)
    shape = outcome.tests[best].columns[good] / analysis.state.sensitivity[good][:, None]
    columns = np.column_stack([np.ones(good.sum()), shape])
    size, *_ = np.linalg.lstsq(columns, residual[good], rcond=None)
    x, curve = values[good], size[0] + shape @ size[1:]
    order = np.argsort(x)
    axes.plot(x[order], curve[order], color=INK, lw=2, label=outcome.tests[best].shape)


@styled
def ranking_picture(verdict: dict, most: int = 10) -> Figure:
    """How far each rival lies behind the best."""
    entries = verdict["ranking"]
    shown = entries[:most]
    if not any(entry["model"] == [] for entry in shown):
        shown = shown[: most - 1] + [entry for entry in entries if entry["model"] == []]
    figure, axes = _figure(height=0.34 * len(shown) + 0.9)
    labels = [" + ".join(entry["model"]) or "plain Coulomb" for entry in shown]
    places = np.arange(len(shown))[::-1]
    tied = [sorted(causes) for causes in verdict["alternatives"]]
    colours = [
        VERMILION if not e["model"] else BLUE if sorted(e["model"]) in tied else PALE for e in shown
    ]
    values = [max(entry["delta_bic"], 0.15) for entry in shown]
    axes.barh(places, values, color=colours, height=0.65)
    axes.set_xscale("symlog", linthresh=10)
    axes.set_yticks(places, labels)
    axes.axvline(6, color=INK, lw=0.8, ls=":")
    axes.set_xlabel("BIC relative to the best (dotted: 6)")
    return figure


@styled
def prediction_picture(analysis: Analysis) -> Figure:
    """Standardised residuals of all features, null and extended, against a standard normal."""
    figure, axes = _figure()
    edges = np.linspace(-6, 6, 41).tolist()
    for fitted, colour, label in _fits(analysis):
        z = standardised_residuals(analysis, fitted)
        z = z[analysis.state.measurements.usual & ~analysis.measurements.lower_bound]
        if len(z):  # else bounds only
            axes.hist(
                np.clip(z, -5.99, 5.99),
                edges,
                density=True,
                histtype="stepfilled",
                alpha=0.35,
                color=colour,
                label=label,
            )
    x = np.linspace(-6, 6, 200)
    normal = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    axes.plot(x, normal, color=INK, lw=1.2, label="if the model is correct")
    axes.set_xlabel("measured − model, in standard deviations (beyond ±6 at the edge)")
    axes.set_yticks([])
    axes.legend(frameon=False)
    return figure


@styled
def covariate_picture(analysis: Analysis) -> Figure | None:
    """A panel a covariate, with the strongest shape that was tested along it and its p.

    None where no covariate was recorded at more than one level.
    """
    panels = []
    residual, good = relative_residuals(analysis, analysis.null)
    for name, covariate in COVARIATES.items():
        x = drawn(analysis, name)
        shown = good & np.isfinite(x) & np.isfinite(residual)
        if len(np.unique(x[shown])) > 1:
            panels.append((covariate, x[shown], residual[shown]))
    if not panels:
        return None
    rows, outcome = -(-len(panels) // COLUMNS), analysis.null_outcome
    strongest = outcome.strongest_shapes()
    figure = new_figure(9.0, 2.5 * rows)
    grid = figure.subplots(rows, COLUMNS, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    for axes, (covariate, x, y) in zip(grid.flat, panels, strict=False):
        series(axes, x, y, VERMILION, None)
        if covariate.name in strongest:
            p = outcome.adjusted[strongest[covariate.name]]
            axes.set_title(f"p = {p:.2g}", color=INK if p < 0.05 else FAINT)
        if covariate.text:
            labels = sorted(set(analysis.measurements.rows[covariate.name]) - {""})
            axes.set_xticks(range(len(labels)), map(plain_text, labels))
        else:
            pattern(axes, analysis, covariate.name, outcome)
        axes.set_xlabel(covariate.axis_label)
        axes.axhline(0, color=FAINT, lw=0.8, zorder=0)
        axes.tick_params(labelsize=8)
    for row in grid:
        row[0].set_ylabel("% of friction")
    return figure


@styled
def discrepancy_picture(found: dict, analysis: Analysis) -> Figure:
    """``found`` is the verdict's ``discrepancy`` with a covariate."""
    figure, axes = _figure()
    covariate = COVARIATES[found["covariate"]]
    first, last = covariate.searched(np.array(found["knots"])[[0, -1]])
    fine = np.linspace(float(first), float(last), 201)
    plain = 10**fine if covariate.logarithmic else fine
    low, high = (along(found, plain, band) for band in np.array(found["ci95"]).T)
    axes.fill_between(plain, low, high, color=INTERVAL, label="95 %")
    axes.plot(plain, along(found, plain, found["factors"]), color=INK, lw=2, label="smooth factor")
    points = specimen_factors(found, analysis.measurements, analysis.null_state)
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


@styled
def before_and_after_picture(frames: pd.DataFrame) -> Figure:
    change = (frames["te_x_mm_null"] - frames["te_x_mm_extended"]).abs()
    order = change.groupby(frames["run_id"]).mean().sort_values(kind="stable").index
    chosen = [order[i] for i in np.linspace(len(order) - 1, 0, SHOWN_RUNS).astype(int)]
    figure = new_figure(7.2, 4.2)
    panels = figure.subplots(2, SHOWN_RUNS, sharex=True, sharey="row", squeeze=False)
    for column, run in enumerate(chosen):
        own = frames[frames["run_id"] == run].sort_values("x_stage_mm")
        stage = own["x_stage_mm"].to_numpy()
        shown = (("te_x_mm", stage, -1.0), ("contact_len_mm", 0.0, 1.0))
        for axes, (quantity, base, sign) in zip(panels[:, column], shown, strict=True):
            axes.plot(stage, base + sign * own[quantity], ".", color=FAINT, ms=4)
            for name, (colour, label) in MODELS.items():
                values = base + sign * own[f"{quantity}_{name}"]
                axes.plot(stage, values, color=colour, lw=1.4, label=label)
            axes.tick_params(labelsize=8)
        panels[0, column].set_title(plain_text(f"run {run}"))
        panels[1, column].set_xlabel("stage (mm)")
    panels[0, 0].set_ylabel("lag of the edge (mm)")
    panels[1, 0].set_ylabel("contact length (mm)")
    panels[0, 0].legend(frameon=False, fontsize=8, loc="lower right")
    return figure
