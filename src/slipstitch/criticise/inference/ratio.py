"""Likelihood ratios of alternatives, the scatter refitted under each; error by simulation.

A score test keeps the scatter of the null, which an effect has swelled: it saturates. Here every
alternative has the scatter that suits it best, protocol by protocol, out of a grid. Each is tested
in every protocol alone and in all of them together, so that a further protocol costs a little of
the multiplicity but takes no evidence away. The largest of all statistics is simulated under the
fitted model; the rule that picks scatters is the same in data and replicates, so the grid needs
not be fine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slipstitch.criticise.inference.clusters import Clusters, Responses
from slipstitch.criticise.inference.covariance import (
    KAPPA_LIMITS,
    Group,
    Scatter,
    scatter_prior,
)
from slipstitch.criticise.inference.structure import Outcome, Test, outcome_of

# A column that other columns make up to this is not identified.
IDENTIFIED = 1e-4
SMALLEST_CENTRE = 0.01
SIGMA_STEPS = (0.15, 0.4, 0.7, 1.0, 1.4)
KAPPA_STEPS = (0.55, 0.75, 0.9, 1.0, 1.15)
KAPPA_STEPS_ALONE = (0.8, 1.0)
# A row of simulated data sets; more follow while the p may lie on either side of a limit.
ROUND = 100


def scatter_grid(centre: Scatter, readings_a_run: float) -> list[Scatter]:
    """Scatters around and below an estimate of the null, which effects can only have swelled.

    With one reading a run the noise of instrument and of runs can hardly be told apart.
    """
    specimen = max(centre.specimen, SMALLEST_CENTRE) * np.array(SIGMA_STEPS)
    run = max(centre.run, SMALLEST_CENTRE) * np.array(SIGMA_STEPS)
    steps = KAPPA_STEPS if readings_a_run > 1.5 else KAPPA_STEPS_ALONE
    kappas = np.unique(np.clip(centre.kappa * np.array(steps), *KAPPA_LIMITS))
    found = [Scatter(float(a), float(b), float(k)) for a in specimen for b in run for k in kappas]
    return [*found, centre]


@dataclass
class _Set:
    """Tests with the same nuisance columns: their base, and each test's columns."""

    base: np.ndarray
    tests: list[int]
    own: list[np.ndarray]


@dataclass
class _Protocol:
    """One protocol: its sums, and the Gram matrix at each scatter of its grid."""

    group: Group
    clusters: Clusters
    centre: Scatter
    grid: list[Scatter]
    grams: np.ndarray
    constants: np.ndarray


class Ratios:
    """Likelihood ratios of a set of tests beside a fitted model.

    Parameters
    ----------
    tests : alternatives, each with its columns over all features.
    base : (n, k) derivatives of the fitted model by its parameters.
    shrunken : (n, z) columns that have a unit prior sd under every model.
    residual : (n,) measured minus fitted.
    scatters : protocol -> scatter of the fitted model.
    """

    def __init__(
        self,
        tests: list[Test],
        base: np.ndarray,
        residual: np.ndarray,
        groups: list[Group],
        scatters: dict[str, Scatter],
        shrunken: np.ndarray | None = None,
    ):
        shrunken = np.zeros((len(residual), 0)) if shrunken is None else shrunken
        blocks, position = [base, shrunken], base.shape[1] + shrunken.shape[1]
        self.shrunken = np.arange(base.shape[1], position)
        common = np.arange(position)
        sets: dict[bytes, _Set] = {}
        for number, test in enumerate(tests):
            nuisance = test.nuisance
            key = b"" if nuisance is None else nuisance.tobytes()
            if key not in sets:
                index = common
                if nuisance is not None:
                    blocks.append(nuisance)
                    index = np.r_[common, position : position + nuisance.shape[1]]
                    position += nuisance.shape[1]
                sets[key] = _Set(index, [], [])
            width = test.columns.shape[1]
            blocks.append(test.columns)
            sets[key].tests.append(number)
            sets[key].own.append(np.arange(position, position + width))
            position += width
        columns = np.column_stack(blocks)
        size = np.linalg.norm(columns, axis=0)
        size[self.shrunken] = 1.0
        columns = columns / np.where(size > 0, size, 1.0)
        self.tests, self.sets, self.residual = tests, list(sets.values()), residual
        self.protocols = []
        for group in groups:
            clusters = Clusters(group, columns[group.index])
            centre = scatters[group.protocol]
            runs = len(clusters.information)
            grid = scatter_grid(centre, len(group.index) / runs)
            grams = np.stack([clusters.gram(scatter) for scatter in grid])
            constants = np.array(
                [scatter_prior(s) - 0.5 * clusters.log_determinant(s) for s in grid]
            )
            self.protocols.append(_Protocol(group, clusters, centre, grid, grams, constants))
        self.ridge = np.zeros(position)
        self.ridge[self.shrunken] = 1.0
        self._identify()

    def _identify(self) -> None:
        """Degrees of freedom of every test, in each protocol and in all together."""
        single = [p.grams[-1] for p in self.protocols]
        grams = [*single, sum(single)] if len(single) > 1 else single
        self.degrees = np.zeros((len(grams), len(self.tests)), int)
        for i, gram in enumerate(grams):
            for each in self.sets:
                inner, _ = _projected(gram, np.zeros((len(gram), 1)), each.base, self.ridge)
                for number, own in zip(each.tests, each.own, strict=True):
                    values, _ = _basis(inner, gram, own)
                    self.degrees[i, number] = len(values)

    def statistics(self, responses: list[np.ndarray]) -> np.ndarray:
        """Ratios of data sets: a (features, b) array a protocol -> (rows, tests, b).

        Rows are the protocols and then all of them together (one row where there is one only).
        """
        count = responses[0].shape[1]
        rows, picked, scores, nulls = [], [], [], []
        for i, protocol in enumerate(self.protocols):
            of = protocol.clusters.responses(responses[i])
            found = self._alone(i, protocol, of, count)
            rows.append(found[0])
            picked.append(found[1])
            scores.append(found[2])
            nulls.append(found[3])
        if len(self.protocols) > 1:
            rows.append(self._together(picked, scores, nulls, count))
        return np.stack(rows)

    def _alone(self, i: int, protocol: _Protocol, of: Responses, count: int):
        """One protocol: ratios, each test's scatter, scores at each scatter, null values."""
        size = len(protocol.grid)
        best = np.full((len(self.tests), count), -np.inf)
        choice = np.zeros((len(self.tests), count), int)
        best_null = np.full((len(self.sets), count), -np.inf)
        choice_null = np.zeros((len(self.sets), count), int)
        scores = np.empty((size, protocol.grams.shape[1], count))
        bare = np.empty((size, count))
        for g, scatter in enumerate(protocol.grid):
            score, squares = protocol.clusters.products(scatter, of)
            scores[g], bare[g] = score, protocol.constants[g] - 0.5 * squares
            gram = protocol.grams[g]
            for k, each in enumerate(self.sets):
                base = _present(gram, each.base)
                inner, rest = _projected(gram, score, base, self.ridge)
                null = bare[g] + 0.5 * _explained(gram, score, base, self.ridge)
                better = null > best_null[k]
                best_null[k][better], choice_null[k][better] = null[better], g
                gains = _gains(inner, rest, gram, each, self.degrees[i])
                value = null + 0.5 * gains
                tests = np.array(each.tests)
                better = value > best[tests]
                best[tests] = np.where(better, value, best[tests])
                choice[tests] = np.where(better, g, choice[tests])
        ratios = np.zeros((len(self.tests), count))
        for k, each in enumerate(self.sets):
            ratios[each.tests] = 2 * (best[each.tests] - best_null[k])
        ratios[self.degrees[i] == 0] = 0.0
        return np.maximum(ratios, 0.0), choice, scores, (bare, choice_null)

    def _together(self, picked, scores, nulls, count: int) -> np.ndarray:
        """All protocols: one effect, one base, each protocol at its own scatter."""
        every = np.arange(count)
        result = np.zeros((len(self.tests), count))

        def at(choices, index):
            """Summed Gram matrices, scores and constants at each data set's scatters."""
            gram, score, bare = 0.0, 0.0, 0.0
            square = np.ix_(index, index)
            for p, protocol in enumerate(self.protocols):
                g = choices[p]
                gram = gram + protocol.grams[:, square[0], square[1]][g]
                score = score + scores[p][g[:, None], index[None, :], every[:, None]]
                bare = bare + nulls[p][0][g, every]
            return gram, score, bare

        def value(choices, index):
            gram, score, bare = at(choices, index)
            return bare + 0.5 * _solved(gram, score, self.ridge[index])

        for k, each in enumerate(self.sets):
            start = [null[1][k] for null in nulls]
            start = self._null_scatters(start, each.base, scores, nulls, count)
            null = value(start, each.base)
            for number, own in zip(each.tests, each.own, strict=True):
                if not self.degrees[-1, number]:
                    continue
                index = np.r_[each.base, own]
                under = [choice[number] for choice in picked]
                best = np.maximum(value(under, index), value(start, index))
                result[number] = 2 * (best - null)
        return np.maximum(result, 0.0)

    def _null_scatters(self, choices, base, scores, nulls, count: int):
        """Each protocol's scatter under the common base, one after the other."""
        every, choices = np.arange(count), list(choices)
        square = np.ix_(base, base)
        for p, protocol in enumerate(self.protocols):
            gram, score = 0.0, 0.0
            for q, other in enumerate(self.protocols):
                if q == p:
                    continue
                gram = gram + other.grams[:, square[0], square[1]][choices[q]]
                score = score + scores[q][choices[q][:, None], base[None, :], every[:, None]]
            best = np.full(count, -np.inf)
            for g in range(len(protocol.grid)):
                own = protocol.grams[g][square] + gram
                pulled = scores[p][g][base].T + score
                value = nulls[p][0][g] + 0.5 * _solved(own, pulled, self.ridge[base])
                better = value > best
                best[better], choices[p] = value[better], np.where(better, g, choices[p])
        return choices

    def drawn(self, rng: np.random.Generator, count: int) -> list[np.ndarray]:
        """Data sets of the fitted model, a (features, count) array a protocol."""
        return [
            p.clusters.drawn(p.group, p.centre, rng, count)
            + p.clusters.columns[:, self.shrunken] @ shared
            for p, shared in (
                (p, rng.standard_normal((len(self.shrunken), count))) for p in self.protocols
            )
        ]

    def observed(self) -> np.ndarray:
        """Ratios of the data themselves, (rows, tests)."""
        return self.statistics([self.residual[p.group.index][:, None] for p in self.protocols])[
            :, :, 0
        ]

    def rows(self) -> list[str | None]:
        """Protocol of every row of the statistics, None for all together."""
        names = [p.group.protocol for p in self.protocols]
        return [*names, None] if len(names) > 1 else [None]


def _present(gram: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Those of the columns that one protocol has."""
    return index[np.diag(gram)[index] > 1e-14 * max(np.diag(gram)[index].max(initial=0), 1e-300)]


def _factor(gram: np.ndarray, base: np.ndarray, ridge: np.ndarray):
    own = gram[np.ix_(base, base)] + np.diag(ridge[base])
    size = np.sqrt(np.maximum(np.diag(own), 1e-300))
    return own / size[:, None] / size[None, :] + 1e-9 * np.eye(len(base)), size


def _projected(gram, score, base, ridge):
    """Gram matrix and scores of all columns without what the base carries."""
    if not len(base):
        return gram, score
    own, size = _factor(gram, base, ridge)
    weights = np.linalg.solve(own, gram[base] / size[:, None]) / size[:, None]
    return gram - gram[:, base] @ weights, score - weights.T @ score[base]


def _explained(gram, score, base, ridge):
    """What the base takes off the squares, (b,)."""
    if not len(base):
        return 0.0
    own, size = _factor(gram, base, ridge)
    scaled = score[base] / size[:, None]
    return np.einsum("kb,kb->b", scaled, np.linalg.solve(own, scaled))


def _basis(inner, gram, own):
    """Eigenvalues and vectors of a test's own columns, those that the base does not make up."""
    size = np.sqrt(np.maximum(np.diag(gram)[own], 1e-300))
    if len(own) == 1:
        value = inner[own[0], own[0]] / size[0] ** 2
        good = value > IDENTIFIED and gram[own[0], own[0]] > 1e-300
        return (np.array([value]), np.ones((1, 1)) / size[0]) if good else ((), None)
    values, vectors = np.linalg.eigh(inner[np.ix_(own, own)] / size[:, None] / size[None, :])
    good = values > 10 * IDENTIFIED
    return values[good], vectors[:, good] / size[:, None]


def _gains(inner, rest, gram, each: _Set, degrees):
    """Score statistics of a set's tests at one scatter, (tests, b)."""
    result = np.zeros((len(each.own), rest.shape[1]))
    alone = [j for j, own in enumerate(each.own) if len(own) == 1]
    index = np.array([each.own[j][0] for j in alone], int)
    diagonal = np.diag(inner)[index]
    fine = diagonal > IDENTIFIED * np.diag(gram)[index]
    gained = rest[index] ** 2 / np.where(fine, diagonal, np.inf)[:, None]
    result[alone] = gained
    for j, own in enumerate(each.own):
        if len(own) == 1 or not degrees[each.tests[j]]:
            continue
        values, vectors = _basis(inner, gram, own)
        if len(values):
            result[j] = ((vectors.T @ rest[own]) ** 2 / values[:, None]).sum(axis=0)
    return result


def _solved(gram, score, ridge):
    """s' (G + ridge)^-1 s of stacks (b, k, k), (b, k); columns that are not there do not count."""
    own = gram + np.diag(ridge)
    size = np.sqrt(np.maximum(np.einsum("bii->bi", own), 1e-300))
    scaled = own / size[:, :, None] / size[:, None, :]
    scaled = scaled + 1e-8 * np.eye(gram.shape[1])
    pulled = score / size
    return np.einsum("bk,bk->b", pulled, np.linalg.solve(scaled, pulled[:, :, None])[:, :, 0])


def run_tests(
    tests: list[Test],
    base: np.ndarray,
    residual: np.ndarray,
    groups: list[Group],
    scatters: dict[str, Scatter],
    rng: np.random.Generator,
    replicates: int = 1000,
    limits: tuple[float, ...] = (),
    shrunken: np.ndarray | None = None,
) -> Outcome:
    """Test every alternative given the base columns.

    Parameters
    ----------
    base : (n, k) columns of the fitted model (derivatives by its parameters).
    residual : (n,) measured minus fitted.
    replicates : simulated data sets at most; they come in rounds until the family-wise p is
        clearly on one side of all ``limits``.
    """
    if not groups or not tests:  # every reading is only a bound
        nothing = np.zeros(len(tests))
        return outcome_of(tests, nothing, np.zeros((1, len(tests))), nothing.astype(int))
    ratios = Ratios(tests, base, residual, groups, scatters, shrunken)
    observed = ratios.observed()
    expanded = [replace(test, protocol=row) for row in ratios.rows() for test in tests]
    simulated = np.zeros((len(expanded), 0))
    while True:
        count = min(ROUND, replicates - simulated.shape[1])
        drawn = ratios.statistics(ratios.drawn(rng, count))
        simulated = np.column_stack([simulated, drawn.reshape(len(expanded), count)])
        outcome = outcome_of(expanded, observed.ravel(), simulated.T, ratios.degrees.ravel())
        if simulated.shape[1] >= replicates or outcome.is_clear(limits):
            return outcome


def data_ratios(tests, base, residual, groups, scatters, shrunken=None) -> np.ndarray:
    """Ratios of the data without any simulation, (tests,): the largest of all rows."""
    ratios = Ratios(tests, base, residual, groups, scatters, shrunken)
    return ratios.observed().max(axis=0)
