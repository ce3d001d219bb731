"""Least-squares fits of a set of causes at a given covariance; bounds enter as probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from slipstitch.base.errors import NotConverged
from slipstitch.criticise.inference.covariance import Group, Scatter, Whitening
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS
from slipstitch.physics.friction_law import Parameter

# Most fits take 1 to 3 iterations, one in a hundred more than 14, along a narrow valley up to 50.
ITERATIONS_MAX = 200


def parameters_of(measurements: Measurements, causes: tuple[str, ...]) -> list[Parameter]:
    """Parameters of the null and of the causes, in order."""
    own = [p for cause in causes for p in MECHANISMS[cause].parameters]
    return [*measurements.null_parameters, *own]


@dataclass
class Weights:
    """Whitening of the kept, uncensored features and the total sd of those that are bounds."""

    groups: list[Group]
    roots: list[Whitening]
    bounds: np.ndarray
    bound_sd: np.ndarray
    nuisance: np.ndarray | None = None  # orthonormal, whitened; projected out of everything
    # Zeros of sensors, whitened: directions, and the share of each that they take off.
    zeros: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def build(
        cls,
        groups: list[Group],
        scatters: dict[str, Scatter],
        measurements: Measurements,
        sensitivity: np.ndarray,
        keep: np.ndarray,
    ) -> Weights:
        roots = [group.whitening(scatters[group.protocol]) for group in groups]
        bounds = np.flatnonzero(measurements.lower_bound & keep)
        sd = np.empty(len(bounds))
        for i, b in enumerate(bounds):
            s = scatters.get(measurements.protocol[b], Scatter(0.05, 0.03, 1.2))
            d = sensitivity[b]
            sd[i] = np.sqrt((s.kappa * measurements.u[b]) ** 2 + d * d * (s.specimen**2 + s.run**2))
        result = cls(groups, roots, bounds, np.maximum(sd, 1e-9))
        if measurements.zero_columns.shape[1] and groups:
            # V + Z Z' whitened: (1 + s^2)^-1/2 along each left singular vector of W Z.
            white = result.whiten(measurements.zero_columns)
            left, size, _ = np.linalg.svd(white, full_matrices=False)
            result.zeros = (left, 1.0 - 1.0 / np.sqrt(1.0 + size**2))
        return result

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Stacked roots of V^-1 times the groups' rows of ``values`` (n, ...)."""
        parts = [
            root.whiten(values[group.index])
            for group, root in zip(self.groups, self.roots, strict=True)
        ]
        return np.concatenate(parts) if parts else np.zeros((0, *values.shape[1:]))

    def with_nuisance(self, columns: np.ndarray) -> Weights:
        """The same weights with nuisance columns (n, q) fitted freely and silently."""
        white = self._beside_zeros(self.whiten(columns))
        size = np.linalg.norm(white, axis=0)
        q, _ = np.linalg.qr(white[:, size > 1e-9] / size[size > 1e-9])
        return Weights(self.groups, self.roots, self.bounds, self.bound_sd, q, self.zeros)

    def projected(self, white: np.ndarray) -> np.ndarray:
        """Whitened rows without what the nuisance columns can carry."""
        white = self._beside_zeros(white)
        if self.nuisance is None:
            return white
        return white - self.nuisance @ (self.nuisance.T @ white)

    def _beside_zeros(self, white: np.ndarray) -> np.ndarray:
        if self.zeros is None:
            return white
        left, share = self.zeros
        pulled = left.T @ white
        return white - left @ (share[:, None] * pulled if white.ndim > 1 else share * pulled)

    def residual(self, measurements: Measurements, prediction: np.ndarray) -> np.ndarray:
        """Whitened residuals; a bound adds sqrt(-2 ln P(truth above it))."""
        white = self.projected(self.whiten(measurements.y - prediction))
        if not len(self.bounds):
            return white
        z = (prediction[self.bounds] - measurements.y[self.bounds]) / self.bound_sd
        return np.concatenate([white, np.sqrt(np.maximum(-2 * log_ndtr(z), 0.0))])


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
        return {p.name: float(v) for p, v in zip(self.parameters, self.values, strict=True)}


def jacobian(
    measurements: Measurements,
    causes: tuple[str, ...],
    parameters: list[Parameter],
    values: np.ndarray,
    prediction: np.ndarray,
) -> np.ndarray:
    """d(prediction)/d(parameters), (n, p), by central differences of a tenth of each scale.

    Central, because slips have a kink where static and kinetic friction are equal: the null.
    """
    columns = []
    for j, parameter in enumerate(parameters):
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved[j] = np.clip(
                moved[j] + sign * 0.1 * parameter.scale, parameter.lower, parameter.upper
            )
            named = {p.name: float(v) for p, v in zip(parameters, moved, strict=True)}
            ends.append((moved[j], measurements.predict(named, causes)))
        columns.append((ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0]))
    return np.column_stack(columns) if columns else np.zeros((len(prediction), 0))


def fit(
    measurements: Measurements,
    weights: Weights,
    causes: tuple[str, ...],
    start: dict[str, float] | None = None,
) -> Fit:
    """Levenberg-Marquardt from ``start`` (missing parameters start at their null values).

    A very weak prior (:attr:`Parameter.prior_width`) keeps parameters finite that the data do not
    determine.

    Raises
    ------
    NotConverged
        If it still improves after `ITERATIONS_MAX` iterations: no verdict may hang on it.
    """
    parameters = parameters_of(measurements, causes)
    lower = np.array([p.lower for p in parameters])
    upper = np.array([p.upper for p in parameters])
    scale = np.array([p.scale for p in parameters])
    null = np.array([p.null for p in parameters])
    start = start or {}
    values = np.array([start.get(p.name, p.null) for p in parameters])
    width = np.array([p.prior_width for p in parameters])

    def evaluate(v):
        named = {p.name: float(x) for p, x in zip(parameters, v, strict=True)}
        prediction = measurements.predict(named, causes)
        residual = weights.residual(measurements, prediction)
        prior = (v - null) / width
        return prediction, residual, float(residual @ residual), float(prior @ prior)

    values = _better_side(values, parameters, start, evaluate)
    prediction, residual, chi2, prior = evaluate(values)
    damping = 1e-3
    for _ in range(ITERATIONS_MAX):
        columns = jacobian(measurements, causes, parameters, values, prediction)
        white = _whitened_jacobian(measurements, weights, columns, prediction)
        gradient = white.T @ residual - (values - null) / width**2
        curvature = white.T @ white + np.diag(1 / width**2)
        improved = False
        for _ in range(6):
            ridge = damping * np.diag(np.maximum(np.diag(curvature), 1.0 / scale**2 * 1e-6))
            step = np.linalg.solve(curvature + ridge, gradient)
            trial = np.clip(values + np.clip(step, -12 * scale, 12 * scale), lower, upper)
            new = evaluate(trial)
            if new[2] + new[3] <= chi2 + prior + 1e-9:
                improved = True
                break
            damping *= 8
        if not improved:
            break
        gain = chi2 + prior - new[2] - new[3]
        values, (prediction, residual, chi2, prior) = trial, new
        damping = max(damping / 6, 1e-7)
        if gain < 1e-3:
            break
    else:
        model = " with ".join(("plain friction", *causes))
        raise NotConverged(f"the fit of {model} did not converge in {ITERATIONS_MAX} iterations")
    columns = jacobian(measurements, causes, parameters, values, prediction)
    white = _whitened_jacobian(measurements, weights, columns, prediction)
    curvature = white.T @ white + np.diag(1 / width**2)
    covariance = np.linalg.inv(curvature)
    return Fit(causes, parameters, values, chi2, prediction, columns, covariance)


def _better_side(values, parameters, start, evaluate):
    """The best of the start and of one scale to either side of it, for kinked parameters."""
    for j, parameter in enumerate(parameters):
        if not parameter.kinked or start.get(parameter.name, parameter.null) != parameter.null:
            continue
        trials = []
        for shift in (0.0, parameter.scale, -parameter.scale):
            moved = values.copy()
            moved[j] = np.clip(moved[j] + shift, parameter.lower, parameter.upper)
            trials.append((evaluate(moved)[2], shift, moved))
        values = min(trials, key=lambda trial: trial[0])[2]
    return values


def _whitened_jacobian(measurements, weights, columns, prediction):
    """Derivative of minus the residual vector."""
    white = weights.projected(weights.whiten(columns))
    if not len(weights.bounds):
        return white
    b = weights.bounds
    z = (prediction[b] - measurements.y[b]) / weights.bound_sd
    log_p = log_ndtr(z)
    root = np.sqrt(np.maximum(-2 * log_p, 1e-12))
    hazard = np.exp(-0.5 * z**2 - log_p) / np.sqrt(2 * np.pi)
    return np.concatenate([white, (hazard / root / weights.bound_sd)[:, None] * columns[b]])
