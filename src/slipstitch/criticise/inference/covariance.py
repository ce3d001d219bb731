"""Variance of features: instrument, specimen and run, estimated protocol by protocol.

A specimen's and a run's scatter multiply the friction, so they enter a feature through its
sensitivity d = d(feature) / d(ln mu): V = kappa^2 u^2 I + d d' (sigma_s^2 [same specimen]
+ sigma_r^2 [same run]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def whitening(self, scatter: Scatter) -> Whitening:
        """A root of the inverse of :meth:`variance`."""
        return Whitening(self, scatter)

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


class Whitening:
    """W with W'W = V^-1, applied in a time that grows with the features.

    In units of the noise a run adds sigma_r^2 g g' to the identity, and a specimen, seen after
    that, sigma_s^2 h h'; each is undone by 1 - (1 - (1 + sigma^2 |g|^2)^-1/2) e e' with the unit
    vector e.

    Attributes
    ----------
    noise : (n,) kappa u.
    run, specimen : (n,) unit vectors, one a run or specimen.
    run_share, specimen_share : (n,) 1 - (1 + sigma^2 |.|^2)^-1/2 of the feature's own.
    """

    def __init__(self, group: Group, scatter: Scatter):
        self.noise = scatter.kappa * group.u
        self._runs, self._specimens = _Sums(group.run), _Sums(group.specimen)
        g = group.sensitivity / self.noise
        self.run, self.run_share, lengthened = _unit(self._runs, g, scatter.run)
        self.left = g / lengthened
        self.specimen, self.specimen_share, _ = _unit(self._specimens, self.left, scatter.specimen)

    def _without(self, values, sums: _Sums, unit, share):
        wide = (slice(None),) + (None,) * (values.ndim - 1)
        return values - (unit * share)[wide] * sums.spread(unit[wide] * values)

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """W x of the rows of ``values`` (n, ...)."""
        wide = (slice(None),) + (None,) * (values.ndim - 1)
        result = self._without(values / self.noise[wide], self._runs, self.run, self.run_share)
        return self._without(result, self._specimens, self.specimen, self.specimen_share)

    def pull(self, white: np.ndarray) -> np.ndarray:
        """W' x; of whitened rows it gives V^-1 x."""
        wide = (slice(None),) + (None,) * (white.ndim - 1)
        result = self._without(white, self._specimens, self.specimen, self.specimen_share)
        return self._without(result, self._runs, self.run, self.run_share) / self.noise[wide]

    def information_of_runs(self) -> np.ndarray:
        """(n,) d' V^-1 d with d the sensitivities of the feature's own run, zero elsewhere."""
        own = self._runs.spread(self.left**2)
        along = self._runs.spread(self.specimen * self.left)
        return own - (1.0 - (1.0 - self.specimen_share) ** 2) * along**2

    def diagonal(self) -> np.ndarray:
        """(n,) diagonal of V^-1."""
        in_run = 1.0 - (1.0 - (1.0 - self.run_share) ** 2) * self.run**2
        along = self.specimen - self.run * self.run_share * self._runs.spread(
            self.run * self.specimen
        )
        in_specimen = (1.0 - (1.0 - self.specimen_share) ** 2) * along**2
        return (in_run - in_specimen) / self.noise**2


class _Sums:
    """Sums over the features with the same label."""

    def __init__(self, labels: np.ndarray):
        _, self._of = np.unique(labels, return_inverse=True)
        self._order = np.argsort(self._of, kind="stable")
        self._starts = np.flatnonzero(np.diff(self._of[self._order], prepend=-1))

    def spread(self, values: np.ndarray) -> np.ndarray:
        """The sum of (n, ...) over each label, at every feature of it."""
        if not len(values):
            return values
        return np.add.reduceat(values[self._order], self._starts, axis=0)[self._of]


def _unit(sums: _Sums, vector: np.ndarray, sd: float):
    """Unit vectors along a vector label by label, their shares, and what lengthens them."""
    squares = sums.spread(vector**2)
    lengthened = np.sqrt(1.0 + sd**2 * squares)
    unit = vector / np.sqrt(np.where(squares > 0, squares, 1.0))
    return unit, 1.0 - 1.0 / lengthened, lengthened


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
