"""Embedded discrepancy: a smooth factor on the coefficient where no mechanism explains the data.

The coefficient of every feature becomes mu exp(g(c)) in one covariate c. g is piecewise linear
between knots; its values there are Gaussian with covariance tau^2 exp(-(distance / length)^2 / 2)
(Rasmussen and Williams, Gaussian Processes, 2006). tau, length and scatter by restricted maximum
likelihood, the covariate by likelihood, its p by simulation over all covariates that were tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.interpolate import PchipInterpolator
from scipy.stats import t as student

from slipstitch.criticise.covariates import COVARIATES, Covariate
from slipstitch.criticise.inference.alternatives import nuisance_columns
from slipstitch.criticise.inference.clusters import Clusters
from slipstitch.criticise.inference.covariance import Group, Scatter, make_groups, scatter_prior
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.ratio import run_tests
from slipstitch.criticise.inference.scatter import START_SCATTER, estimate_scatter
from slipstitch.criticise.inference.selection import number_of_runs
from slipstitch.criticise.inference.state import State, zeros_of
from slipstitch.criticise.inference.structure import Test
from slipstitch.criticise.measurements import Measurements
from slipstitch.physics.friction_law import Curve
from slipstitch.physics.friction_law.extended_model import CURVES

ALONG = ("pos_x_mm", "clock_min", "speed_mm_s", "load_ratio")
SIGNIFICANCE = 0.04
KNOTS, FEWEST_LEVELS = 16, 3
LENGTHS = (0.12, 0.25, 0.5, 1.0)  # of the covariate's range
SIZES = tuple(np.geomspace(0.01, 1.0, 12))
TESTED_LENGTH, TESTED_COLUMNS = 0.25, 5
LEVEL_SD = 3.0  # of the prior of coefficients and free levels, in ln mu
LOG_SHIFTS = np.linspace(-1.5, 1.5, 13)
ROUNDS, CONVERGED = 40, 0.1  # of log-likelihood, by a whole step
AS_WELL_BIC, MOST_EDGES = 2.0, 40
LEAST_FACTOR, SWELLED_RUN, LARGEST = 0.02, 0.1, 3.0
REACH = 1.96  # of a 95 % band, in standard deviations
STEP = 0.01  # of derivatives by differences
# How a formula calls a covariate, and where its factor is 1; else in the middle of the range.
SPEED = "speed_mm_s"
SYMBOLS = {"pos_x_mm": "x", "clock_min": "t", "speed_mm_s": "v", "load_ratio": "p/p0"}
REFERENCE = {"speed_mm_s": 10.0, "load_ratio": 1.0}


class Response:
    """Features over the coefficient that each of them has, about ``values`` (logarithms by name).

    Attributes
    ----------
    coefficients : (n, k) which of the coefficients a feature has.
    level : (k,) their logarithms.
    """

    def __init__(self, measurements: Measurements, values: dict[str, float]):
        m = measurements
        names = [p.name for p in m.null_parameters]
        of_feature = np.concatenate([[b.COEFFICIENT] * len(b.rows) for b in m.blocks])
        self.coefficients = (of_feature[:, None] == np.array(names)).astype(float)
        self.level = np.array([values[name] for name in names])
        shifted = [
            m.predict({name: values[name] + shift for name in names}, ()) for shift in LOG_SHIFTS
        ]
        self._pieces = PchipInterpolator(LOG_SHIFTS, np.array(shifted), axis=0).c

    def at(self, level: np.ndarray, log_factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prediction and d(prediction)/d(ln mu), (n,), at coefficients and a factor on each."""
        shift = self.coefficients @ (level - self.level) + log_factor
        place = np.clip(shift, LOG_SHIFTS[0], LOG_SHIFTS[-1])
        piece = np.searchsorted(LOG_SHIFTS, place, side="right") - 1
        piece = np.clip(piece, 0, len(LOG_SHIFTS) - 2)
        x = place - LOG_SHIFTS[piece]
        a, b, c, d = self._pieces[:, piece, np.arange(len(x))]
        return ((a * x + b) * x + c) * x + d, (3 * a * x + 2 * b) * x + c


def speed_curve(knots_mm_s, factors) -> Curve:
    """A factor along the speed in the law itself: a reading at rest may show friction in motion.

    (A slider whose static friction is the smaller is pulled until it slides.) Along the other
    covariates each feature has a coefficient of its own.
    """
    quantity, to_si = CURVES[SPEED] or (SPEED, 1.0)
    return Curve(quantity, tuple(to_si * np.asarray(knots_mm_s)), tuple(factors))


@dataclass
class _Form:
    """What friction may follow along a covariate.

    Attributes
    ----------
    log_factor : (plain values of the covariate, parameters (k,)) -> g.
    start : (k,) parameters.
    roots : of covariances that the parameters may have (k, k); None: they are free.
    """

    track: _Track
    log_factor: Callable[[np.ndarray, np.ndarray], np.ndarray]
    start: np.ndarray
    roots: np.ndarray | None


@dataclass
class _Fitted:
    """A form fitted beside the null: coefficients, parameters, scatter, ML log-likelihood.

    ``columns`` (n, m) and ``target`` (n,) are the linear model at the fit. The ``random`` columns
    (m,) have unit priors, those of the ``curve`` among them the covariance root @ root.T.
    ``covariance`` (m, m) is of all.
    """

    level: np.ndarray
    values: np.ndarray
    scatters: dict[str, Scatter]
    groups: list[Group]
    sensitivity: np.ndarray
    columns: np.ndarray
    target: np.ndarray
    random: np.ndarray
    curve: np.ndarray
    root: np.ndarray | None = None
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    log_likelihood: float = 0.0
    converged: bool = False

    def scale(self, root: np.ndarray | None) -> np.ndarray:
        """(m, m) that makes unit normals of the random columns."""
        scale = np.eye(len(self.random))
        if root is not None:
            scale[np.ix_(self.curve, self.curve)] = root
        return scale

    def gram(self, gram: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Scaled, with the priors."""
        return scale.T @ gram @ scale + np.diag(np.where(self.random, 1.0, LEVEL_SD**-2))


@dataclass
class _Problem:
    """The measurements beside which forms are fitted."""

    measurements: Measurements
    keep: np.ndarray
    null: Fit
    scatters: dict[str, Scatter]

    @cached_property
    def response(self) -> Response:
        """Of the features to their coefficients."""
        return Response(self.measurements, self.null.as_dict())

    @cached_property
    def usable(self) -> np.ndarray:
        """(n,) kept features that friction acts on."""
        _, d = self.response.at(self.response.level, np.zeros(len(self.keep)))
        return self.keep & self.measurements.of_friction & (d != 0)

    def fit(self, form: _Form | None) -> _Fitted:
        """A form (None: the null) with its scatter."""
        starts = [self.scatters]
        # What the effect has swelled in the null holds on to it: once more from what is usual.
        if form is not None and any(s.run > SWELLED_RUN for s in self.scatters.values()):
            starts.append(dict.fromkeys(self.scatters, START_SCATTER))
        found = [self._fit(form, s) for s in starts]
        return max(found, key=lambda one: (one.converged, one.log_likelihood))

    def _fit(self, form: _Form | None, scatters: dict[str, Scatter]) -> _Fitted:
        """By linear models in turn, from scatters to start with."""
        m, response = self.measurements, self.response
        count = len(response.level)
        level, values = response.level, np.zeros(0) if form is None else form.start
        before, gain, step = -np.inf, 0.0, 1.0
        for _ in range(ROUNDS):
            prediction, d, slopes = self._evaluated(form, level, values)
            blocks = [response.coefficients * d[:, None]]
            if form is not None:
                free = nuisance_columns(m, self.usable & ~form.track.recorded, d)
                blocks += [] if free is None else [free]
            free_count = sum(block.shape[1] for block in blocks)
            columns = np.column_stack([*blocks, m.zero_columns, slopes])
            target = m.y - prediction + d * (response.coefficients @ level) + slopes @ values
            own = np.arange(columns.shape[1]) >= columns.shape[1] - slopes.shape[1]
            random = np.arange(columns.shape[1]) >= free_count
            if form is not None and form.roots is None:
                random &= ~own
            groups = make_groups(m, d, self.keep & ~m.lower_bound)

            model = _Fitted(
                level, values, scatters, groups, d, columns, target, random, own & random
            )
            if form is not None and form.roots is not None:
                sums = _sums(model)
                model.root = max(form.roots, key=lambda r: _evidence(model, sums, r, True))
            model.scatters = scatters = {g.protocol: _scatter_of(m, g, model) for g in groups}
            sums = _sums(model)
            model.log_likelihood = _evidence(model, sums, model.root, False)
            scale = model.scale(model.root)
            model.covariance = scale @ np.linalg.inv(model.gram(sums[0], scale)) @ scale.T
            every = model.covariance @ sums[1]
            gain, last = model.log_likelihood - before, gain
            if gain < -CONVERGED and CONVERGED < last < np.inf:
                step *= 0.5  # else coefficients and scatter may go to and fro for ever
            level = level + step * (every[:count] - level)
            values = values + step * (np.clip(every[own], -LARGEST, LARGEST) - values)
            model.level, model.values = level, values
            model.converged = abs(gain) < CONVERGED * step
            if model.converged:
                break
            before = model.log_likelihood
        return model

    def _evaluated(
        self, form: _Form | None, level: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Prediction, d(prediction)/d(ln mu) and slopes (n, k) in the form's parameters."""
        if form is None:
            return *self.response.at(level, np.zeros(len(self.keep))), np.zeros((len(self.keep), 0))
        track, log_factor = form.track, form.log_factor

        def moved(k: int) -> np.ndarray:
            return values + STEP * (np.arange(len(values)) == k)

        if track.covariate.name == SPEED:
            names = [p.name for p in self.measurements.null_parameters]

            def predicted(level, values) -> np.ndarray:
                curve = speed_curve(
                    track.plain_knots, np.exp(log_factor(track.plain_knots, values))
                )
                named = dict(zip(names, level, strict=True))
                return self.measurements.predict(named, (), curve=curve)

            base = predicted(level, values)
            d = (predicted(level + STEP, values) - base) / STEP
            ends = [predicted(level, moved(k)) for k in range(len(values))]
            return base, d, np.column_stack([(end - base) / STEP for end in ends])
        g = log_factor(track.plain, values) * track.recorded
        ends = [log_factor(track.plain, moved(k)) * track.recorded for k in range(len(values))]
        base, d = self.response.at(level, g)
        return base, d, np.column_stack([d * (end - g) / STEP for end in ends])


def _sums(model: _Fitted) -> tuple[np.ndarray, np.ndarray, float]:
    """X' V^-1 X, X' V^-1 y and the log-likelihood of no columns, over all protocols."""
    gram, score, bare = 0.0, 0.0, 0.0
    for group in model.groups:
        scatter = model.scatters[group.protocol]
        clusters = Clusters(group, model.columns[group.index])
        of = clusters.responses(model.target[group.index][:, None])
        pulled, squares = clusters.products(scatter, of)
        gram, score = gram + clusters.gram(scatter), score + pulled[:, 0]
        bare += scatter_prior(scatter)
        bare -= 0.5 * (clusters.log_determinant(scatter) + squares[0])
    return np.asarray(gram), np.asarray(score), float(bare)


def _evidence(model: _Fitted, sums, root: np.ndarray | None, restricted: bool) -> float:
    """Log-likelihood, random columns integrated out, the free ones too if ``restricted``."""
    scale = model.scale(root)
    gram, score = model.gram(sums[0], scale), scale.T @ sums[1]
    integrated = gram if restricted else gram[np.ix_(model.random, model.random)]
    best = sums[2] + 0.5 * score @ np.linalg.solve(gram, score)
    return float(best - 0.5 * np.linalg.slogdet(integrated)[1])


def _scatter_of(m: Measurements, group: Group, model: _Fitted) -> Scatter:
    """One protocol's scatter beside its share of the columns."""
    columns = (model.columns @ model.scale(model.root))[group.index]
    fixed = columns[:, ~model.random]
    left, size, _ = np.linalg.svd(fixed, full_matrices=False)
    found, _ = estimate_scatter(
        group,
        model.target[group.index],
        left[:, size > 1e-6 * size[0]],
        np.column_stack([zeros_of(m, group), columns[:, model.curve]]),
        model.scatters[group.protocol],
    )
    return found


@dataclass
class _Track:
    """A covariate as the curves see it: recorded features, knots, their interpolation."""

    covariate: Covariate
    values: np.ndarray
    recorded: np.ndarray
    knots: np.ndarray
    hats: np.ndarray

    @cached_property
    def plain(self) -> np.ndarray:
        """(n,) the covariate as it was recorded, of the first knot where it was not."""
        values = np.where(self.recorded, self.values, self.knots[0])
        return 10**values if self.covariate.logarithmic else values

    @property
    def plain_knots(self) -> np.ndarray:
        """Knots as they are written."""
        return 10**self.knots if self.covariate.logarithmic else self.knots

    @property
    def places(self) -> np.ndarray:
        """Knots from 0 to 1."""
        return (self.knots - self.knots[0]) / np.ptp(self.knots)

    def root(self, length: float) -> np.ndarray:
        """A root of the curve's covariance at a length, for a size of 1."""
        distance = self.places[:, None] - self.places[None, :]
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (distance / length) ** 2))
        return vectors * np.sqrt(np.maximum(values, 0.0))

    def smooth(self) -> _Form:
        """A curve of any size and smoothness."""
        roots = [size * self.root(length) for length in LENGTHS for size in SIZES]

        def log_factor(plain: np.ndarray, values: np.ndarray) -> np.ndarray:
            return np.interp(self.covariate.searched(plain), self.knots, values)

        return _Form(self, log_factor, np.zeros(len(self.knots)), np.array(roots))

    def test(self, measurements: Measurements, sensitivity: np.ndarray, usable) -> Test:
        """The covariate's test: its leading smooth curves."""
        columns = self.hats @ self.root(TESTED_LENGTH)[:, ::-1][:, :TESTED_COLUMNS]
        free = nuisance_columns(measurements, usable & ~self.recorded, sensitivity)
        return Test(columns * sensitivity[:, None], free, covariate=self.covariate.name)


def _track(problem: _Problem, name: str) -> _Track | None:
    """None where a covariate was not recorded at three levels or more."""
    covariate, rows = COVARIATES[name], problem.measurements.rows
    plain = rows[name].to_numpy(float)
    if name == "load_ratio":  # on a slope the load is that at the slip
        slope = np.where(rows["quantity"] == "angle_deg", rows["y"], 0.0)
        plain = plain * np.cos(np.radians(slope))
    values = covariate.searched(plain)
    recorded = problem.usable & np.isfinite(values)
    levels = np.unique(np.round(values[recorded & ~problem.measurements.lower_bound], 6))
    if len(levels) < FEWEST_LEVELS:
        return None
    knots = levels if len(levels) <= KNOTS else np.linspace(levels[0], levels[-1], KNOTS)
    places = np.interp(np.where(recorded, values, knots[0]), knots, np.arange(len(knots)))
    hats = np.maximum(1.0 - np.abs(places[:, None] - np.arange(len(knots))), 0.0)
    return _Track(covariate, values, recorded, knots, hats * recorded[:, None])


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


def _shapes(track: _Track, edge: float) -> list[_Shape]:
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


def _edge(track: _Track, curve: _Fitted) -> float:
    """Where a step gains most likelihood, beside the curve's scatter."""
    levels = np.unique(np.round(track.values[track.recorded], 6))
    edges = 0.5 * (levels[1:] + levels[:-1])
    edges = edges[np.linspace(0, len(edges) - 1, min(len(edges), MOST_EDGES)).astype(int)]
    beyond = track.recorded[:, None] & (np.where(track.recorded, track.values, 0)[:, None] > edges)
    columns = [curve.columns[:, ~curve.curve], beyond * curve.sensitivity[:, None]]
    base = columns[0].shape[1]
    gram, score, _ = _sums(replace(curve, columns=np.column_stack(columns)))
    ridge = np.where(curve.random[~curve.curve], 1.0, LEVEL_SD**-2)
    gains = []
    for k in range(len(edges)):
        own = np.r_[np.arange(base), base + k]
        inner = gram[np.ix_(own, own)] + np.diag([*ridge, LEVEL_SD**-2])
        gains.append(score[own] @ np.linalg.solve(inner, score[own]))
    edge = edges[int(np.argmax(gains))]
    return float(f"{10**edge if track.covariate.logarithmic else edge:.3g}")


@dataclass(frozen=True)
class Formula:
    """A short formula that fits as well as the curve: its coefficients are those where it is 1."""

    shape: str
    text: str
    parameter: float
    interval: tuple[float, float]
    coefficients: dict[str, float]
    delta_bic: float


@dataclass(frozen=True)
class Discrepancy:
    """A smooth factor on the coefficient, its mean logarithm over the features 0.

    Attributes
    ----------
    tried : covariate -> family-wise p of any smooth curve along it.
    covariate : of the factor; None where no covariate takes anything away (then nothing follows).
    knots, factors, low, high : of the curve with its 95 % band; linear between knots in the
        logarithm of the factor and, for speed and load, of the covariate.
    coefficients : friction coefficients where the factor is 1.
    scatters : beside the factor, outliers included: for prediction.
    rmse_null, rmse : errors of features of left-out specimens, relative to friction.
    share : of the squared error that the factor takes away there.
    not_converged : covariates along which a factor's fit did not: it is not used.
    shapes_not_converged : short formulas whose fit did not: whether they fit as well is not known.
    """

    tried: dict[str, float]
    covariate: str | None = None
    knots: tuple[float, ...] = ()
    factors: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    coefficients: dict[str, float] = field(default_factory=dict)
    scatters: dict[str, Scatter] = field(default_factory=dict)
    rmse_null: float = 0.0
    rmse: float = 0.0
    share: float = 0.0
    formula: Formula | None = None
    not_converged: tuple[str, ...] = ()
    shapes_not_converged: tuple[str, ...] = ()

    def as_dict(self) -> dict:
        """The layout of docs/criticise-your-data.md."""
        tried = {name: round(p, 5) for name, p in self.tried.items()}
        failed = {"not_converged": list(self.not_converged)} if self.not_converged else {}
        if self.covariate is None:
            return {"covariate": None, "tried": tried, **failed}
        result = failed | {
            "covariate": self.covariate,
            "unit": COVARIATES[self.covariate].unit,
            "p_adjusted": tried[self.covariate],
            "tried": tried,
            "knots": list(self.knots),
            "factors": list(self.factors),
            "ci95": [list(band) for band in zip(self.low, self.high, strict=True)],
            "coefficients": self.coefficients,
            "scatter": {p: [s.specimen, s.run, s.kappa] for p, s in self.scatters.items()},
            "rmse_null": round(self.rmse_null, 5),
            "rmse_extended": round(self.rmse, 5),
            "misfit_share": round(self.share, 4),
            "formula": None,
        }
        if self.shapes_not_converged:
            result["shapes_not_converged"] = list(self.shapes_not_converged)
        if self.formula is not None:
            result["formula"] = {
                "text": self.formula.text,
                "shape": self.formula.shape,
                "parameter": self.formula.parameter,
                "ci95": list(self.formula.interval),
                "coefficients": self.formula.coefficients,
                "delta_bic": round(self.formula.delta_bic, 2),
            }
        return result


def along(found: dict, places, factors=None) -> np.ndarray:
    """The factor at plain values of its covariate, by the knots of :meth:`Discrepancy.as_dict`."""
    covariate = COVARIATES[found["covariate"]]
    knots = covariate.searched(np.array(found["knots"]))
    logs = np.log(found["factors"] if factors is None else factors)
    return np.exp(np.interp(covariate.searched(np.asarray(places, float)), knots, logs))


def specimen_factors(
    found: dict, measurements: Measurements, null: Fit, state: State
) -> pd.DataFrame:
    """What specimens say of the factor: protocol, specimen, ``at`` a place, their mean ``factor``.

    Many places are drawn together into as many as there are knots at most.
    """
    m, problem = measurements, _Problem(measurements, state.keep, null, state.scatters)
    track = _track(problem, found["covariate"])
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
    """What :meth:`Discrepancy.as_dict` says, in a sentence."""
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


def embedded_discrepancy(
    measurements: Measurements, null: Fit, state: State, seed: int = 1, replicates: int = 500
) -> Discrepancy:
    """The smooth factor that the data ask for beside the null, if any.

    Parameters
    ----------
    null, state : fit of the null, and its scatter and kept features.
    seed, replicates : of the simulated maxima.
    """
    problem = _Problem(measurements, state.keep, null, state.scatters)
    tracks = [track for name in ALONG if (track := _track(problem, name)) is not None]
    tried = _tried(problem, tracks, state, np.random.default_rng(seed), replicates)
    if not tracks:
        return Discrepancy(tried)
    plain = problem.fit(None)
    fitted = [(track, problem.fit(track.smooth())) for track in tracks]
    failed = tuple(t.covariate.name for t, c in fitted if not (c.converged and plain.converged))
    nothing = Discrepancy(tried, not_converged=failed)
    usable = [(track, curve) for track, curve in fitted if track.covariate.name not in failed]
    if not usable:
        return nothing
    track, curve = max(usable, key=lambda pair: pair[1].log_likelihood)
    errors = [_left_out_error(measurements, model, track.recorded) for model in (plain, curve)]
    share = 1.0 - (errors[1] / errors[0]) ** 2
    if tried[track.covariate.name] > SIGNIFICANCE or not share > 0:
        return nothing
    everything = replace(problem, keep=np.ones_like(state.keep), scatters=curve.scatters)
    whole = everything.fit((_track(everything, track.covariate.name) or track).smooth())
    if not whole.converged:
        return Discrepancy(tried, not_converged=(*failed, track.covariate.name))
    # The factor's mean logarithm over the features goes into the coefficients.
    weights = track.hats[track.recorded].mean(axis=0)
    mean = weights @ curve.values
    centred = np.eye(len(weights)) - weights
    own = np.flatnonzero(curve.curve)
    covariance = centred @ curve.covariance[np.ix_(own, own)] @ centred.T
    half = _reach(measurements, state) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    log_factors = curve.values - mean
    names = [p.name for p in measurements.null_parameters]
    formula, unknown = _formula(problem, track, curve, names, _reach(measurements, state))
    return Discrepancy(
        tried,
        track.covariate.name,
        knots=_rounded(track.plain_knots),
        factors=_rounded(np.exp(log_factors)),
        low=_rounded(np.exp(log_factors - half)),
        high=_rounded(np.exp(log_factors + half)),
        coefficients=dict(zip(names, _rounded(np.exp(curve.level + mean)), strict=True)),
        scatters=whole.scatters,
        rmse_null=float(errors[0]),
        rmse=float(errors[1]),
        share=float(share),
        formula=formula,
        not_converged=failed,
        shapes_not_converged=unknown,
    )


def _rounded(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(f"{value:.6g}") for value in values)


def _reach(measurements: Measurements, state: State) -> float:
    specimens = len(np.unique(measurements.specimen[state.keep]))
    return float(student.ppf(0.975, max(specimens - 2, 3)))


def _tried(problem: _Problem, tracks, state: State, rng, replicates: int) -> dict[str, float]:
    """Family-wise p of a smooth curve along every covariate, in any protocol or in all."""
    if not tracks:
        return {}
    m, null = problem.measurements, problem.null
    tests = [track.test(m, state.sensitivity, problem.usable) for track in tracks]
    outcome = run_tests(
        tests,
        null.jacobian,
        m.y - null.prediction,
        state.groups,
        state.scatters,
        rng,
        replicates,
        (SIGNIFICANCE,),
        m.zero_columns,
    )
    found: dict[str, float] = {}
    for test, p in zip(outcome.tests, outcome.adjusted, strict=True):
        name = str(test.covariate)
        found[name] = min(found.get(name, 1.0), float(p))
    return found


def _left_out_error(m: Measurements, model: _Fitted, scored: np.ndarray) -> float:
    """Error of the scored features, relative to friction, each specimen predicted by the others."""
    scale = model.scale(model.root)
    whole = model.gram(np.zeros_like(scale), scale)
    score = np.zeros(len(scale))
    parts = []
    for group in model.groups:
        root = group.whitening(model.scatters[group.protocol])
        columns = root.whiten(model.columns[group.index] @ scale)
        target = root.whiten(model.target[group.index])
        for specimen in np.unique(group.specimen):
            own = group.specimen == specimen
            parts.append(
                (group.index[own], columns[own].T @ columns[own], columns[own].T @ target[own])
            )
            whole, score = whole + parts[-1][1], score + parts[-1][2]
    squares = []
    for index, gram, pulled in parts:
        index = index[scored[index]]
        found = scale @ np.linalg.solve(whole - gram, score - pulled)
        error = model.target[index] - model.columns[index] @ found
        squares.append((error / np.hypot(model.sensitivity[index], m.u[index])) ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def _formula(
    problem: _Problem, track: _Track, curve: _Fitted, names: list[str], reach: float
) -> tuple[Formula | None, tuple[str, ...]]:
    """The best named shape, if it fits as well as the curve by BIC (size and length: two).

    And the names of those whose fit did not converge.
    """
    cost = np.log(max(number_of_runs(problem.measurements, problem.keep), 2))
    limit = -2 * curve.log_likelihood + 2 * cost
    best, unknown = None, []
    for shape in _shapes(track, _edge(track, curve)):

        def log_factor(plain, values, shape=shape):
            return shape.g(plain, float(values[0]))

        found = problem.fit(_Form(track, log_factor, np.array([0.0]), None))
        if not found.converged:
            unknown.append(shape.name)
            continue
        bic = -2 * found.log_likelihood + (1 + shape.places) * cost
        if best is None or bic < best[0]:
            best = bic, shape, found
    if best is None or best[0] > limit + AS_WELL_BIC:
        return None, tuple(unknown)
    bic, shape, found = best
    value, half = float(found.values[0]), float(reach * np.sqrt(found.covariance[-1, -1]))
    ends = np.array([shape.parameter(value + step) for step in (-half, 0.0, half)])
    low, estimate, high = _rounded(np.sort(ends))
    formula = Formula(
        shape.name,
        shape.text(value),
        estimate,
        (low, high),
        dict(zip(names, _rounded(np.exp(found.level)), strict=True)),
        float(bic - limit),
    )
    return formula, tuple(unknown)
