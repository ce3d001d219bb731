"""Tests for structure in residuals, their family-wise error by simulating the maximum.

The simulation draws data under the fitted model, estimates the scatter anew in every replicate
(as was done with the data) and takes the largest statistic over all tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.special import gammaln
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.inference.covariance import (
    Group,
    Scatter,
    restricted_projection,
    scatter_grid,
    scatter_prior,
)

IDENTIFIED = 1e-4


@dataclass(frozen=True)
class Test:
    """One alternative: columns over all features, beside nuisance columns that cost nothing.

    Attributes
    ----------
    mechanism : identifier, if it is a mechanism's own effect; otherwise a generic ``shape`` (in
        words) along a ``covariate``.
    scanned : one of a row of shapes that differ by their place or period.
    spanned : its columns are combinations of other tests' columns.
    """

    columns: np.ndarray
    nuisance: np.ndarray | None = None
    mechanism: str | None = None
    covariate: str | None = None
    shape: str = ""
    scanned: bool = False
    spanned: bool = False

    @property
    def family(self) -> str:
        """Within which the error is controlled."""
        return "generic" if self.mechanism is None else "mechanism"


@dataclass
class Outcome:
    """Result of a set of tests.

    ``statistic`` is divided by ``inflation`` (its simulated mean over the degrees of freedom).
    """

    tests: list[Test]
    statistic: np.ndarray
    degrees: np.ndarray
    inflation: np.ndarray
    log_p: np.ndarray
    adjusted: np.ndarray
    family_p: dict[str, float]

    def mechanism_inflation(self) -> dict[str, float]:
        """Largest inflation of every mechanism's tests."""
        result: dict[str, float] = {}
        for test, value in zip(self.tests, self.inflation, strict=True):
            if test.mechanism is not None:
                result[test.mechanism] = max(result.get(test.mechanism, 1.0), float(value))
        return result

    def strongest(self, family: str | None = None) -> int | None:
        """Index of the most significant test (of a family)."""
        candidates = [
            i
            for i, t in enumerate(self.tests)
            if (family is None or t.family == family) and np.isfinite(self.log_p[i])
        ]
        return max(candidates, key=lambda i: self.log_p[i]) if candidates else None


class _Layout:
    """Which entries of the Gram matrix the tests need, and where they lie in a flat record."""

    def __init__(self, base: int, columns: int, slots: list[tuple[np.ndarray, np.ndarray]]):
        self.base, self.columns, self.slots = base, columns, slots
        m = np.arange(columns)
        rows = [np.repeat(np.arange(base), base), np.repeat(np.arange(base), columns), base + m]
        cols = [np.tile(np.arange(base), base), np.tile(base + m, base), base + m]
        position = base * base + base * columns + columns
        self.blocks: list[tuple[int, np.ndarray] | None] = []
        for own, nuisance in slots:
            if len(own) == 1 and not len(nuisance):
                self.blocks.append(None)
                continue
            index = np.concatenate([nuisance, own]).astype(int)
            rows.append(base + np.repeat(index, len(index)))
            cols.append(base + np.tile(index, len(index)))
            self.blocks.append((position, index))
            position += len(index) ** 2
        self.rows, self.cols = np.concatenate(rows), np.concatenate(cols)
        self.size = position

    def take(self, gram: np.ndarray) -> np.ndarray:
        """The needed entries of one Gram matrix."""
        return gram[self.rows, self.cols]

    def statistics(self, record: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Score statistics (replicates, tests) and degrees of freedom (by the first replicate)."""
        k, m, n = self.base, self.columns, len(record)
        a = record[:, : k * k].reshape(n, k, k)
        c = record[:, k * k : k * k + k * m].reshape(n, k, m)
        raw = record[:, k * k + k * m : k * k + k * m + m]
        size = np.sqrt(np.maximum(np.einsum("bii->bi", a), 1e-300))
        scaled = a / size[:, :, None] / size[:, None, :] + 1e-9 * np.eye(k)
        w = np.linalg.solve(scaled, c / size[:, :, None]) / size[:, :, None]
        diagonal = raw - np.einsum("bkm,bkm->bm", c, w)
        rest = score[:, k:] - np.einsum("bkm,bk->bm", w, score[:, :k])
        result, degrees = np.zeros((n, len(self.slots))), np.zeros(len(self.slots), int)
        for t, ((own, nuisance), block) in enumerate(zip(self.slots, self.blocks, strict=True)):
            if block is None:
                j = own[0]
                good = diagonal[:, j] > IDENTIFIED * raw[:, j] + 1e-12
                result[:, t] = np.where(
                    good, rest[:, j] ** 2 / np.where(good, diagonal[:, j], 1.0), 0.0
                )
                degrees[t] = int(good[0])
                continue
            start, index = block
            width = len(index)
            inner = record[:, start : start + width**2].reshape(n, width, width)
            inner = inner - np.einsum("bki,bkj->bij", c[:, :, index], w[:, :, index])
            free = len(nuisance)
            both, d_both = _quadratic(inner, rest[:, index], raw[:, index])
            alone, d_alone = _quadratic(
                inner[:, :free, :free], rest[:, index[:free]], raw[:, index[:free]]
            )
            result[:, t] = np.maximum(both - alone, 0.0)
            degrees[t] = d_both - d_alone
        return result, degrees


def _quadratic(inner, rest, raw):
    if not inner.shape[1]:
        return np.zeros(len(inner)), 0
    scale = np.sqrt(np.maximum(raw[0], 1e-12))
    values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
    good = values > 10 * IDENTIFIED
    turned = np.einsum("bij,bi->bj", vectors, rest / scale)
    total = np.where(good, turned**2 / np.where(good, values, 1.0), 0.0).sum(axis=1)
    return total, int(good[0].sum())


def run_tests(
    tests: list[Test],
    base: np.ndarray,
    residual: np.ndarray,
    groups: list[Group],
    scatters: dict[str, Scatter],
    rich: dict[str, np.ndarray],
    rng: np.random.Generator,
    replicates: int = 300,
) -> Outcome:
    """Test every alternative given the base columns.

    Parameters
    ----------
    base : (n, k) columns of the fitted model (derivatives by its parameters).
    residual : (n,) measured minus fitted.
    rich : protocol -> (features of its group, q) shrunken columns of the scatter's estimate.
    """
    blocks, slots, position = [base], [], base.shape[1]
    for test in tests:
        nuisance = test.nuisance if test.nuisance is not None else np.zeros((len(residual), 0))
        blocks += [nuisance, test.columns]
        k, q = nuisance.shape[1], test.columns.shape[1]
        start = position - base.shape[1]
        slots.append((np.arange(start + k, start + k + q), np.arange(start, start + k)))
        position += k + q
    columns = np.column_stack(blocks)
    m = columns.shape[1]
    layout = _Layout(base.shape[1], m - base.shape[1], slots)
    data_gram, data_score = np.zeros((1, layout.size)), np.zeros((1, m))
    grams, scores = np.zeros((replicates, layout.size)), np.zeros((replicates, m))
    for group in groups:
        z = columns[group.index]
        scatter = scatters[group.protocol]
        variance = group.variance(scatter)
        factor = cholesky(variance, lower=True, check_finite=False)
        solved = cho_solve((factor, True), z, check_finite=False)
        data_gram[0] += layout.take(z.T @ solved)
        data_score[0] += solved.T @ residual[group.index]
        drawn = factor @ rng.standard_normal((len(group.index), replicates))
        grid = scatter_grid(scatter)
        fixed = base[group.index]
        fixed = fixed[:, np.abs(fixed).max(axis=0, initial=0) > 0]
        q, r = np.linalg.qr(fixed / np.maximum(np.linalg.norm(fixed, axis=0), 1e-300))
        fixed = q[:, np.abs(np.diag(r)) > 1e-6]
        own = rich[group.protocol]
        shared = own @ own.T
        likelihood = np.empty((len(grid), replicates))
        for i, candidate in enumerate(grid):
            p, logdet = restricted_projection(group.variance(candidate) + shared, fixed)
            quadratic = np.einsum("ij,ij->j", drawn, p @ drawn)
            likelihood[i] = -0.5 * (logdet + quadratic) + scatter_prior(candidate)
        choice = np.argmax(likelihood, axis=0)
        for i in np.unique(choice):
            mine = choice == i
            factor = cholesky(group.variance(grid[i]), lower=True, check_finite=False)
            solved = cho_solve((factor, True), z, check_finite=False)
            grams[mine] += layout.take(z.T @ solved)
            scores[mine] += drawn[:, mine].T @ solved
    observed, degrees = layout.statistics(data_gram, data_score)
    simulated, _ = layout.statistics(grams, scores)
    observed = observed[0]
    usable = degrees > 0
    safe = np.maximum(degrees, 1)
    inflation = np.maximum(simulated.mean(axis=0) / safe, 0.7)
    log_p = _minus_log10(observed / inflation, safe)
    log_null = _minus_log10(simulated / inflation, safe[None, :])
    log_p = np.where(usable, log_p, -np.inf)
    log_null[:, ~usable] = -np.inf
    adjusted = np.ones(len(tests))
    family_p: dict[str, float] = {}
    for family in dict.fromkeys(test.family for test in tests):
        mine = np.array([test.family == family for test in tests]) & usable
        if not mine.any():
            family_p[family] = 1.0
            continue
        largest = np.sort(log_null[:, mine].max(axis=1))
        above = len(largest) - np.searchsorted(largest, log_p[mine] - 1e-12)
        adjusted[mine] = (1 + above) / (1 + replicates)
        # Beyond the simulated maxima, Bonferroni by the tests' effective number.
        count = 10.0 ** np.median(largest) * np.log(2.0)
        tail = np.minimum(1.0, max(count, 1.0) * 3 * 10.0 ** -log_p[mine])
        adjusted[mine] = np.where(above == 0, np.minimum(adjusted[mine], tail), adjusted[mine])
        family_p[family] = float(adjusted[mine].min())
    return Outcome(tests, observed / inflation, degrees, inflation, log_p, adjusted, family_p)


def _minus_log10(statistic, degrees):
    """-log10 of the upper tail of chi squared, by its leading asymptotic term far out."""
    x, half = np.broadcast_arrays(np.maximum(statistic, 0.0), np.asarray(degrees) / 2.0)
    far = x > 400.0
    with np.errstate(divide="ignore"):
        exact = chi_square.logsf(np.where(far, 1.0, x), 2 * half)
        tail = (half - 1) * np.log(np.maximum(x, 1.0) / 2) - x / 2 - gammaln(half)
    return -np.where(far, tail, exact) / np.log(10.0)
