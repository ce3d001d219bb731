"""Likelihood ratios of alternatives, the scatter refitted under each; error by simulation.

A score test keeps the scatter of the null, which an effect has swelled: it saturates. Here every
alternative has the scatter that suits it best, protocol by protocol, out of a grid. Each is tested
in every protocol alone and in all of them together, so that a further protocol costs a little of
the multiplicity but takes no evidence away. The largest of all statistics is simulated under the
fitted model; the rule that picks scatters is the same in data and replicates, so the grid needs
not be fine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipstitch.criticise.inference.mixed_model import KAPPA_LIMITS, Clusters, Group, Scatter
from slipstitch.criticise.inference.structure import Outcome, outcome_of

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


class _Side:
    """Tests beside one base in one protocol: what the base carries of them at every scatter.

    Attributes
    ----------
    rows : (g, base, m) of X' V^-1 X at every scatter; the base's columns come first.
    blocks : (g, t, k, k) of the tests' own columns, an array for each width k.
    vectors : (g, t, k, k) of unit information, from what the base leaves of these columns; zero
        for those that it makes up.
    """

    def __init__(self, columns, ridge, own, group: Group, centre: Scatter):
        self.clusters = Clusters(group, columns[group.index])
        self.grid = scatter_grid(centre, self.clusters.readings_a_run)
        grams = [self.clusters.gram(scatter) for scatter in self.grid]
        self.rows = np.stack([gram[: len(ridge)] for gram in grams])
        self.blocks = [
            np.stack([gram[index[:, :, None], index[:, None, :]] for gram in grams])
            for index in own
        ]
        self.constants = [s.log_prior() - 0.5 * self.clusters.log_determinant(s) for s in self.grid]
        self.inverse, self.carried, self.vectors = beside(self.rows, self.blocks, ridge, own)

    def joined(self, base: int, own=None, block=None) -> np.ndarray:
        """X' V^-1 X of the base, and of a test's own columns, at every scatter."""
        if own is None:
            return self.rows[:, :, :base]
        index = np.r_[np.arange(base), own]
        whole = np.empty((len(self.grid), len(index), len(index)))
        whole[:, :base] = self.rows[:, :, index]
        whole[:, base:, :base] = self.rows[:, :, own].transpose(0, 2, 1)
        whole[:, base:, base:] = block
        return whole

    def search(self, response: np.ndarray, one_sided: np.ndarray, own) -> None:
        """Ratios of data sets (features, b), and the best scatter of the base and of each test."""
        of, count, base = self.clusters.responses(response), response.shape[1], self.rows.shape[1]
        best = np.full((len(one_sided), count), -np.inf)
        self.choice = np.zeros(best.shape, int)
        best_null, self.null_choice = np.full(count, -np.inf), np.zeros(count, int)
        self.scores = np.empty((len(self.grid), self.rows.shape[2], count))
        self.bare = np.empty((len(self.grid), count))
        for g, scatter in enumerate(self.grid):
            score, squares = self.clusters.products(scatter, of)
            self.scores[g], self.bare[g] = score, self.constants[g] - 0.5 * squares
            pulled = score[:base]
            explained = np.einsum("kb,kb->b", pulled, self.inverse[g] @ pulled)
            null = self.bare[g] + 0.5 * explained
            better = null > best_null
            best_null[better], self.null_choice[better] = null[better], g
            left = score - self.carried[g].T @ pulled
            start = 0
            for index, vectors in zip(own, self.vectors, strict=True):
                tests = slice(start, start := start + len(index))
                along = vectors[g].transpose(0, 2, 1) @ left[index]
                along[one_sided[tests]] = np.maximum(along[one_sided[tests]], 0.0)
                value = null + 0.5 * (along**2).sum(axis=1)
                better = value > best[tests]
                best[tests] = np.where(better, value, best[tests])
                self.choice[tests] = np.where(better, g, self.choice[tests])
        self.ratios = 2 * (best - best_null)


class _Bank:
    """Tests with one base of fixed columns, in the order of their widths.

    Attributes
    ----------
    numbers : of each test.
    own : (t, k) their columns, an array for each width k.
    degrees, information : (protocols and all together, tests).
    """

    def __init__(self, numbers, tests, fixed, shrunken, groups, scatters):
        widths = dict.fromkeys(tests[i].columns.shape[1] for i in numbers)
        ordered = [[i for i in numbers if tests[i].columns.shape[1] == k] for k in widths]
        self.numbers = np.array([i for same in ordered for i in same])
        columns = np.column_stack([fixed, *(tests[i].columns for i in self.numbers)])
        size = np.linalg.norm(columns, axis=0)
        size[shrunken] = 1.0
        self.size = np.where(size > 0, size, 1.0)
        self.ridge = np.isin(np.arange(fixed.shape[1]), shrunken).astype(float)
        self.one_sided = np.array([tests[i].one_sided for i in self.numbers], bool)
        self.own, position = [], fixed.shape[1]
        for k, same in zip(widths, ordered, strict=True):
            self.own.append(position + np.arange(k * len(same)).reshape(len(same), k))
            position += k * len(same)
        self.sides = [
            _Side(columns / self.size, self.ridge, self.own, group, scatters[group.protocol])
            for group in groups
        ]
        found = [[v[-1] for v in side.vectors] for side in self.sides]
        if len(self.sides) > 1:
            rows = sum(side.rows[-1:] for side in self.sides)
            blocks = [sum(side.blocks[j][-1:] for side in self.sides) for j in range(len(self.own))]
            together = beside(rows, blocks, self.ridge, self.own)[2]
            found.append([v[0] for v in together])
        identified = [self._identified(vectors) for vectors in found]
        self.degrees = np.stack([degrees for degrees, _ in identified])
        self.information = np.stack([information for _, information in identified])

    def _identified(self, vectors) -> tuple[np.ndarray, np.ndarray]:
        """Degrees of freedom of every test, and the information of its plain columns."""
        degrees, information = [], []
        for own, found in zip(self.own, vectors, strict=True):
            degrees.append(np.any(found != 0, axis=1).sum(axis=1))
            scaled = found / self.size[own][:, :, None]
            spread = np.linalg.norm(scaled, ord=2, axis=(1, 2)) ** 2
            whole = degrees[-1] == own.shape[1]
            information.append(np.where(whole, 1.0 / np.where(whole, spread, 1.0), 0.0))
        return np.concatenate(degrees), np.concatenate(information)

    def statistics(self, responses: list[np.ndarray]) -> np.ndarray:
        """Ratios (rows, tests, b) of data sets, a (features, b) array a protocol."""
        for side, response in zip(self.sides, responses, strict=True):
            side.search(response, self.one_sided, self.own)
        ratios = [side.ratios for side in self.sides]
        if len(self.sides) > 1:
            ratios.append(self._together())
        ratios = np.stack(ratios)
        ratios[self.degrees == 0] = 0.0
        return np.maximum(ratios, 0.0)

    def _together(self) -> np.ndarray:
        """All protocols: one effect, one base, each protocol at its own scatter."""
        sides, base = self.sides, len(self.ridge)
        every = np.arange(sides[0].bare.shape[1])
        start = self._null_scatters()

        def value(choices, own=None, blocks=None, added=False):
            index = np.arange(base) if own is None else np.r_[np.arange(base), own]
            gram, score, bare = 0.0, 0.0, 0.0
            for p, (choice, side) in enumerate(zip(choices, sides, strict=True)):
                whole = side.joined(base, own, None if own is None else blocks[p])
                gram = gram + whole[choice]
                score = score + side.scores[choice[:, None], index[None, :], every[:, None]]
                bare = bare + side.bare[choice, every]
            ridge = np.r_[self.ridge, np.zeros(len(index) - base)]
            return bare + 0.5 * _solved(gram, score, ridge, added)

        null = value(start)
        result = np.zeros(sides[0].ratios.shape)
        places = [(j, t) for j, index in enumerate(self.own) for t in range(len(index))]
        for i, (j, t) in enumerate(places):
            if not self.degrees[-1, i]:
                continue
            own, added = self.own[j][t], self.one_sided[i]
            blocks = [side.blocks[j][:, t] for side in sides]
            under = [side.choice[i] for side in sides]
            best = np.maximum(value(under, own, blocks, added), value(start, own, blocks, added))
            result[i] = 2 * (best - null)
        return result

    def _null_scatters(self) -> list[np.ndarray]:
        """Each protocol's scatter under the common base, one after the other."""
        choices, base = [side.null_choice.copy() for side in self.sides], len(self.ridge)
        every = np.arange(len(choices[0]))
        grams = [side.joined(base) for side in self.sides]
        for p, own in enumerate(self.sides):
            gram, score = 0.0, 0.0
            for q, other in enumerate(self.sides):
                if q != p:
                    gram = gram + grams[q][choices[q]]
                    score = score + other.scores[choices[q], :base, every]
            best = np.full(len(every), -np.inf)
            for g in range(len(grams[p])):
                pulled = own.scores[g][:base].T + score
                value = own.bare[g] + 0.5 * _solved(grams[p][g] + gram, pulled, self.ridge)
                better = value > best
                best[better], choices[p] = value[better], np.where(better, g, choices[p])
        return choices


class Ratios:
    """Likelihood ratios of a set of tests beside a fitted model.

    Parameters
    ----------
    tests : alternatives, each with its columns over all features.
    base : (n, k) derivatives of the fitted model by its parameters.
    residual : (n,) measured minus fitted.
    groups, scatters : the features by protocol, and their scatter under the fitted model.
    shrunken : (n, z) columns that have a unit prior sd under every model.
    """

    def __init__(self, tests, base, residual, groups, scatters, shrunken=None):
        shrunken = np.zeros((len(residual), 0)) if shrunken is None else shrunken
        self.groups, self._scatters, self._shrunken = groups, scatters, shrunken
        self.tests, self._residual = tests, residual
        beside_nuisance: dict[bytes, list[int]] = {}
        for number, test in enumerate(tests):
            key = b"" if test.nuisance is None else test.nuisance.tobytes()
            beside_nuisance.setdefault(key, []).append(number)
        of_zeros = base.shape[1] + np.arange(shrunken.shape[1])
        self._banks: list[_Bank] = []
        for numbers in beside_nuisance.values() if groups else ():
            nuisance = tests[numbers[0]].nuisance
            fixed = [base, shrunken] if nuisance is None else [base, shrunken, nuisance]
            self._banks.append(
                _Bank(numbers, tests, np.column_stack(fixed), of_zeros, groups, scatters)
            )
        if not self._banks:
            return
        self.degrees = self._gathered([bank.degrees for bank in self._banks])
        self.information = self._gathered([bank.information for bank in self._banks])

    def _gathered(self, parts: list[np.ndarray]) -> np.ndarray:
        """The banks' (rows, tests, ...), in the order of the tests."""
        result = np.empty((len(parts[0]), len(self.tests), *parts[0].shape[2:]), parts[0].dtype)
        for bank, part in zip(self._banks, parts, strict=True):
            result[:, bank.numbers] = part
        return result

    def statistics(self, responses: list[np.ndarray]) -> np.ndarray:
        """Ratios of data sets: a (features, b) array a protocol -> (rows, tests, b).

        Rows are the protocols and then all of them together (one row where there is one only).
        """
        return self._gathered([bank.statistics(responses) for bank in self._banks])

    def drawn(self, rng: np.random.Generator, count: int) -> list[np.ndarray]:
        """Data sets of the fitted model, a (features, count) array a protocol."""
        found = []
        for group in self.groups:
            shared = rng.standard_normal((self._shrunken.shape[1], count))
            scattered = group.drawn(self._scatters[group.protocol], rng, count)
            found.append(scattered + self._shrunken[group.index] @ shared)
        return found

    def observed(self) -> np.ndarray:
        """Ratios of the data themselves, (rows, tests)."""
        data = [self._residual[group.index][:, None] for group in self.groups]
        return self.statistics(data)[:, :, 0]

    def rows(self) -> list[str | None]:
        """Protocol of every row of the statistics, None for all together."""
        names = [group.protocol for group in self.groups]
        return [*names, None] if len(names) > 1 else [None]

    def outcome(
        self, rng: np.random.Generator, replicates: int, limits: tuple[float, ...] = ()
    ) -> Outcome:
        """Test every alternative, its error by data sets that are drawn from the fitted model.

        Parameters
        ----------
        replicates : simulated data sets at most; they come in rounds until the family-wise p is
            clearly on one side of all ``limits``.
        """
        if not self._banks:  # every reading is only a bound
            nothing = np.zeros(len(self.tests))
            return outcome_of(self.tests, nothing, nothing[None, :], nothing.astype(int))
        observed = self.observed()
        expanded = [replace(test, protocol=row) for row in self.rows() for test in self.tests]
        simulated = np.zeros((len(expanded), 0))
        while True:
            # Each round is as large as all before it.
            count = min(max(ROUND, simulated.shape[1]), replicates - simulated.shape[1])
            for start in range(0, count, ROUND):
                part = min(ROUND, count - start)
                drawn = self.statistics(self.drawn(rng, part))
                simulated = np.column_stack([simulated, drawn.reshape(len(expanded), part)])
            found = outcome_of(expanded, observed.ravel(), simulated.T, self.degrees.ravel())
            found.information = self.information.ravel()
            if simulated.shape[1] >= replicates or found.is_clear(limits):
                return found


def beside(rows, blocks, ridge, own):
    """What a base carries of tests' columns, from X' V^-1 X at every scatter.

    Returns
    -------
    inverse, carried, vectors
        (g, base, base) of the base's Gram matrix, (g, base, m) coefficients of all columns on the
        base, and the tests' vectors of unit information.
    """
    base = len(ridge)
    gram = rows[:, :, :base] + np.diag(ridge)
    diagonal = np.einsum("gii->gi", gram)
    # Columns that this protocol has not carry nothing.
    there = diagonal > 1e-14 * diagonal.max(axis=1, initial=1e-286, keepdims=True)
    size = np.sqrt(np.where(there, diagonal, np.inf))
    scaled = gram / size[:, :, None] / size[:, None, :] + 1e-9 * np.eye(base)
    inverse = np.linalg.inv(scaled) / size[:, :, None] / size[:, None, :]
    carried = inverse @ rows
    vectors = []
    for index, block in zip(own, blocks, strict=True):
        taken = np.einsum("gbtk,gbtl->gtkl", rows[:, :, index], carried[:, :, index])
        vectors.append(_unit_vectors(block - taken, block))
    return inverse, carried, vectors


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
