"""Least-squares fits of a set of causes at a given covariance; bounds enter as probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from slipstitch.base.errors import NotConverged
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.mixed_model import (
    Clusters,
    Scatter,
    make_groups,
    total_variance,
)
from slipstitch.criticise.measurements import Measurements
from slipstitch.physics.friction_law import Parameter

# Most fits take 1 to 3 iterations, one in a hundred more than 14, along a narrow valley up to 50.
ITERATIONS_MAX = 200
UNKNOWN_COEFFICIENT_LOG_SD = 1.0
# Starts of kinked parameters, in units of their scale.
KINK_STEPS = (0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0)


def parameters_of(measurements: Measurements, causes: tuple[str, ...]) -> list[Parameter]:
    """Parameters of the null and of the causes, in order."""
    own = [p for cause in causes for p in MECHANISMS[cause].parameters]
    return [*measurements.null_parameters, *own]


class Weights:
    """The inverse covariance P of the features; bounds with their total sd.

    What sensors' zeros (unit prior sd) and ``nuisance`` columns (n, q), which are fitted freely and
    silently, can carry counts for nothing.
    """

    def __init__(
        self,
        measurements: Measurements,
        sensitivity: np.ndarray,
        scatters: dict[str, Scatter],
        nuisance: np.ndarray | None = None,
    ):
        m = self._measurements = measurements
        self.groups = make_groups(m, sensitivity)
        self._scatters = scatters
        self._index = np.concatenate([[], *(g.index for g in self.groups)]).astype(int)
        self._clusters = [Clusters(g, np.zeros((len(g.u), 0))) for g in self.groups]
        self._carried: list[tuple[np.ndarray, np.ndarray]] = []
        zeros = m.zero_columns[self._index]
        if zeros.size:
            pulled = self._solved(zeros)
            self._carried.append((pulled, np.linalg.inv(zeros.T @ pulled + np.eye(zeros.shape[1]))))
        if nuisance is not None and self.groups:
            free = nuisance[self._index]
            pulled = self._solved(free)
            self._carried.append((pulled, np.linalg.pinv(free.T @ pulled, hermitian=True)))
        self._bounds = np.flatnonzero(m.lower_bound)
        b = self._bounds
        variance = total_variance(m.protocol[b], m.u[b], sensitivity[b], scatters)
        self._bound_sd = np.maximum(np.sqrt(variance), 1e-9)

    def _solved(self, values: np.ndarray) -> np.ndarray:
        """P x of the groups' rows (n, k)."""
        parts, start = [], 0
        for group, clusters in zip(self.groups, self._clusters, strict=True):
            own = values[start : start + len(group.index)]
            parts.append(clusters.solved(self._scatters[group.protocol], own))
            start += len(group.index)
        result = np.concatenate(parts) if parts else values
        for pulled, core in self._carried:
            result = result - pulled @ (core @ (pulled.T @ values))
        return result

    def _distance(self, prediction: np.ndarray) -> np.ndarray:
        """How far predictions lie above the bounds, in standard deviations."""
        y = self._measurements.y
        return (prediction[self._bounds] - y[self._bounds]) / self._bound_sd

    def log_probability(self, prediction: np.ndarray) -> float:
        """Of the truth to lie above every bound."""
        return float(log_ndtr(self._distance(prediction)).sum())

    def chi2(self, prediction: np.ndarray) -> float:
        """r' P r, less twice the log-probability of the bounds."""
        residual = (self._measurements.y - prediction)[self._index][:, None]
        squares = float((residual * self._solved(residual)).sum())
        return squares - 2 * self.log_probability(prediction)

    def normal_equations(
        self, columns: np.ndarray, prediction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Half the curvature (Gauss and Newton) and half the descent of chi2 along columns."""
        own = columns[self._index]
        pulled = self._solved(own)
        curvature = own.T @ pulled
        descent = pulled.T @ (self._measurements.y - prediction)[self._index]
        if len(self._bounds):
            z = self._distance(prediction)
            log_p = log_ndtr(z)
            root = np.sqrt(np.maximum(-2 * log_p, 1e-12))
            hazard = np.exp(-0.5 * z**2 - log_p) / np.sqrt(2 * np.pi)
            of_bounds = (hazard / root / self._bound_sd)[:, None] * columns[self._bounds]
            curvature = curvature + of_bounds.T @ of_bounds
            descent = descent + of_bounds.T @ np.sqrt(np.maximum(-2 * log_p, 0.0))
        return curvature, descent


@dataclass
class Fit:
    """A fitted set of causes."""

    causes: tuple[str, ...]
    parameters: list[Parameter]
    values: np.ndarray
    chi2: float
    prediction: np.ndarray
    jacobian: np.ndarray
    covariance: np.ndarray

    def as_dict(self) -> dict[str, float]:
        """Parameter values by name (mu as logarithms)."""
        return named(self.parameters, self.values)

    def sensitivity(self) -> np.ndarray:
        """d(feature)/d(ln mu), (n,)."""
        own = [j for j, p in enumerate(self.parameters) if p.coefficient]
        return self.jacobian[:, own].sum(axis=1)


def named(parameters: list[Parameter], values: np.ndarray) -> dict[str, float]:
    """Values by the names of their parameters."""
    return {p.name: float(value) for p, value in zip(parameters, values, strict=True)}


def jacobian(measurements: Measurements, causes: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """d(prediction)/d(parameters), (n, p), by central differences of a tenth of each scale.

    Central, because slips have a kink where static and kinetic friction are equal: the null.
    """
    parameters = parameters_of(measurements, causes)
    columns = []
    for j, parameter in enumerate(parameters):
        ends = []
        for step in (0.1 * parameter.scale, -0.1 * parameter.scale):
            moved = values.copy()
            moved[j] = np.clip(moved[j] + step, parameter.lower, parameter.upper)
            ends.append((moved[j], measurements.predict(named(parameters, moved), causes)))
        columns.append((ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0]))
    return np.column_stack(columns)


def carried_over(
    design: Measurements, causes: tuple[str, ...], known: dict[str, float], covariance: np.ndarray
) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Parameters of a fit for other measurements: values by name, Jacobian and covariance.

    A coefficient that the fit has not (``known``: by name, in the order of ``covariance``) is as
    usual, its logarithm with a standard deviation of :data:`UNKNOWN_COEFFICIENT_LOG_SD`.
    """
    parameters = parameters_of(design, causes)
    values = np.array([known.get(p.name, p.null) for p in parameters])
    places = {name: j for j, name in enumerate(known)}
    own = [i for i, p in enumerate(parameters) if p.name in places]
    index = [places[parameters[i].name] for i in own]
    whole = UNKNOWN_COEFFICIENT_LOG_SD**2 * np.eye(len(parameters))
    whole[np.ix_(own, own)] = covariance[np.ix_(index, index)]
    return named(parameters, values), jacobian(design, causes, values), whole


def fit(
    measurements: Measurements,
    weights: Weights,
    causes: tuple[str, ...],
    start: dict[str, float] | None = None,
) -> Fit:
    """Levenberg-Marquardt from ``start`` (missing parameters start at their null values).

    A very weak prior (:attr:`Parameter.prior_width`) keeps parameters finite that the data do not
    determine. Raises NotConverged, since no verdict may hang on a fit that still improves.
    """
    parameters = parameters_of(measurements, causes)
    lower, upper, scale, null, width = np.array(
        [(p.lower, p.upper, p.scale, p.null, p.prior_width) for p in parameters]
    ).T
    start = start or {}
    values = np.array([start.get(p.name, p.null) for p in parameters])

    def evaluate(v):
        prediction = measurements.predict(named(parameters, v), causes)
        prior = (v - null) / width
        return prediction, weights.chi2(prediction), float(prior @ prior)

    def normal_equations():
        columns = jacobian(measurements, causes, values)
        curvature, descent = weights.normal_equations(columns, prediction)
        return columns, curvature + np.diag(1 / width**2), descent - (values - null) / width**2

    values = _better_side(values, parameters, start, evaluate)
    prediction, chi2, prior = evaluate(values)
    damping = 1e-3
    for _ in range(ITERATIONS_MAX):
        _, curvature, descent = normal_equations()
        improved = False
        for _ in range(6):
            ridge = damping * np.diag(np.maximum(np.diag(curvature), 1.0 / scale**2 * 1e-6))
            step = np.linalg.solve(curvature + ridge, descent)
            trial = np.clip(values + np.clip(step, -12 * scale, 12 * scale), lower, upper)
            new = evaluate(trial)
            if new[1] + new[2] <= chi2 + prior + 1e-9:
                improved = True
                break
            damping *= 8
        if not improved:
            break
        gain = chi2 + prior - new[1] - new[2]
        values, (prediction, chi2, prior) = trial, new
        damping = max(damping / 6, 1e-7)
        if gain < 1e-3:
            break
    else:
        model = " with ".join(("plain friction", *causes))
        raise NotConverged(f"the fit of {model} did not converge in {ITERATIONS_MAX} iterations")
    columns, curvature, _ = normal_equations()
    return Fit(causes, parameters, values, chi2, prediction, columns, np.linalg.inv(curvature))


def _better_side(values, parameters, start, evaluate):
    """The best of the start and of steps to either side of it, for kinked parameters.

    What is smaller than the noise of a trace shows nowhere: the fit has no slope at the start.
    """
    for j, parameter in enumerate(parameters):
        if not parameter.kinked or start.get(parameter.name, parameter.null) != parameter.null:
            continue
        trials = []
        for shift in KINK_STEPS:
            moved = values.copy()
            step = shift * parameter.scale
            moved[j] = np.clip(moved[j] + step, parameter.lower, parameter.upper)
            trials.append((evaluate(moved)[1], shift, moved))
        values = min(trials, key=lambda trial: trial[0])[2]
    return values
