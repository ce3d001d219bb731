"""The tangent stiffness: pattern, assembly places, sparse Cholesky factor; flexible GMRES."""

from collections.abc import Callable
from math import hypot

import cvxopt
import cvxopt.amd
import numpy as np
import warp as wp
from cvxopt import cholmod

cholmod.options["supernodal"] = 2

LEAST_NEW = 1e-12  # part of a product that no earlier product had: less is rounding


@wp.struct
class Entries:
    """Where the elements of one kind add to the matrix."""

    place: wp.array(dtype=wp.int32, ndim=2)  # of each element's entries; -1: left out
    values: wp.array(dtype=wp.float64)


def entries_at(places: wp.array, values: wp.array) -> Entries:
    """Put together where elements add, and to what."""
    entries = Entries()
    entries.place, entries.values = places, values
    return entries


@wp.func
def add_entry(entries: Entries, element: int, column: int, value: wp.float64):
    """Add to an element's entry number ``column``."""
    place = entries.place[element, column]
    if place >= 0:
        wp.atomic_add(entries.values, place, value)


class _Pattern:
    """Lower triangle of a symmetric matrix of 3 x 3 blocks, in compressed column form.

    ``blocks`` are numbers ``column node * node count + row node``, sorted, every diagonal block
    among them; ``keys`` are such numbers of the entries, likewise.
    """

    def __init__(self, blocks: np.ndarray, node_count: int):
        self.blocks, self.size = blocks, 3 * node_count
        column, row = (3 * one[:, None, None] for one in np.divmod(blocks, node_count))
        rows, columns = np.broadcast_arrays(row + np.arange(3)[:, None], column + np.arange(3))
        below = rows >= columns
        self.keys = np.sort(columns[below] * self.size + rows[below])

    def place(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Places of entries among the keys."""
        return np.searchsorted(self.keys, columns.astype(np.int64) * self.size + rows)

    def matrix(self) -> cvxopt.spmatrix:
        columns, rows = np.divmod(self.keys, self.size)
        ends = cvxopt.matrix(rows), cvxopt.matrix(columns)
        return cvxopt.spmatrix(1.0, *ends, (self.size, self.size))


class Assembly:
    """Positions in the tangent stiffness to which the elements of a mesh contribute.

    Elements (n, k) list the nodes that they couple. ``template`` has the identity at fixed
    coordinates (V, 3), ``entries`` (n, 9 k^2) where an element's entries go, -1 above the diagonal
    or fixed, and ``node_entries`` (V, 9) likewise of a node's block.
    """

    def __init__(self, elements: list[np.ndarray], fixed: np.ndarray, device: str):
        self.device = device
        self._fixed = fixed.ravel()
        self.node_count = V = len(fixed)
        keys = [np.arange(V, dtype=np.int64) * (V + 1)]
        keys += [self.pair_keys(nodes) for nodes in elements]
        pattern = self.pattern = _Pattern(np.unique(np.concatenate(keys)), V)
        template = np.zeros(len(pattern.keys))
        held = np.flatnonzero(self._fixed)
        template[pattern.place(held, held)] = 1.0
        self.template = wp.array(template, dtype=wp.float64, device=device)
        self.entries = [self.places(nodes, pattern) for nodes in elements]
        self.node_entries = self.places(np.arange(V)[:, None], pattern)

    def pair_keys(self, nodes: np.ndarray) -> np.ndarray:
        """Numbers of the blocks that elements couple; nodes of shape (n, k)."""
        k = nodes.shape[1]
        a, b = (nodes[:, one].ravel().astype(np.int64) for one in np.tril_indices(k, -1))
        return np.unique(np.minimum(a, b) * self.node_count + np.maximum(a, b))

    def places(self, nodes: np.ndarray, pattern: _Pattern) -> wp.array:
        """Where entries of elements (n, k) go in a pattern, as ``entries``."""
        size = 3 * nodes.shape[1]
        dof = (nodes[:, :, None] * 3 + np.arange(3)).reshape(len(nodes), size)
        rows, columns = np.repeat(dof, size, axis=1), np.tile(dof, (1, size))
        kept = (rows >= columns) & ~self._fixed[rows] & ~self._fixed[columns]
        place = np.full(rows.shape, -1, dtype=np.int32)
        place[kept] = pattern.place(rows[kept], columns[kept])
        return wp.array(place, dtype=wp.int32, device=self.device)


class Tangent:
    """Tangent stiffness of one sheet, to whose values elements add; factored by CHOLMOD."""

    def __init__(self, assembly: Assembly, elimination_order: np.ndarray, values: wp.array):
        self._assembly = assembly
        self._order = elimination_order
        self._values = values
        self.couple(np.zeros((0, 4), dtype=np.int32))

    def couple(self, contacts: np.ndarray) -> Entries:
        """Make room for contacts (N, 4) between far nodes, each of which couples four."""
        assembly, pattern, order = self._assembly, self._assembly.pattern, self._order
        self._extended, self._moved = self._values, None
        if len(contacts):
            count = assembly.node_count
            blocks = np.union1d(pattern.blocks, assembly.pair_keys(contacts))
            whole = _Pattern(blocks, count)
            columns, rows = map(cvxopt.matrix, np.divmod(blocks, count))
            lower = cvxopt.spmatrix(1.0, rows, columns, (count, count))
            order = np.array(cvxopt.amd.order(lower)).ravel()
            self._moved = np.searchsorted(whole.keys, pattern.keys)
            self._extended = wp.zeros(len(whole.keys), dtype=wp.float64, device=assembly.device)
            pattern = whole
        self._matrix = pattern.matrix()
        order = (order[:, None] * 3 + np.arange(3)).ravel()
        self._permutation = cvxopt.matrix(order.astype(np.int64))
        self._factor = None
        self.factored = False
        return entries_at(assembly.places(contacts, pattern), self._extended)

    # -- assembly and solution ------------------------------------------------------------

    def take_elements(self) -> None:
        """Take what the elements have added, to which contacts then add."""
        if self._moved is not None:
            extended = np.zeros(self._extended.shape)
            extended[self._moved] = self._values.numpy()
            self._extended.assign(extended)

    def factorise(self) -> None:
        """Factor what was assembled; ArithmeticError if it is not positive definite."""
        self._matrix.V = cvxopt.matrix(self._extended.numpy())
        if self._factor is None:
            self._factor = cholmod.symbolic(self._matrix, p=self._permutation)
        cholmod.numeric(self._matrix, self._factor)
        self.factored = True

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side, flat."""
        solution = cvxopt.matrix(right)
        cholmod.solve(self._factor, solution)
        return np.array(solution).ravel()


def flexible_gmres(
    solve: Callable[[np.ndarray], np.ndarray],
    product: Callable[[np.ndarray, np.ndarray], np.ndarray],
    right: np.ndarray,
    accuracy: float,
    products_max: int,
) -> np.ndarray:
    """Solve K x = b for x (n,), b not zero, to where it comes within the products allowed.

    Saad, SIAM J. Sci. Comput. 14 (1993): the preconditioned basis is kept, which saves SciPy's last
    solve, a third of them here. ``solve`` gives d = A^-1 y, ``product`` K d from y and d.
    """
    size = float(np.linalg.norm(right))
    basis, solutions = [right / size], []
    # Column by column, the Hessenberg matrix is made triangular by Givens rotations.
    columns: list[list[float]] = []
    rotations: list[tuple[float, float]] = []
    turned = [size]  # the right-hand side, rotated likewise: its last entry is the residual
    for _ in range(products_max):
        solutions.append(solve(basis[-1]))
        # The product is orthogonalised in place.
        vector = np.array(product(basis[-1], solutions[-1]))
        column = []
        for earlier in basis:
            column.append(float(np.dot(vector, earlier)))
            vector -= column[-1] * earlier
        rest = float(np.linalg.norm(vector))
        for row, (cosine, sine) in enumerate(rotations):
            above, below = column[row], column[row + 1]
            column[row] = cosine * above + sine * below
            column[row + 1] = cosine * below - sine * above
        radius = hypot(column[-1], rest)
        cosine, sine = (column[-1] / radius, rest / radius) if radius else (1.0, 0.0)
        rotations.append((cosine, sine))
        column[-1] = radius
        columns.append(column)
        turned.append(-sine * turned[-1])
        turned[-2] *= cosine
        if abs(turned[-1]) <= accuracy * size or rest <= LEAST_NEW * size:
            break
        basis.append(vector / rest)
    weights = list(turned[:-1])
    for k in reversed(range(len(weights))):
        weights[k] = weights[k] / columns[k][k] if columns[k][k] else 0.0
        for row in range(k):
            weights[row] -= weights[k] * columns[k][row]
    terms = (weight * solution for weight, solution in zip(weights, solutions, strict=True))
    return sum(terms, start=np.zeros_like(basis[0]))
