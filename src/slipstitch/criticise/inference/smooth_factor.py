"""A factor on the coefficient along a covariate, fitted beside the null.

The coefficient of every feature becomes mu exp(g(c)) in one covariate c. A smooth g is piecewise
linear between knots; its values there are Gaussian with covariance tau^2 exp(-(distance /
length)^2 / 2) (Rasmussen and Williams, Gaussian Processes, 2006). tau, length and scatter by
restricted maximum likelihood. A short formula is a g of one free parameter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import orth

from slipstitch.criticise.covariates import COVARIATES, Covariate
from slipstitch.criticise.inference import mixed_model
from slipstitch.criticise.inference.mixed_model import Clusters, Group, Scatter, by_specimen
from slipstitch.criticise.inference.state import State, nuisance_columns
from slipstitch.criticise.inference.structure import Test
from slipstitch.criticise.measurements import Measurements
from slipstitch.physics.friction_law import Curve
from slipstitch.physics.friction_law.extended_model import CURVES

KNOTS, FEWEST_LEVELS = 16, 3
LENGTHS = (0.12, 0.25, 0.5, 1.0)  # of the covariate's range
SIZES = tuple(np.geomspace(0.01, 1.0, 12))
TESTED_LENGTH, TESTED_COLUMNS = 0.25, 5
LEVEL_SD = 3.0  # of the prior of coefficients and free levels, in ln mu
LOG_SHIFTS = np.linspace(-1.5, 1.5, 13)
ROUNDS, CONVERGED = 40, 0.1  # of log-likelihood, by a whole step
SWELLED_RUN, LARGEST = 0.1, 3.0
STEP = 0.01  # of derivatives by differences
SPEED = "speed_mm_s"


class Response:
    """Features over the coefficient that each of them has, about ``values`` (logarithms by name).

    ``coefficients`` (n, k) says which one a feature has, ``level`` (k,) are their logarithms.
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
class Form:
    """What friction may follow along a covariate: (plain values, parameters (k,)) -> ln factor.

    ``roots`` are of covariances that the parameters may have (k, k); None: they are free.
    """

    track: Track
    log_factor: Callable[[np.ndarray, np.ndarray], np.ndarray]
    start: np.ndarray
    roots: np.ndarray | None


@dataclass
class Fitted:
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
class Problem:
    """The null, beside which forms are fitted."""

    state: State

    @cached_property
    def response(self) -> Response:
        """Of the features to their coefficients."""
        return Response(self.state.measurements, self.state.fitted.as_dict())

    @cached_property
    def usable(self) -> np.ndarray:
        """(n,) features that friction acts on."""
        m = self.state.measurements
        _, d = self.response.at(self.response.level, np.zeros(len(m.y)))
        return m.of_friction & (d != 0)

    def fit(self, form: Form | None) -> Fitted:
        """A form (None: the null) with its scatter."""
        starts = [self.state.scatters]
        # What the effect has swelled in the null holds on to it: once more from what is usual.
        if form is not None and any(s.run > SWELLED_RUN for s in starts[0].values()):
            starts.append(dict.fromkeys(starts[0], mixed_model.START_SCATTER))
        found = [self._fit(form, s) for s in starts]
        return max(found, key=lambda one: (one.converged, one.log_likelihood))

    def _fit(self, form: Form | None, scatters: dict[str, Scatter]) -> Fitted:
        """By linear models in turn, from scatters to start with."""
        m, response = self.state.measurements, self.response
        count = len(response.level)
        level, values = response.level, np.zeros(0) if form is None else form.start
        roots = None if form is None else form.roots
        before, gain, step = -np.inf, 0.0, 1.0
        for _ in range(ROUNDS):
            prediction, d, slopes = self._evaluated(form, level, values)
            blocks, free = [response.coefficients * d[:, None]], None
            if form is not None:
                free = nuisance_columns(m, self.usable & ~form.track.recorded, d)
            blocks += [] if free is None else [free]
            free_count = sum(block.shape[1] for block in blocks)
            columns = np.column_stack([*blocks, m.zero_columns, slopes])
            target = m.y - prediction + d * (response.coefficients @ level) + slopes @ values
            place = np.arange(columns.shape[1])
            own = place >= columns.shape[1] - slopes.shape[1]
            random = (place >= free_count) & ~(own & (roots is None))
            groups = mixed_model.make_groups(m, d)

            model = Fitted(
                level, values, scatters, groups, d, columns, target, random, own & random
            )
            if roots is not None:
                sums = sums_of(model)
                model.root = max(roots, key=lambda r: _evidence(model, sums, r, True))
            model.scatters = scatters = {g.protocol: _scatter_of(m, g, model) for g in groups}
            sums = sums_of(model)
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
        self, form: Form | None, level: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Prediction, d(prediction)/d(ln mu) and slopes (n, k) in the form's parameters."""
        m = self.state.measurements
        if form is None:
            count = len(m.y)
            return *self.response.at(level, np.zeros(count)), np.zeros((count, 0))
        track, log_factor = form.track, form.log_factor
        moved = values + STEP * np.eye(len(values))
        if track.covariate.name == SPEED:
            names = [p.name for p in m.null_parameters]

            def predicted(level, values) -> np.ndarray:
                factors = np.exp(log_factor(track.plain_knots, values))
                curve = speed_curve(track.plain_knots, factors)
                named = dict(zip(names, level, strict=True))
                return m.predict(named, (), curve=curve)

            base = predicted(level, values)
            d = (predicted(level + STEP, values) - base) / STEP
            slopes = [(predicted(level, more) - base) / STEP for more in moved]
        else:
            g = log_factor(track.plain, values) * track.recorded
            ends = [log_factor(track.plain, more) * track.recorded for more in moved]
            base, d = self.response.at(level, g)
            slopes = [d * (end - g) / STEP for end in ends]
        return base, d, np.column_stack(slopes)


def sums_of(model: Fitted) -> tuple[np.ndarray, np.ndarray, float]:
    """X' V^-1 X, X' V^-1 y and the log-likelihood of no columns, over all protocols."""
    both = np.column_stack([model.columns, model.target])
    gram, bare = np.zeros((both.shape[1], both.shape[1])), 0.0
    for group in model.groups:
        scatter, clusters = model.scatters[group.protocol], Clusters(group, both[group.index])
        gram += clusters.gram(scatter)
        bare += scatter.log_prior() - 0.5 * clusters.log_determinant(scatter)
    return gram[:-1, :-1], gram[:-1, -1], float(bare - 0.5 * gram[-1, -1])


def _evidence(model: Fitted, sums, root: np.ndarray | None, restricted: bool) -> float:
    """Log-likelihood, random columns integrated out, the free ones too if ``restricted``."""
    scale = model.scale(root)
    gram, score = model.gram(sums[0], scale), scale.T @ sums[1]
    integrated = gram if restricted else gram[np.ix_(model.random, model.random)]
    best = sums[2] + 0.5 * score @ np.linalg.solve(gram, score)
    return float(best - 0.5 * np.linalg.slogdet(integrated)[1])


def _scatter_of(m: Measurements, group: Group, model: Fitted) -> Scatter:
    """One protocol's scatter beside its share of the columns."""
    columns = (model.columns @ model.scale(model.root))[group.index]
    found, _ = mixed_model.estimate_scatter(
        group,
        model.target[group.index],
        orth(columns[:, ~model.random], 1e-6),
        np.column_stack([mixed_model.zeros_of(m, group), columns[:, model.curve]]),
        model.scatters[group.protocol],
    )
    return found


@dataclass
class Track:
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

    def smooth(self) -> Form:
        """A curve of any size and smoothness."""
        roots = [size * self.root(length) for length in LENGTHS for size in SIZES]

        def log_factor(plain: np.ndarray, values: np.ndarray) -> np.ndarray:
            return np.interp(self.covariate.searched(plain), self.knots, values)

        return Form(self, log_factor, np.zeros(len(self.knots)), np.array(roots))

    def test(self, state: State, usable: np.ndarray) -> Test:
        """The covariate's test: its leading smooth curves."""
        d = state.sensitivity
        columns = self.hats @ self.root(TESTED_LENGTH)[:, ::-1][:, :TESTED_COLUMNS]
        free = nuisance_columns(state.measurements, usable & ~self.recorded, d)
        return Test(columns * d[:, None], free, covariate=self.covariate.name)


def track_along(problem: Problem, name: str) -> Track | None:
    """None where a covariate was not recorded at three levels or more."""
    covariate, m = COVARIATES[name], problem.state.measurements
    rows = m.rows
    plain = rows[name].to_numpy(float)
    if name == "load_ratio":  # on a slope the load is that at the slip
        slope = np.where(rows["quantity"] == "angle_deg", rows["y"], 0.0)
        plain = plain * np.cos(np.radians(slope))
    values = covariate.searched(plain)
    recorded = problem.usable & np.isfinite(values)
    levels = np.unique(np.round(values[recorded & ~m.lower_bound], 6))
    if len(levels) < FEWEST_LEVELS:
        return None
    knots = levels if len(levels) <= KNOTS else np.linspace(levels[0], levels[-1], KNOTS)
    places = np.interp(np.where(recorded, values, knots[0]), knots, np.arange(len(knots)))
    hats = np.maximum(1.0 - np.abs(places[:, None] - np.arange(len(knots))), 0.0)
    return Track(covariate, values, recorded, knots, hats * recorded[:, None])


def left_out_error(m: Measurements, model: Fitted, scored: np.ndarray) -> float:
    """Error of the scored features, relative to friction, each specimen predicted by the others."""
    scale = model.scale(model.root)
    prior = model.gram(np.zeros_like(scale), scale)
    columns = np.column_stack([model.columns @ scale, model.target])
    parts = by_specimen(model.groups, model.scatters, columns)
    whole, squares = sum(gram for _, gram in parts), []
    for rows, gram in parts:
        index, others = rows[scored[rows]], whole - gram
        found = scale @ np.linalg.solve(prior + others[:-1, :-1], others[:-1, -1])
        error = model.target[index] - model.columns[index] @ found
        squares.append((error / np.hypot(model.sensitivity[index], m.u[index])) ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))
