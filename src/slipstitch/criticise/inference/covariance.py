"""Variance of features: instrument, specimen and run, estimated protocol by protocol.

A specimen's and a run's scatter multiply the friction, so they enter a feature through its
sensitivity d = d(feature) / d(ln mu): V = kappa^2 u^2 I + d d' (sigma_s^2 [same specimen]
+ sigma_r^2 [same run]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from slipstitch.criticise.measurements import Measurements

# Prior of the understatement of the instrument's uncertainty: 1 to 1.5, log-normal.
KAPPA_MEDIAN, KAPPA_LOG_SD, KAPPA_LIMITS = 1.2, 0.18, (0.9, 2.5)
KAPPA_STARTS = (1.0, 1.5)
KAPPA_LOG_LIMITS = tuple(np.log(KAPPA_LIMITS))
SIGMA_LIMITS = (1e-4, 0.6)


@dataclass(frozen=True)
class Scatter:
    """Relative scatter between specimens and between runs, and the instrument's true noise."""

    specimen: float
    run: float
    kappa: float


@dataclass
class Group:
    """The features of one protocol, as the covariance sees them.

    ``index`` places them among all features; ``sensitivity`` is d(feature)/d(ln mu).
    """

    protocol: str
    index: np.ndarray
    u: np.ndarray
    sensitivity: np.ndarray
    same_specimen: np.ndarray
    same_run: np.ndarray

    def variance(self, scatter: Scatter) -> np.ndarray:
        """V, (n, n)."""
        shared = scatter.specimen**2 * self.same_specimen + scatter.run**2 * self.same_run
        v = np.outer(self.sensitivity, self.sensitivity) * shared
        v[np.diag_indices_from(v)] += (scatter.kappa * self.u) ** 2
        return v


def make_groups(
    measurements: Measurements, sensitivity: np.ndarray, keep: np.ndarray
) -> list[Group]:
    """Groups of the kept features, a group a protocol."""
    groups = []
    run, specimen = measurements.run, measurements.specimen
    for name in dict.fromkeys(measurements.protocol.tolist()):
        index = np.flatnonzero((measurements.protocol == name) & keep)
        if len(index):
            groups.append(
                Group(
                    name,
                    index,
                    measurements.u[index],
                    sensitivity[index],
                    (specimen[index][:, None] == specimen[index][None, :]).astype(float),
                    (run[index][:, None] == run[index][None, :]).astype(float),
                )
            )
    return groups


def scatter_prior(scatter: Scatter) -> float:
    """Log density (no constant): keeps scatters off zero and kappa near what is usual."""
    z = np.log(scatter.kappa / KAPPA_MEDIAN) / KAPPA_LOG_SD
    return float(
        -0.5 * z * z
        + np.log(scatter.specimen / (scatter.specimen + 0.015))
        + np.log(scatter.run / (scatter.run + 0.015))
    )


def restricted_projection(variance: np.ndarray, fixed: np.ndarray) -> tuple[np.ndarray, float]:
    """P = M^-1 - M^-1 F (F' M^-1 F)^-1 F' M^-1 and log|M| + log|F' M^-1 F|."""
    factor = cholesky(variance, lower=True, check_finite=False)
    inverse = cho_solve((factor, True), np.eye(len(variance)), check_finite=False)
    logdet = 2 * np.log(np.diag(factor)).sum()
    if fixed.shape[1] == 0:
        return inverse, logdet
    weighted = inverse @ fixed
    information = fixed.T @ weighted
    projection = inverse - weighted @ np.linalg.solve(information, weighted.T)
    return projection, logdet + float(np.linalg.slogdet(information)[1])


def restricted_log_likelihood(
    group: Group, scatter: Scatter, residual: np.ndarray, fixed: np.ndarray, rich: np.ndarray
) -> float:
    """REML under a rich model whose effects are shrunken (random with unit prior sd).

    The null would count effects as scatter; the saturated model would explain outliers away.
    """
    variance = group.variance(scatter) + rich @ rich.T
    factor = cholesky(variance, lower=True, check_finite=False)
    both = solve_triangular(
        factor, np.column_stack([residual, fixed]), lower=True, check_finite=False
    )
    r, f = both[:, 0], both[:, 1:]
    value = 2 * np.log(np.diag(factor)).sum() + r @ r
    if f.shape[1]:
        information = f.T @ f
        value += np.linalg.slogdet(information)[1] - (f.T @ r) @ np.linalg.solve(
            information, f.T @ r
        )
    return float(-0.5 * value)


def estimate_scatter(
    group: Group,
    residual: np.ndarray,
    fixed: np.ndarray,
    rich: np.ndarray,
    start: Scatter | None = None,
) -> Scatter:
    """REML with a weak prior, by a simplex search."""
    start = start or Scatter(0.04, 0.03, KAPPA_MEDIAN)

    def unpack(z):
        s, r = np.clip(np.exp(z[:2]), *SIGMA_LIMITS)
        return Scatter(float(s), float(r), float(np.clip(np.exp(z[2]), *KAPPA_LIMITS)))

    def cost(z):
        scatter = unpack(z)
        try:
            value = restricted_log_likelihood(group, scatter, residual, fixed, rich)
        except np.linalg.LinAlgError:
            return 1e12
        outside = np.sum(np.maximum(np.abs(z[:2] - np.log(0.03)) - 5.5, 0))
        outside += max(z[2] - KAPPA_LOG_LIMITS[1], KAPPA_LOG_LIMITS[0] - z[2], 0.0)
        return -value - scatter_prior(scatter) + 10 * outside

    # Not from a limit: beyond it the likelihood is flat, and the search would stay there.
    kappa = np.clip(start.kappa, *KAPPA_STARTS)
    first = np.log([start.specimen, start.run, kappa])
    simplex = np.vstack([first, first + np.diag([0.5, 0.5, 0.15])])
    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.03, "fatol": 0.01, "maxfev": 90},
    )
    return unpack(found.x)


def scatter_grid(centre: Scatter) -> list[Scatter]:
    """Scatters around an estimate, among which a bootstrap replicate chooses its own."""
    steps = np.array([0.4, 0.7, 1.0, 1.35, 1.8])
    specimen = np.union1d(max(centre.specimen, 0.008) * steps, [centre.specimen])
    run = np.union1d(max(centre.run, 0.008) * steps, [centre.run])
    kappas = np.clip(centre.kappa * np.array([0.85, 1.0, 1.18]), *KAPPA_LIMITS)
    return [Scatter(float(a), float(b), float(k)) for a in specimen for b in run for k in kappas]
