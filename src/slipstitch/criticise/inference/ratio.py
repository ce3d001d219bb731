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
SIGMA_STEPS = (0.15, 0.4, 0.7, 1.0)
KAPPA_STEPS = (0.7, 0.85, 1.0)
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

    ``rows`` (g, base, m) are of X' V^-1 X, ``blocks`` (g, t, k, k) of the tests' own columns, an
    array for each width k, ``vectors`` (g, t, k, k) of unit information.
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
            found = [v[g] for v in self.vectors]
            value = null + 0.5 * explained_by(found, left, own, one_sided)
            better = value > best
            best = np.where(better, value, best)
            self.choice = np.where(better, g, self.choice)
        self.ratios = 2 * (best - best_null)


class _Bank:
    """Tests with one base of fixed columns, in the order of their widths.

    ``own`` (t, k) are their columns, an array for each width k; ``degrees`` and ``information``
    have a row a protocol, and one for all together.
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
        """All protocols: one effect, one base, each protocol at a scatter of its own.

        That is the one of its base, or the one that suits the strongest test best.
        """
        every = np.arange(self.sides[0].bare.shape[1])
        strongest = np.argmax(sum(side.ratios for side in self.sides), axis=0)
        usual = [side.null_choice for side in self.sides]
        under = [side.choice[strongest, every] for side in self.sides]
        (one, ones), (other, others) = self._joint(usual), self._joint(under)
        return 2 * (np.maximum(ones, others) - np.maximum(one, other))

    def _joint(self, choices: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Log-likelihood of the base (b,) and with each test (tests, b) at scatters of each."""
        pairs = list(zip(choices, self.sides, strict=True))
        every, base = np.arange(len(choices[0])), len(self.ridge)
        rows = sum(side.rows[choice] for choice, side in pairs)
        blocks = [sum(s.blocks[j][choice] for choice, s in pairs) for j in range(len(self.own))]
        score = sum(side.scores[choice, :, every] for choice, side in pairs)
        bare = sum(side.bare[choice, every] for choice, side in pairs)
        inverse, carried, vectors = beside(rows, blocks, self.ridge, self.own)
        pulled = score[:, :base]
        null = bare + 0.5 * np.einsum("bk,bkl,bl->b", pulled, inverse, pulled)
        left = (score - np.einsum("bkm,bk->bm", carried, pulled)).T
        return null, null + 0.5 * explained_by(vectors, left, self.own, self.one_sided)


class Ratios:
    """Likelihood ratios of a set of tests beside a fitted model.

    Parameters
    ----------
    base : (n, k) derivatives of the fitted model by its parameters.
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

        They come in rounds, at most ``replicates``, until the family-wise p is clearly on one side
        of all ``limits``.
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

    The inverse of the base's Gram matrix (g, base, base), coefficients of all columns on the base
    (g, base, m), and the tests' vectors of unit information, zero for those that the base makes up.
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


def explained_by(vectors, left, own, one_sided) -> np.ndarray:
    """Twice what each test explains (tests, b) of what its base leaves (m, b)."""
    found = []
    for index, unit in zip(own, vectors, strict=True):
        if unit.ndim == 3:
            found.append(unit.transpose(0, 2, 1) @ left[index])
        else:
            found.append(np.einsum("btkl,tkb->tlb", unit, left[index]))
    start = 0
    for along in found:
        added = one_sided[start : start + len(along)]
        along[added] = np.maximum(along[added], 0.0)
        start += len(along)
    return np.concatenate([(along**2).sum(axis=1) for along in found])


def _unit_vectors(inner: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Vectors (..., k, k) of unit information from what is left (inner) of columns (block)."""
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
