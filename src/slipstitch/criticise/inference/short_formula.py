"""Short formulas for a smooth factor: line, exponential, power law, logarithm, step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from slipstitch.criticise.inference.smooth_factor import (
    LEVEL_SD,
    Fitted,
    Form,
    Problem,
    Track,
    sums_of,
)

AS_WELL_BIC, MOST_EDGES, LEAST_FACTOR = 2.0, 40, 0.02
# How a formula calls a covariate, and where its factor is 1; else in the middle of the range.
SYMBOLS = {"pos_x_mm": "x", "clock_min": "t", "speed_mm_s": "v", "load_ratio": "p/p0"}
REFERENCE = {"speed_mm_s": 10.0, "load_ratio": 1.0}


@dataclass(frozen=True)
class _Shape:
    """A short formula: g of the plain covariate in one parameter, and how it is written.

    ``places`` counts parameters that were set beforehand.
    """

    name: str
    g: Callable[[np.ndarray, float], np.ndarray]
    text: Callable[[float], str]
    parameter: Callable[[float], float]
    places: int = 0


def _shapes(track: Track, edge: float) -> list[_Shape]:
    """The named shapes along a covariate, a step at ``edge``."""
    name, unit = track.covariate.name, track.covariate.unit
    symbol, logarithmic = SYMBOLS[name], track.covariate.logarithmic
    plain = track.plain_knots
    span = float(np.ptp(plain))
    middle = float(f"{(plain[0] + plain[-1]) / 2:.2g}")
    at = REFERENCE.get(name, middle)
    unit = "" if name == "load_ratio" else f" {unit}"
    over = symbol if name == "load_ratio" else f"{symbol}/({at:g}{unit})"
    apart = f"({symbol} - {at:g}{unit})"

    def over_length(length):
        return f"({length:.3g}{unit})" if unit else f"{length:.3g}"

    def signed(a):
        return f"{'-' if a < 0 else '+'} {abs(a):.3g}"

    def line(c, a, scaled=lambda c: (c - at) / span):
        return np.log(np.maximum(1.0 + a * scaled(c), LEAST_FACTOR))

    shapes = [
        _Shape(
            "line",
            line,
            lambda a: f"mu (1 {signed(a / span)}{unit and '/' + unit[1:]} {apart})",
            lambda a: a / span,
        ),
        _Shape(
            "exponential",
            lambda c, a: a * (c - at) / span,
            lambda a: (
                f"mu exp({'-' if a < 0 else ''}{apart}/{over_length(span / max(abs(a), 1e-9))})"
            ),
            lambda a: a / span,
        ),
    ]
    if logarithmic:
        shapes += [
            _Shape(
                "power law",
                lambda c, a: a * np.log(c / at),
                lambda a: f"mu ({over})^{a:.3g}",
                lambda a: a,
            ),
            _Shape(
                "logarithm",
                lambda c, a: line(c, a, lambda c: np.log10(c / at)),
                lambda a: f"mu (1 {signed(a)} log10({over}))",
                lambda a: a,
            ),
        ]
    shapes.append(
        _Shape(
            "step",
            lambda c, a: a * (c > edge),
            lambda a: f"mu, {np.exp(a):.3g} mu where {symbol} > {edge:g}{unit}",
            lambda a: float(np.exp(a)),
            places=1,
        )
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
    cost = np.log(max(problem.measurements.runs, 2))
    limit = -2 * curve.log_likelihood + 2 * cost
    best, unknown = None, []
    for shape in _shapes(track, _edge(track, curve)):

        def log_factor(plain, values, shape=shape):
            return shape.g(plain, float(values[0]))

        found = problem.fit(Form(track, log_factor, np.array([0.0]), None))
        if not found.converged:
            unknown.append(shape.name)
            continue
        bic = -2 * found.log_likelihood + (1 + shape.places) * cost
        if best is None or bic < best[0]:
            best = bic, shape, found
    if best is None or best[0] > limit + AS_WELL_BIC:
        return None, unknown
    bic, shape, found = best
    value, half = float(found.values[0]), float(reach * np.sqrt(found.covariance[-1, -1]))
    ends = np.array([shape.parameter(value + step) for step in (-half, 0.0, half)])
    low, estimate, high = rounded(np.sort(ends))
    formula = {
        "text": shape.text(value),
        "shape": shape.name,
        "parameter": estimate,
        "ci95": [low, high],
        "coefficients": dict(zip(names, rounded(np.exp(found.level)), strict=True)),
        "delta_bic": round(float(bic - limit), 2),
    }
    return formula, unknown
