"""Variance of features: instrument, specimen and run, estimated protocol by protocol.

A specimen's and a run's scatter multiply the friction, so they enter a feature through its
sensitivity d = d(feature) / d(ln mu): V = kappa^2 u^2 I + d d' (sigma_s^2 [same specimen]
+ sigma_r^2 [same run]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky

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

    ``index`` places them among all features; ``sensitivity`` is d(feature)/d(ln mu); ``specimen``
    and ``run`` are numbers.
    """

    protocol: str
    index: np.ndarray
    u: np.ndarray
    sensitivity: np.ndarray
    specimen: np.ndarray
    run: np.ndarray

    def variance(self, scatter: Scatter) -> np.ndarray:
        """V, (n, n)."""
        shared = scatter.specimen**2 * (self.specimen[:, None] == self.specimen[None, :])
        shared = shared + scatter.run**2 * (self.run[:, None] == self.run[None, :])
        v = np.outer(self.sensitivity, self.sensitivity) * shared
        v[np.diag_indices_from(v)] += (scatter.kappa * self.u) ** 2
        return v

    def part(self, kept: np.ndarray) -> Group:
        """The features at some places of this group."""
        return Group(
            self.protocol,
            self.index[kept],
            self.u[kept],
            self.sensitivity[kept],
            self.specimen[kept],
            self.run[kept],
        )


def make_groups(
    measurements: Measurements, sensitivity: np.ndarray, keep: np.ndarray
) -> list[Group]:
    """Groups of the kept features, a group a protocol."""
    groups = []
    for name in dict.fromkeys(measurements.protocol.tolist()):
        index = np.flatnonzero((measurements.protocol == name) & keep)
        if len(index):
            groups.append(
                Group(
                    name,
                    index,
                    measurements.u[index],
                    sensitivity[index],
                    measurements.specimen[index],
                    measurements.run[index],
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
