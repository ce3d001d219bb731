"""The mixed model of features: noise of the instrument, scatter of runs within specimens.

A specimen's and a run's scatter multiply the friction, so they enter a feature through its
sensitivity d = d(feature) / d(ln mu): V = kappa^2 U + d d' (sigma_s^2 [same specimen]
+ sigma_r^2 [same run]) with U = diag(u^2). A run is one rank-one term, a specimen another, so that
V is never built. With sums over run j, A_j = sum d^2 / (kappa u)^2, T_j = sum d x / (kappa u)^2,

    f_j = 1 / (1 + sigma_r^2 A_j),  w_j = sigma_r^2 f_j,
    z_s = sigma_s^2 / (1 + sigma_s^2 sum_{j in s} A_j f_j),
    X' V^-1 Y = X' (kappa^2 U)^-1 Y - sum_j w_j T_j T_j' - sum_s z_s (sum_j f_j T_j)(...)',
    log |V| = sum log kappa^2 u^2 + sum_j log(1 + sigma_r^2 A_j) + sum_s log(1 + sigma_s^2 ...)

(Sherman and Morrison, once for runs and once for specimens).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from slipstitch.criticise.measurements import Measurements

# Prior of the understatement of the instrument's uncertainty: 1 to 1.5, log-normal.
KAPPA_MEDIAN, KAPPA_LOG_SD, KAPPA_LIMITS = 1.2, 0.18, (0.9, 2.5)
KAPPA_STARTS = (1.0, 1.5)
KAPPA_LOG_LIMITS = tuple(np.log(KAPPA_LIMITS))
SIGMA_LIMITS = (1e-4, 0.6)
TYPICAL_SIGMA = 0.015


class Scatter(NamedTuple):
    """Relative scatter between specimens and between runs, and the instrument's true noise."""

    specimen: float
    run: float
    kappa: float

    def log_prior(self) -> float:
        """Log density (no constant): keeps scatters off zero and kappa near what is usual."""
        z = np.log(self.kappa / KAPPA_MEDIAN) / KAPPA_LOG_SD
        return float(
            -0.5 * z * z
            + np.log(self.specimen / (self.specimen + TYPICAL_SIGMA))
            + np.log(self.run / (self.run + TYPICAL_SIGMA))
        )


START_SCATTER = Scatter(0.05, 0.03, 1.2)


def total_variance(
    protocol: np.ndarray, u: np.ndarray, sensitivity: np.ndarray, scatters: Mapping[str, Scatter]
) -> np.ndarray:
    """Variance of features (n,): instrument, specimen and run; of no known scatter, as usual."""
    known = [scatters.get(name, START_SCATTER) for name in protocol]
    specimen, run, kappa = np.reshape(known, (-1, 3)).T
    return (kappa * u) ** 2 + sensitivity**2 * (specimen**2 + run**2)


@dataclass
class Group:
    """The features of one protocol, as the covariance sees them.

    ``index`` places them among all features; ``astray`` is the variance of ln mu that the run has
    beyond the scatter of the others.
    """

    protocol: str
    index: np.ndarray
    u: np.ndarray
    sensitivity: np.ndarray
    specimen: np.ndarray
    run: np.ndarray
    astray: np.ndarray

    def _of_runs(self, scatter: Scatter) -> np.ndarray:
        """(n,) variance of each run's ln mu."""
        return scatter.run**2 + self.astray

    def variance(self, scatter: Scatter) -> np.ndarray:
        """V, (n, n)."""
        shared = scatter.specimen**2 * (self.specimen[:, None] == self.specimen[None, :])
        shared = shared + self._of_runs(scatter) * (self.run[:, None] == self.run[None, :])
        v = np.outer(self.sensitivity, self.sensitivity) * shared
        v[np.diag_indices_from(v)] += (scatter.kappa * self.u) ** 2
        return v

    def level(self) -> np.ndarray:
        """The fixed effect of the scatter's estimate, (n, 1): the level of friction."""
        d, size = self.sensitivity, np.linalg.norm(self.sensitivity)
        return (d / size)[:, None] if size > 0 else np.zeros((len(d), 0))

    def drawn(self, scatter: Scatter, rng: np.random.Generator, count: int) -> np.ndarray:
        """Residuals drawn from the covariance, (n, count)."""
        noise = (scatter.kappa * self.u)[:, None] * rng.standard_normal((len(self.u), count))
        _, run = np.unique(self.run, return_inverse=True)
        _, specimen = np.unique(self.specimen, return_inverse=True)
        shared = (
            scatter.specimen * rng.standard_normal((specimen.max() + 1, count))[specimen]
            + np.sqrt(self._of_runs(scatter))[:, None]
            * rng.standard_normal((run.max() + 1, count))[run]
        )
        return noise + self.sensitivity[:, None] * shared


def make_groups(measurements: Measurements, sensitivity: np.ndarray) -> list[Group]:
    """Groups of the features that are no bounds, a group a protocol."""
    m, groups = measurements, []
    for name in dict.fromkeys(m.protocol.tolist()):
        i = np.flatnonzero((m.protocol == name) & ~m.lower_bound)
        if len(i):
            arrays = (m.u, sensitivity, m.specimen, m.run, m.astray)
            groups.append(Group(name, i, *(array[i] for array in arrays)))
    return groups


def zeros_of(measurements: Measurements, group: Group) -> np.ndarray:
    """Columns of the zeros of a protocol's sensors, (features, z), each with unit prior sd."""
    own = [k for k, (protocol, _) in enumerate(measurements.zeros) if protocol == group.protocol]
    return measurements.zero_columns[np.ix_(group.index, own)]


def gram_of(
    groups: Iterable[Group], scatters: Mapping[str, Scatter], columns: np.ndarray
) -> np.ndarray:
    """X' V^-1 X of columns over all features (n, m), (m, m)."""
    gram = np.zeros((columns.shape[1], columns.shape[1]))
    for group in groups:
        gram += Clusters(group, columns[group.index]).gram(scatters[group.protocol])
    return gram


class Clusters:
    """Columns (n, m) of one protocol's features, reduced to sums over its runs."""

    def __init__(self, group: Group, columns: np.ndarray):
        count = len(group.u)
        # Runs in the order of their specimens, so that specimens are stretches of runs.
        _, first, run = np.unique(group.run, return_index=True, return_inverse=True)
        order = np.argsort(group.specimen[first], kind="stable")
        self._run = np.argsort(order)[run]
        self._order = np.argsort(self._run, kind="stable")
        self._runs = np.flatnonzero(np.diff(self._run[self._order], prepend=-1))
        _, self._specimens, self._specimen = np.unique(
            group.specimen[first][order], return_index=True, return_inverse=True
        )
        self._astray = group.astray[first][order]
        inverse = 1.0 / group.u**2
        self._inverse, self._pull = inverse[:, None], (group.sensitivity * inverse)[:, None]
        self.columns = columns
        self._information = self._over_runs(group.sensitivity**2 * inverse)
        self._gram_of_noise = columns.T @ (columns * self._inverse)
        self._of_runs = self._over_runs(columns * self._pull)
        self._log_u = float(2 * np.log(group.u).sum())
        self.readings_a_run = count / len(self._runs)

    def _over_runs(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[self._order], self._runs, axis=0)

    def _over_specimens(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, self._specimens, axis=0)

    def _weights(self, scatter: Scatter) -> tuple[np.ndarray, ...]:
        """f_j and w_j of runs, z_s of specimens, and the sum that lengthens each specimen."""
        information = self._information / scatter.kappa**2
        own = scatter.run**2 + self._astray
        free = 1.0 / (1.0 + own * information)
        told = scatter.specimen**2 * self._over_specimens(information * free)
        return free, own * free, scatter.specimen**2 / (1.0 + told), told

    def log_determinant(self, scatter: Scatter) -> float:
        """log |V|."""
        free, _, _, told = self._weights(scatter)
        noise = self._log_u + 2 * len(self._run) * np.log(scatter.kappa)
        return float(noise - np.log(free).sum() + np.log1p(told).sum())

    def gram(self, scatter: Scatter) -> np.ndarray:
        """X' V^-1 X, (m, m)."""
        free, taken, shared, _ = self._weights(scatter)
        runs = self._of_runs / scatter.kappa**2
        specimens = self._over_specimens(free[:, None] * runs)
        return (
            self._gram_of_noise / scatter.kappa**2
            - runs.T @ (taken[:, None] * runs)
            - specimens.T @ (shared[:, None] * specimens)
        )

    def responses(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums over responses (n, b) that no scatter changes, for :meth:`products`."""
        return (
            (self.columns * self._inverse).T @ values,
            self._over_runs(values * self._pull),
            (values**2 * self._inverse).sum(axis=0),
        )

    def products(self, scatter: Scatter, of) -> tuple[np.ndarray, np.ndarray]:
        """X' V^-1 Y, (m, b), and the diagonal of Y' V^-1 Y, (b,)."""
        with_columns, of_runs, squares = of
        free, taken, shared, _ = self._weights(scatter)
        noise = 1.0 / scatter.kappa**2
        runs, own = self._of_runs * noise, of_runs * noise
        pulled = taken[:, None] * own
        specimens = self._over_specimens(free[:, None] * runs)
        own_specimens = self._over_specimens(free[:, None] * own)
        carried = shared[:, None] * own_specimens
        score = with_columns * noise - runs.T @ pulled - specimens.T @ carried
        explained = (own * pulled).sum(axis=0) + (own_specimens * carried).sum(axis=0)
        return score, squares * noise - explained

    def solved(self, scatter: Scatter, values: np.ndarray) -> np.ndarray:
        """V^-1 Y of values (n, k)."""
        free, taken, shared, _ = self._weights(scatter)
        noise = 1.0 / scatter.kappa**2
        runs = self._over_runs(values * self._pull) * noise
        specimens = shared[:, None] * self._over_specimens(free[:, None] * runs)
        shift = taken[:, None] * runs + free[:, None] * specimens[self._specimen]
        return noise * (values * self._inverse - self._pull * shift[self._run])


def by_specimen(
    groups: Iterable[Group], scatters: Mapping[str, Scatter], columns: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of each specimen's features, and their share (m, m) of X' V^-1 X of columns (n, m)."""
    parts = []
    for group in groups:
        own = columns[group.index]
        weighted = Clusters(group, own).solved(scatters[group.protocol], own)
        for specimen in np.unique(group.specimen):
            mine = group.specimen == specimen
            parts.append((group.index[mine], weighted[mine].T @ own[mine]))
    return parts


def log_likelihood(clusters: Clusters, scatter: Scatter, fixed: int, restricted: bool) -> float:
    """Of the last column, the first ``fixed`` ones fitted freely, the others with unit prior sd.

    ``restricted``: the free columns are integrated out (REML), not maximised over.
    """
    # One factor holds all: its squared diagonal is what each column adds to those before it.
    last = clusters.columns.shape[1] - 1
    order = np.r_[fixed:last, :fixed, last]
    gram = clusters.gram(scatter)[np.ix_(order, order)]
    random = np.arange(last + 1) < last - fixed
    gram[np.diag_indices_from(gram)] += random
    gram[np.diag_indices(last)] *= 1.0 + 1e-9  # columns may be combinations of others
    added = np.linalg.cholesky(gram).diagonal() ** 2
    integrated = added[:last] if restricted else added[: last - fixed]
    return float(-0.5 * (clusters.log_determinant(scatter) + np.log(integrated).sum() + added[-1]))


def estimate_scatter(
    group: Group,
    residual: np.ndarray,
    fixed: np.ndarray,
    random: np.ndarray,
    start: Scatter = START_SCATTER,
    restricted: bool = True,
) -> tuple[Scatter, float]:
    """Scatter with a weak prior, by a simplex search, and its penalised log-likelihood.

    ``fixed`` columns are fitted freely (integrated out if ``restricted``: REML), ``random`` ones
    have unit prior sd.
    """
    clusters = Clusters(group, np.column_stack([fixed, random, residual]))

    def unpack(z):
        s, r = np.clip(np.exp(z[:2]), *SIGMA_LIMITS)
        return Scatter(float(s), float(r), float(np.clip(np.exp(z[2]), *KAPPA_LIMITS)))

    def cost(z):
        scatter = unpack(z)
        value = log_likelihood(clusters, scatter, fixed.shape[1], restricted)
        outside = np.sum(np.maximum(np.abs(z[:2] - np.log(0.03)) - 5.5, 0))
        outside += max(z[2] - KAPPA_LOG_LIMITS[1], KAPPA_LOG_LIMITS[0] - z[2], 0.0)
        return -value - scatter.log_prior() + 10 * outside

    # Not from a limit: beyond it the likelihood is flat, and the search would stay there.
    kappa = np.clip(start.kappa, *KAPPA_STARTS)
    first = np.log([max(start.specimen, 0.004), max(start.run, 0.004), kappa])
    simplex = np.vstack([first, first + np.diag([0.5, 0.5, 0.15])])
    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.03, "fatol": 0.01, "maxfev": 90},
    )
    return unpack(found.x), -float(found.fun)
