"""Embedded discrepancy: a smooth factor on the coefficient where no mechanism explains the data.

The covariate is found by likelihood, its p by simulation over all covariates that were tried. A
short formula may fit as well as the curve: line, exponential, power law, logarithm, step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.smooth_factor import (
    LEVEL_SD,
    SPEED,
    Fitted,
    Form,
    Problem,
    Response,
    Track,
    left_out_error,
    speed_curve,
    sums_of,
    track_along,
)
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.inference.structure import SIGNIFICANCE
from slipstitch.criticise.measurements import Measurements

AS_WELL_BIC, MOST_EDGES, LEAST_FACTOR = 2.0, 40, 0.02
# How a formula calls a covariate, and where its factor is 1; else in the middle of the range.
SYMBOLS = {"pos_x_mm": "x", "clock_min": "t", "speed_mm_s": "v", "load_ratio": "p/p0"}
REFERENCE = {"speed_mm_s": 10.0, "load_ratio": 1.0}
ALONG = ("pos_x_mm", "clock_min", "speed_mm_s", "load_ratio")
REACH = 1.96  # of a 95 % band, in standard deviations


def _shapes(track: Track, edge: float) -> dict[str, tuple[Callable, Callable, Callable]]:
    """Short formulas along a covariate, each in one parameter a, a step at ``edge``.

    By name: g of the plain covariate and a, the text, and what is said of a.
    """
    name, symbol = track.covariate.name, SYMBOLS[track.covariate.name]
    plain = track.plain_knots
    span = float(np.ptp(plain))
    at = REFERENCE.get(name, float(f"{(plain[0] + plain[-1]) / 2:.2g}"))
    unit = "" if name == "load_ratio" else f" {track.covariate.unit}"
    over = symbol if name == "load_ratio" else f"{symbol}/({at:g}{unit})"
    apart = f"({symbol} - {at:g}{unit})"

    def slope(a):
        return a / span

    def signed(a):
        return f"{'-' if a < 0 else '+'} {abs(a):.3g}"

    def line(c, a, scaled=lambda c: (c - at) / span):
        return np.log(np.maximum(1.0 + a * scaled(c), LEAST_FACTOR))

    def exponential(a):
        length = f"{span / max(abs(a), 1e-9):.3g}{unit}"
        length = f"({length})" if unit else length
        return f"mu exp({'-' if a < 0 else ''}{apart}/{length})"

    per_unit = f"/{unit[1:]}" if unit else ""
    shapes = {
        "line": (line, lambda a: f"mu (1 {signed(slope(a))}{per_unit} {apart})", slope),
        "exponential": (lambda c, a: a * (c - at) / span, exponential, slope),
    }
    if track.covariate.logarithmic:
        shapes["power law"] = (
            lambda c, a: a * np.log(c / at),
            lambda a: f"mu ({over})^{a:.3g}",
            float,
        )
        shapes["logarithm"] = (
            lambda c, a: line(c, a, lambda c: np.log10(c / at)),
            lambda a: f"mu (1 {signed(a)} log10({over}))",
            float,
        )
    shapes["step"] = (
        lambda c, a: a * (c > edge),
        lambda a: f"mu, {np.exp(a):.3g} mu where {symbol} > {edge:g}{unit}",
        np.exp,
    )
    return shapes


def _edge(track: Track, curve: Fitted) -> float:
    """Where a step gains most likelihood, beside the curve's scatter."""
    levels = np.unique(np.round(track.values[track.recorded], 6))
    edges = 0.5 * (levels[1:] + levels[:-1])
    edges = edges[np.linspace(0, len(edges) - 1, min(len(edges), MOST_EDGES)).astype(int)]
    beyond = track.recorded[:, None] & (np.where(track.recorded, track.values, 0)[:, None] > edges)
    columns = [curve.columns[:, ~curve.curve], beyond * curve.sensitivity[:, None]]
    base = columns[0].shape[1]
    gram, score, _ = sums_of(replace(curve, columns=np.column_stack(columns)))
    ridge = np.where(curve.random[~curve.curve], 1.0, LEVEL_SD**-2)
    gains = []
    for k in range(len(edges)):
        own = np.r_[np.arange(base), base + k]
        inner = gram[np.ix_(own, own)] + np.diag([*ridge, LEVEL_SD**-2])
        gains.append(score[own] @ np.linalg.solve(inner, score[own]))
    edge = edges[int(np.argmax(gains))]
    return float(f"{10**edge if track.covariate.logarithmic else edge:.3g}")


def rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def short_formula(
    problem: Problem, track: Track, curve: Fitted, names: list[str], reach: float
) -> tuple[dict | None, list[str]]:
    """The best named shape, if it fits as well as the curve by BIC (size and length: two).

    Its coefficients are those where it is 1. And the names of those whose fit did not converge.
    """
    cost = np.log(max(problem.state.measurements.runs, 2))
    limit = -2 * curve.log_likelihood + 2 * cost
    best, unknown = None, []
    for name, (g, *written) in _shapes(track, _edge(track, curve)).items():
        form = Form(track, lambda plain, values, g=g: g(plain, float(values[0])), np.zeros(1), None)
        found = problem.fit(form)
        if not found.converged:
            unknown.append(name)
            continue
        # The place of a step was set beforehand.
        bic = -2 * found.log_likelihood + (2 if name == "step" else 1) * cost
        if best is None or bic < best[0]:
            best = bic, name, written, found
    if best is None or best[0] > limit + AS_WELL_BIC:
        return None, unknown
    bic, name, (text, said), found = best
    value, half = float(found.values[0]), float(reach * np.sqrt(found.covariance[-1, -1]))
    low, estimate, high = rounded(np.sort([said(value + step) for step in (-half, 0.0, half)]))
    formula = {
        "text": text(value),
        "shape": name,
        "parameter": estimate,
        "ci95": [low, high],
        "coefficients": dict(zip(names, rounded(np.exp(found.level)), strict=True)),
        "delta_bic": round(float(bic - limit), 2),
    }
    return formula, unknown


def along(found: dict, places, factors=None) -> np.ndarray:
    """The factor at plain values of its covariate, by its knots."""
    covariate = COVARIATES[found["covariate"]]
    knots = covariate.searched(np.array(found["knots"]))
    logs = np.log(found["factors"] if factors is None else factors)
    return np.exp(np.interp(covariate.searched(np.asarray(places, float)), knots, logs))


def specimen_factors(found: dict, measurements: Measurements, state: State) -> pd.DataFrame:
    """What specimens say of the factor: protocol, specimen, ``at`` a place, their mean ``factor``.

    Many places are drawn together into as many as there are knots at most.
    """
    m, problem = measurements, Problem(state)
    track = track_along(problem, found["covariate"])
    if track is None:
        return pd.DataFrame({"protocol": [], "at": [], "factor": []})
    names = [p.name for p in m.null_parameters]
    level = np.log([found["coefficients"][name] for name in names])
    g = np.where(track.recorded, np.log(along(found, track.plain)), 0.0)
    prediction, d = problem.response.at(level, g)
    shown = track.recorded & ~m.lower_bound & (np.abs(d) > 2.0 * m.u)
    table = pd.DataFrame(
        {
            "protocol": m.protocol[shown],
            "specimen": m.specimen[shown],
            "knot": track.hats[shown].argmax(axis=1),
            "at": track.plain[shown],
            "factor": np.exp(g[shown] + ((m.y - prediction) / np.where(d, d, 1.0))[shown]),
        }
    )
    by = ["protocol", "specimen", "knot"]
    return table.groupby(by, as_index=False)[["at", "factor"]].mean()


def predicted_with(
    found: dict, design: Measurements, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """What a design's instruments read with the factor, and the sd of its logarithm, (n,) each.

    ``values`` are logarithms of coefficients, replaced by those that stand in ``found``.
    """
    own = {name: float(np.log(value)) for name, value in found["coefficients"].items()}
    values = {name: own.get(name, value) for name, value in values.items()}
    places = design.rows[found["covariate"]].to_numpy(float)
    acts = np.isfinite(places) & design.of_friction
    places = np.where(acts, places, found["knots"][0])
    low, high = (along(found, places, band) for band in np.array(found["ci95"]).T)
    sd = np.where(acts, np.log(high / low) / (2 * REACH), 0.0)
    if found["covariate"] == SPEED:
        curve = speed_curve(found["knots"], found["factors"])
        return design.predict(values, (), curve=curve), sd
    response = Response(design, values)
    return response.at(response.level, np.log(along(found, places)) * acts)[0], sd


def discrepancy_words(found: dict | None) -> str:
    """What :func:`embedded_discrepancy` found, in a sentence."""
    if not found or not found["tried"]:
        return ""
    failed = found.get("not_converged", [])
    unused = f" The fit along {_listed(failed)} did not converge and is not used." if failed else ""
    if found["covariate"] is None:
        rest = [name for name in found["tried"] if name not in failed]
        if not rest:
            return f"Whether a smooth factor takes any of it away is not known.{unused}"
        along_none = f"No smooth factor on the coefficient along {_listed(rest)}"
        return f"{along_none} takes any of it away.{unused}"
    formula = found["formula"]
    short = f"{formula['text']} fits as well" if formula else "no short formula fits as well"
    if not formula and (unknown := found.get("shapes_not_converged")):
        short += f" (not known of {', '.join(unknown)}: the fit did not converge)"
    return (
        f"A smooth factor on the coefficient along the {COVARIATES[found['covariate']].title}, "
        f"{min(found['factors']):.2f} to {max(found['factors']):.2f}, takes away "
        f"{100 * found['misfit_share']:.0f} % of the squared error on specimens left out; {short}."
        f"{unused}"
    )


def _listed(names: list[str]) -> str:
    titles = [COVARIATES[name].title for name in names]
    return " or ".join(filter(None, [", ".join(titles[:-1]), titles[-1]]))


def embedded_discrepancy(whole: Measurements, state: State, seed: int = 1) -> dict:
    """The smooth factor that the data ask for beside the null, if any.

    Parameters
    ----------
    whole : the measurements as they were made; ``state`` has those that allow for outliers.
    state : the null and its scatter.
    seed : of the simulated maxima.

    Returns
    -------
    dict
        ``tried`` (covariate -> family-wise p of any smooth curve along it), the ``covariate`` of
        the factor (None where none takes anything away: then nothing follows), ``not_converged``
        (covariates whose fit did not), and the factor in the layout of
        docs/criticise-your-data.md. Its mean logarithm over the features is 0; between ``knots``
        it is linear in its logarithm and, for speed and load, in that of the covariate.
    """
    measurements = state.measurements
    problem = Problem(state)
    tracks = [track for name in ALONG if (track := track_along(problem, name)) is not None]
    tried = _tried(problem, tracks, np.random.default_rng(seed))
    plain = problem.fit(None) if tracks else None
    fitted = [(track, problem.fit(track.smooth())) for track in tracks]
    failed = [t.covariate.name for t, c in fitted if not (c.converged and plain.converged)]

    def nothing() -> dict:
        found = {"covariate": None, "tried": {name: round(p, 5) for name, p in tried.items()}}
        return found | ({"not_converged": failed} if failed else {})

    usable = [(track, curve) for track, curve in fitted if track.covariate.name not in failed]
    if not usable:
        return nothing()
    track, curve = max(usable, key=lambda pair: pair[1].log_likelihood)
    name = track.covariate.name
    errors = [left_out_error(measurements, model, track.recorded) for model in (plain, curve)]
    share = 1.0 - (errors[1] / errors[0]) ** 2
    if tried[name] > SIGNIFICANCE or not share > 0:
        return nothing()
    everything = Problem(replace(state, measurements=whole, scatters=curve.scatters))
    beside = everything.fit((track_along(everything, name) or track).smooth())
    if not beside.converged:
        failed.append(name)
        return nothing()
    # The factor's mean logarithm over the features goes into the coefficients.
    weights = track.hats[track.recorded].mean(axis=0)
    mean = weights @ curve.values
    centred = np.eye(len(weights)) - weights
    own = np.flatnonzero(curve.curve)
    covariance = centred @ curve.covariance[np.ix_(own, own)] @ centred.T
    reach = float(student.ppf(0.975, max(measurements.specimens - 2, 3)))
    half = reach * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    log_factors = curve.values - mean
    low, high = rounded(np.exp(log_factors - half)), rounded(np.exp(log_factors + half))
    names = [p.name for p in measurements.null_parameters]
    formula, unknown = short_formula(problem, track, curve, names, reach)
    return nothing() | {
        "covariate": name,
        "unit": track.covariate.unit,
        "p_adjusted": round(tried[name], 5),
        "knots": rounded(track.plain_knots),
        "factors": rounded(np.exp(log_factors)),
        "ci95": [list(band) for band in zip(low, high, strict=True)],
        "coefficients": dict(zip(names, rounded(np.exp(curve.level + mean)), strict=True)),
        # Beside the factor, outliers included: for prediction.
        "scatter": {p: list(s) for p, s in beside.scatters.items()},
        # Of features of left-out specimens, relative to friction.
        "rmse_null": round(errors[0], 5),
        "rmse_extended": round(errors[1], 5),
        "misfit_share": round(share, 4),
        "formula": formula,
        **({"shapes_not_converged": unknown} if unknown else {}),
    }


def _tried(problem: Problem, tracks, rng) -> dict[str, float]:
    """Family-wise p of a smooth curve along every covariate, in any protocol or in all."""
    if not tracks:
        return {}
    tests = [track.test(problem.state, problem.usable) for track in tracks]
    outcome = replace(problem.state, tests=tests).outcome(rng, 500, (SIGNIFICANCE,))
    found: dict[str, float] = {}
    for test, p in zip(outcome.tests, outcome.adjusted, strict=True):
        name = str(test.covariate)
        found[name] = min(found.get(name, 1.0), float(p))
    return found
