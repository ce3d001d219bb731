"""The covariance of clustered features without its matrix: sums over runs and specimens.

V = kappa^2 U + d d' (sigma_s^2 [same specimen] + sigma_r^2 [same run]) with U diagonal: a run is
one rank-one term, a specimen another. With sums over run j, A_j = sum d^2 / (kappa u)^2 and
T_j = sum d x / (kappa u)^2 (Sherman and Morrison, once for runs and once for specimens),

    w_j = sigma_r^2 / (1 + sigma_r^2 A_j),  f_j = 1 / (1 + sigma_r^2 A_j),
    z_s = sigma_s^2 / (1 + sigma_s^2 sum_{j in s} A_j f_j),
    X' V^-1 Y = X' (kappa^2 U)^-1 Y - sum_j w_j T_j T_j' - sum_s z_s (sum_j f_j T_j)(...)',
    log |V| = sum log kappa^2 u^2 + sum_j log(1 + sigma_r^2 A_j) + sum_s log(1 + sigma_s^2 ...),

so that the cost grows with the runs and not with the cube of the features.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.inference.covariance import Group, Scatter


@dataclass(frozen=True)
class _Pieces:
    """What one scatter makes of the clusters: weights of runs and specimens, log |V|."""

    run: np.ndarray
    free: np.ndarray
    specimen: np.ndarray
    log_determinant: float


@dataclass(frozen=True)
class Responses:
    """Sums of responses (n, b) that do not depend on the scatter."""

    with_columns: np.ndarray
    of_runs: np.ndarray
    squares: np.ndarray


class Clusters:
    """Columns (n, m) of one protocol's features, reduced to sums over its runs."""

    def __init__(self, group: Group, columns: np.ndarray):
        self.count = len(group.u)
        # Runs in the order of their specimens, so that specimens are stretches of runs.
        _, run = np.unique(group.run, return_inverse=True)
        first = np.zeros(run.max() + 1, int)
        first[run[::-1]] = np.arange(self.count)[::-1]
        by_specimen = np.argsort(group.specimen[first], kind="stable")
        rank = np.empty_like(by_specimen)
        rank[by_specimen] = np.arange(len(by_specimen))
        self._order = np.argsort(rank[run], kind="stable")
        ordered = rank[run][self._order]
        self._runs = np.flatnonzero(np.diff(ordered, prepend=-1))
        of_run = group.specimen[first][by_specimen]
        self._specimens = np.flatnonzero(np.r_[True, of_run[1:] != of_run[:-1]])
        inverse = 1.0 / group.u**2
        self._inverse, self._pull = inverse[:, None], (group.sensitivity * inverse)[:, None]
        self.columns = columns
        self.information = self._over_runs(group.sensitivity**2 * inverse)
        self.gram_of_noise = columns.T @ (columns * self._inverse)
        self.of_runs = self._over_runs(columns * self._pull)
        self._log_u = float(2 * np.log(group.u).sum())

    def _over_runs(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[self._order], self._runs, axis=0)

    def _over_specimens(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, self._specimens, axis=0)

    def _pieces(self, scatter: Scatter) -> _Pieces:
        run, specimen = scatter.run**2, scatter.specimen**2
        information = self.information / scatter.kappa**2
        free = 1.0 / (1.0 + run * information)
        told = self._over_specimens(information * free)
        log_determinant = (
            self._log_u
            + 2 * self.count * np.log(scatter.kappa)
            - np.log(free).sum()
            + np.log1p(specimen * told).sum()
        )
        return _Pieces(run * free, free, specimen / (1.0 + specimen * told), float(log_determinant))

    def responses(self, values: np.ndarray) -> Responses:
        """Sums over responses (n, b), for :meth:`products`."""
        return Responses(
            (self.columns * self._inverse).T @ values,
            self._over_runs(values * self._pull),
            (values**2 * self._inverse).sum(axis=0),
        )

    def log_determinant(self, scatter: Scatter) -> float:
        """log |V|."""
        return self._pieces(scatter).log_determinant

    def gram(self, scatter: Scatter) -> np.ndarray:
        """X' V^-1 X, (m, m)."""
        pieces = self._pieces(scatter)
        noise = 1.0 / scatter.kappa**2
        runs = self.of_runs * noise
        specimens = self._over_specimens(pieces.free[:, None] * runs)
        return (
            self.gram_of_noise * noise
            - runs.T @ (pieces.run[:, None] * runs)
            - specimens.T @ (pieces.specimen[:, None] * specimens)
        )

    def products(self, scatter: Scatter, of: Responses) -> tuple[np.ndarray, np.ndarray]:
        """X' V^-1 Y, (m, b), and the diagonal of Y' V^-1 Y, (b,)."""
        pieces = self._pieces(scatter)
        noise = 1.0 / scatter.kappa**2
        runs, own = self.of_runs * noise, of.of_runs * noise
        pulled = pieces.run[:, None] * own
        specimens = self._over_specimens(pieces.free[:, None] * runs)
        own_specimens = self._over_specimens(pieces.free[:, None] * own)
        shared = pieces.specimen[:, None] * own_specimens
        score = of.with_columns * noise - runs.T @ pulled - specimens.T @ shared
        squares = (
            of.squares * noise - (own * pulled).sum(axis=0) - (own_specimens * shared).sum(axis=0)
        )
        return score, squares

    def rows(self, scatters: list[Scatter], fixed: np.ndarray) -> np.ndarray:
        """Some rows of X' V^-1 X at many scatters, (scatters, len(fixed), m)."""
        noise, run, specimen, sums = self._stacked(scatters)
        result = noise[:, None, None] * self.gram_of_noise[fixed]
        for j, column in enumerate(fixed):
            result[:, j] -= (run * self.of_runs[:, column]) @ self.of_runs
        weighted = (specimen[:, :, None] * sums[:, :, fixed]).transpose(0, 2, 1)
        return result - weighted @ sums

    def blocks(self, scatters: list[Scatter], index: np.ndarray) -> np.ndarray:
        """Diagonal blocks of X' V^-1 X of columns (t, k) at many scatters, (scatters, t, k, k)."""
        noise, run, specimen, sums = self._stacked(scatters)
        left = np.broadcast_to(index[:, :, None], (*index.shape, index.shape[1])).ravel()
        right = np.broadcast_to(index[:, None, :], (*index.shape, index.shape[1])).ravel()
        result = np.outer(noise, self.gram_of_noise[left, right])
        result -= run @ (self.of_runs[:, left] * self.of_runs[:, right])
        for s in range(sums.shape[1]):
            result -= specimen[:, s, None] * sums[:, s, left] * sums[:, s, right]
        return result.reshape(len(noise), *index.shape, index.shape[1])

    def _stacked(self, scatters: list[Scatter]):
        """1 / kappa^2, w_j / kappa^4, z_s / kappa^4 and sums of f_j T_j, a row a scatter."""
        pieces = [self._pieces(scatter) for scatter in scatters]
        noise = np.array([1.0 / scatter.kappa**2 for scatter in scatters])
        run = np.stack([p.run for p in pieces]) * noise[:, None] ** 2
        specimen = np.stack([p.specimen for p in pieces]) * noise[:, None] ** 2
        free = np.stack([p.free for p in pieces])
        ends = [*self._specimens[1:], len(self.of_runs)]
        sums = np.stack(
            [free[:, a:b] @ self.of_runs[a:b] for a, b in zip(self._specimens, ends, strict=True)],
            axis=1,
        )
        return noise, run, specimen, sums

    def drawn(
        self, group: Group, scatter: Scatter, rng: np.random.Generator, count: int
    ) -> np.ndarray:
        """Residuals drawn from the covariance, (n, count)."""
        noise = (scatter.kappa * group.u)[:, None] * rng.standard_normal((self.count, count))
        _, run = np.unique(group.run, return_inverse=True)
        _, specimen = np.unique(group.specimen, return_inverse=True)
        shared = (
            scatter.specimen * rng.standard_normal((specimen.max() + 1, count))[specimen]
            + scatter.run * rng.standard_normal((run.max() + 1, count))[run]
        )
        return noise + group.sensitivity[:, None] * shared


def log_likelihood(
    clusters: Clusters, scatter: Scatter, of: Responses, fixed: int, restricted: bool
) -> float:
    """Of one response, the first ``fixed`` columns fitted freely, the others with unit prior sd.

    ``restricted``: the free columns are integrated out (REML), not maximised over.
    """
    gram = clusters.gram(scatter)
    score, squares = clusters.products(scatter, of)
    score, value = score[:, 0], clusters.log_determinant(scatter) + squares[0]
    if len(gram):
        own = gram + np.diag(np.where(np.arange(len(gram)) < fixed, 0.0, 1.0))
        own[np.diag_indices_from(own)] *= 1.0 + 1e-10
        value -= score @ np.linalg.solve(own, score)
        integrated = own if restricted else own[fixed:, fixed:]
        value += np.linalg.slogdet(integrated)[1]
    return float(-0.5 * value)
