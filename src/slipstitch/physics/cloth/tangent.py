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


class Tangent:
    """Tangent stiffness of a sheet, to which elements and contacts add; factored by CHOLMOD.

    Elements (n, k) list the nodes that they couple, or nodes alone, of which none may be missing.
    ``entries`` say of each kind where its entries go, (n, 9 k^2): -1 above the diagonal, and where
    a coordinate is ``fixed`` (V, 3), which has a 1 on the diagonal.
    """

    def __init__(
        self,
        elements: list[np.ndarray],
        fixed: np.ndarray,
        elimination_order: np.ndarray,
        device: str,
    ):
        self._fixed, self._node_count, self._device = fixed.ravel(), len(fixed), device
        self._order = elimination_order
        blocks = np.unique(np.concatenate([self._blocks(nodes) for nodes in elements]))
        own = self._own = _Pattern(blocks, self._node_count)
        held = np.flatnonzero(self._fixed)
        empty = np.zeros(len(own.keys))
        empty[own.place(held, held)] = 1.0
        self._empty = wp.array(empty, dtype=wp.float64, device=device)
        self._values = wp.zeros_like(self._empty)
        self.entries = [self._entries(nodes, own, self._values) for nodes in elements]
        self.couple(np.zeros((0, 4), dtype=np.int32))

    def _blocks(self, nodes: np.ndarray) -> np.ndarray:
        """Numbers of the blocks that elements couple."""
        a, b = (nodes[:, k].ravel().astype(np.int64) for k in np.tril_indices(nodes.shape[1]))
        return np.unique(np.minimum(a, b) * self._node_count + np.maximum(a, b))

    def _entries(self, nodes: np.ndarray, pattern: _Pattern, values: wp.array) -> Entries:
        """Where elements add, and to what."""
        of_node = 3 * nodes[:, :, None].astype(np.int32) + np.arange(3, dtype=np.int32)
        own = of_node.reshape(len(nodes), 3 * nodes.shape[1])
        rows, columns = np.broadcast_arrays(own[:, :, None], own[:, None])
        free = ~self._fixed[own]
        kept = (rows >= columns) & free[:, :, None] & free[:, None]
        place = np.full(rows.shape, -1, dtype=np.int32)
        place[kept] = pattern.place(rows[kept], columns[kept])
        entries = Entries()
        place = place.reshape(len(nodes), own.shape[1] ** 2)
        entries.place = wp.array(place, dtype=wp.int32, device=self._device)
        entries.values = values
        return entries

    def couple(self, contacts: np.ndarray) -> Entries:
        """Make room for contacts (N, 4) between far nodes, each of which couples four."""
        pattern, order, count = self._own, self._order, self._node_count
        self._extended, self._moved = self._values, None
        if len(contacts):
            blocks = np.union1d(self._own.blocks, self._blocks(contacts))
            pattern = _Pattern(blocks, count)
            columns, rows = map(cvxopt.matrix, np.divmod(blocks, count))
            lower = cvxopt.spmatrix(1.0, rows, columns, (count, count))
            order = np.array(cvxopt.amd.order(lower)).ravel()
            self._moved = np.searchsorted(pattern.keys, self._own.keys)
            self._extended = wp.zeros(len(pattern.keys), dtype=wp.float64, device=self._device)
        self._matrix = pattern.matrix()
        order = (order[:, None] * 3 + np.arange(3)).ravel()
        self._permutation = cvxopt.matrix(order.astype(np.int64))
        self._factor = None
        self.factored = False
        return self._entries(contacts, pattern, self._extended)

    def clear(self) -> None:
        """Take away what was added."""
        wp.copy(self._values, self._empty)

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
