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

from slipstitch.criticise.inference.clusters import Clusters
from slipstitch.criticise.inference.covariance import KAPPA_LIMITS, Group, Scatter, scatter_prior
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
    """Tests with the same nuisance columns, and the base that these and the common columns make.

    Attributes
    ----------
    base : indices into :attr:`Ratios.fixed`.
    tests : number of each test, tests of as many columns together.
    own : (tests, k) their columns, an array for each k.
    """

    base: np.ndarray
    tests: list[np.ndarray]
    own: list[np.ndarray]


@dataclass
class _Beside:
    """One set at every scatter of one protocol: what its base carries, and what is left of tests.

    Attributes
    ----------
    inverse : (g, base, base) of the base's Gram matrix.
    carried : (g, base, m) coefficients of the columns on the base.
    bases : (g, tests, k, k) for each k, of the columns less what the base carries; vectors of
        unit information, zero for those that the base makes up.
    """

    inverse: np.ndarray
    carried: np.ndarray
    bases: list[np.ndarray]


@dataclass
class _Protocol:
    """One protocol: its sums at each scatter of its grid."""

    group: Group
    clusters: Clusters
    centre: Scatter
    grid: list[Scatter]
    rows: np.ndarray
    blocks: list[list[np.ndarray]]
    constants: np.ndarray
    beside: list[_Beside]


@dataclass
class _Found:
    """One protocol's statistics: ratios and choice of scatter (tests, b), and of the bases."""

    ratios: np.ndarray
    choice: np.ndarray
    null_choice: np.ndarray
    scores: np.ndarray
    bare: np.ndarray


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
        fixed, common = list(range(position)), np.arange(position)
        bases: dict[bytes, np.ndarray] = {}
        grouped: dict[bytes, dict[int, list[tuple[int, np.ndarray]]]] = {}
        for number, test in enumerate(tests):
            nuisance = test.nuisance
            key = b"" if nuisance is None else nuisance.tobytes()
            if key not in bases:
                bases[key] = common
                if nuisance is not None:
                    blocks.append(nuisance)
                    added = np.arange(position, position + nuisance.shape[1])
                    bases[key] = np.r_[common, np.arange(len(fixed), len(fixed) + len(added))]
                    fixed += added.tolist()
                    position += len(added)
            width = test.columns.shape[1]
            blocks.append(test.columns)
            own = np.arange(position, position + width)
            grouped.setdefault(key, {}).setdefault(width, []).append((number, own))
            position += width
        self.fixed = np.array(fixed, int)
        self.sets = [
            _Set(
                bases[key],
                [np.array([number for number, _ in same]) for same in by_width.values()],
                [np.stack([own for _, own in same]) for same in by_width.values()],
            )
            for key, by_width in grouped.items()
        ]
        columns = np.column_stack(blocks)
        size = np.linalg.norm(columns, axis=0)
        size[self.shrunken] = 1.0
        self.size = np.where(size > 0, size, 1.0)
        columns = columns / self.size
        self.tests, self.residual = tests, residual
        self.one_sided = np.array([test.one_sided for test in tests], bool)
        self.ridge = np.zeros(position)
        self.ridge[self.shrunken] = 1.0
        self.protocols = [
            self._protocol(group, columns[group.index], scatters[group.protocol])
            for group in groups
        ]
        self._identified()

    def _protocol(self, group: Group, columns: np.ndarray, centre: Scatter) -> _Protocol:
        clusters = Clusters(group, columns)
        grid = scatter_grid(centre, len(group.index) / len(clusters.information))
        constants = [scatter_prior(s) - 0.5 * clusters.log_determinant(s) for s in grid]
        rows = clusters.rows(grid, self.fixed)
        blocks = [[clusters.blocks(grid, own) for own in each.own] for each in self.sets]
        beside = [
            self._beside(each, rows, own) for each, own in zip(self.sets, blocks, strict=True)
        ]
        return _Protocol(group, clusters, centre, grid, rows, blocks, np.array(constants), beside)

    def _beside(self, each: _Set, rows: np.ndarray, blocks: list[np.ndarray]) -> _Beside:
        """What the base of a set carries at every scatter (g, ...), and what is left."""
        base = self.fixed[each.base]
        gram = rows[:, each.base][:, :, base] + np.diag(self.ridge[base])
        diagonal = np.einsum("gii->gi", gram)
        # Columns that this protocol has not carry nothing.
        there = diagonal > 1e-14 * diagonal.max(axis=1, initial=1e-286, keepdims=True)
        size = np.sqrt(np.where(there, diagonal, np.inf))
        scaled = gram / size[:, :, None] / size[:, None, :] + 1e-9 * np.eye(len(base))
        inverse = np.linalg.inv(scaled) / size[:, :, None] / size[:, None, :]
        pulled = rows[:, each.base]
        carried = inverse @ pulled
        bases = []
        for own, block in zip(each.own, blocks, strict=True):
            taken = np.einsum("gbtk,gbtl->gtkl", pulled[:, :, own], carried[:, :, own])
            bases.append(_unit_vectors(block - taken, block))
        return _Beside(inverse, carried, bases)

    def _identified(self) -> None:
        """Degrees of freedom and information of every test, in each protocol and in all."""
        found = [[side.bases for side in p.beside] for p in self.protocols]
        found = [[[basis[-1] for basis in bases] for bases in sides] for sides in found]
        if len(self.protocols) > 1:
            rows = sum(p.rows[-1:] for p in self.protocols)
            together = []
            for k, each in enumerate(self.sets):
                blocks = [
                    sum(p.blocks[k][j][-1:] for p in self.protocols) for j in range(len(each.own))
                ]
                together.append([basis[0] for basis in self._beside(each, rows, blocks).bases])
            found.append(together)
        self.degrees = np.zeros((len(found), len(self.tests)), int)
        self.information = np.zeros((len(found), len(self.tests)))
        for row, sides in enumerate(found):
            for each, bases in zip(self.sets, sides, strict=True):
                for tests, own, basis in zip(each.tests, each.own, bases, strict=True):
                    degrees = np.any(basis != 0, axis=1).sum(axis=1)
                    self.degrees[row, tests] = degrees
                    scaled = basis / self.size[own][:, :, None]
                    spread = np.linalg.norm(scaled, ord=2, axis=(1, 2)) ** 2
                    whole = degrees == own.shape[1]
                    self.information[row, tests] = np.where(
                        whole, 1.0 / np.where(whole, spread, 1.0), 0.0
                    )

    def statistics(self, responses: list[np.ndarray]) -> np.ndarray:
        """Ratios of data sets: a (features, b) array a protocol -> (rows, tests, b).

        Rows are the protocols and then all of them together (one row where there is one only).
        """
        found = [self._alone(p, y) for p, y in zip(self.protocols, responses, strict=True)]
        ratios = [f.ratios for f in found]
        if len(found) > 1:
            ratios.append(self._together(found))
        ratios = np.stack(ratios)
        ratios[self.degrees == 0] = 0.0
        return np.maximum(ratios, 0.0)

    def _alone(self, protocol: _Protocol, response: np.ndarray) -> _Found:
        """One protocol's ratios of data sets (features, b)."""
        of, count = protocol.clusters.responses(response), response.shape[1]
        best = np.full((len(self.tests), count), -np.inf)
        choice = np.zeros((len(self.tests), count), int)
        best_null = np.full((len(self.sets), count), -np.inf)
        choice_null = np.zeros((len(self.sets), count), int)
        scores = np.empty((len(protocol.grid), len(self.ridge), count))
        bare = np.empty((len(protocol.grid), count))
        for g, scatter in enumerate(protocol.grid):
            score, squares = protocol.clusters.products(scatter, of)
            scores[g], bare[g] = score, protocol.constants[g] - 0.5 * squares
            for k, (each, beside) in enumerate(zip(self.sets, protocol.beside, strict=True)):
                pulled = score[self.fixed[each.base]]
                explained = np.einsum("kb,kb->b", pulled, beside.inverse[g] @ pulled)
                null = bare[g] + 0.5 * explained
                better = null > best_null[k]
                best_null[k][better], choice_null[k][better] = null[better], g
                left = score - beside.carried[g].T @ pulled
                for tests, own, basis in zip(each.tests, each.own, beside.bases, strict=True):
                    along = basis[g].transpose(0, 2, 1) @ left[own]
                    along[self.one_sided[tests]] = np.maximum(along[self.one_sided[tests]], 0.0)
                    value = null + 0.5 * (along**2).sum(axis=1)
                    better = value > best[tests]
                    best[tests] = np.where(better, value, best[tests])
                    choice[tests] = np.where(better, g, choice[tests])
        ratios = np.zeros((len(self.tests), count))
        for k, each in enumerate(self.sets):
            tests = np.concatenate(each.tests)
            ratios[tests] = 2 * (best[tests] - best_null[k])
        return _Found(ratios, choice, choice_null, scores, bare)

    def _together(self, found: list[_Found]) -> np.ndarray:
        """All protocols: one effect, one base, each protocol at its own scatter."""
        count = found[0].bare.shape[1]
        every = np.arange(count)
        result = np.zeros((len(self.tests), count))
        for k, each in enumerate(self.sets):
            base = self.fixed[each.base]
            grams = [p.rows[:, each.base] for p in self.protocols]
            start = self._null_scatters(found, [f.null_choice[k] for f in found], base, grams)

            def value(choices, own=None, blocks=None, added=False, base=base, grams=grams):
                index = base if own is None else np.r_[base, own]
                gram, score, bare = 0.0, 0.0, 0.0
                for p, (choice, f) in enumerate(zip(choices, found, strict=True)):
                    whole = np.zeros((len(grams[p]), len(index), len(index)))
                    whole[:, : len(base)] = grams[p][:, :, index]
                    if own is not None:
                        whole[:, len(base) :, : len(base)] = grams[p][:, :, own].transpose(0, 2, 1)
                        whole[:, len(base) :, len(base) :] = blocks[p]
                    gram = gram + whole[choice]
                    score = score + f.scores[choice[:, None], index[None, :], every[:, None]]
                    bare = bare + f.bare[choice, every]
                return bare + 0.5 * _solved(gram, score, self.ridge[index], added)

            null = value(start)
            for j, (tests, columns) in enumerate(zip(each.tests, each.own, strict=True)):
                for t, (number, own) in enumerate(zip(tests, columns, strict=True)):
                    if not self.degrees[-1, number]:
                        continue
                    blocks = [p.blocks[k][j][:, t] for p in self.protocols]
                    under = [f.choice[number] for f in found]
                    added = self.one_sided[number]
                    best = np.maximum(
                        value(under, own, blocks, added), value(start, own, blocks, added)
                    )
                    result[number] = 2 * (best - null)
        return result

    def _null_scatters(self, found, choices, base, grams) -> list[np.ndarray]:
        """Each protocol's scatter under the common base, one after the other."""
        choices, every = list(choices), np.arange(len(choices[0]))
        grams = [gram[:, :, base] for gram in grams]
        for p, own in enumerate(found):
            gram, score = 0.0, 0.0
            for q, other in enumerate(found):
                if q == p:
                    continue
                gram = gram + grams[q][choices[q]]
                score = score + other.scores[choices[q][:, None], base[None, :], every[:, None]]
            best = np.full(len(every), -np.inf)
            for g in range(len(grams[p])):
                pulled = own.scores[g][base].T + score
                value = own.bare[g] + 0.5 * _solved(grams[p][g] + gram, pulled, self.ridge[base])
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


def _unit_vectors(inner: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Vectors (..., k, k) of unit information from what is left (inner) of columns (block).

    Those that the base makes up are zero.
    """
    size = np.sqrt(np.maximum(np.einsum("gtkk->gtk", block), 1e-300))
    scaled = inner / size[..., :, None] / size[..., None, :]
    if block.shape[-1] == 1:
        values, vectors, least = scaled[..., 0], np.ones_like(scaled), IDENTIFIED
    else:
        values, vectors = np.linalg.eigh(scaled)
        least = 10 * IDENTIFIED
    weight = np.where(values > least, 1.0 / np.sqrt(np.maximum(values, least)), 0.0)
    weight[block[..., 0, 0] <= 1e-300] = 0.0
    return vectors * weight[..., None, :] / size[..., :, None]


def _solved(gram, score, ridge, added=False):
    """s' (G + ridge)^-1 s of stacks (b, k, k), (b, k); columns that are not there do not count.

    ``added``: the last column may only be added.
    """
    own = gram + np.diag(ridge)
    size = np.sqrt(np.maximum(np.einsum("bii->bi", own), 1e-300))
    scaled = own / size[:, :, None] / size[:, None, :]
    scaled = scaled + 1e-8 * np.eye(gram.shape[1])
    pulled = score / size
    found = np.linalg.solve(scaled, pulled[:, :, None])[:, :, 0]
    value = np.einsum("bk,bk->b", pulled, found)
    if added and (found[:, -1] < 0).any():
        without = _solved(gram[:, :-1, :-1], score[:, :-1], ridge[:-1])
        value = np.where(found[:, -1] < 0, without, value)
    return value


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
        # Each round is as large as all before it.
        count = min(max(ROUND, simulated.shape[1]), replicates - simulated.shape[1])
        for start in range(0, count, ROUND):
            part = min(ROUND, count - start)
            drawn = ratios.statistics(ratios.drawn(rng, part))
            simulated = np.column_stack([simulated, drawn.reshape(len(expanded), part)])
        outcome = outcome_of(expanded, observed.ravel(), simulated.T, ratios.degrees.ravel())
        outcome.information = ratios.information.ravel()
        if simulated.shape[1] >= replicates or outcome.is_clear(limits):
            return outcome


def data_ratios(tests, base, residual, groups, scatters, shrunken=None) -> np.ndarray:
    """Ratios of the data without any simulation, (tests,): the largest of all rows."""
    ratios = Ratios(tests, base, residual, groups, scatters, shrunken)
    return ratios.observed().max(axis=0)
