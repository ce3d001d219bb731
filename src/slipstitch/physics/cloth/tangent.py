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

    Keys are ``column node * node count + row node``, sorted, every diagonal block among them.
    """

    def __init__(self, keys: np.ndarray, node_count: int):
        self.keys = keys
        self.node_count = node_count
        self.column, self.row = np.divmod(keys, node_count)
        per_node = np.bincount(self.column, minlength=node_count)
        self.first_length = 3 * per_node  # entries in the first of a node's three columns
        lengths = (self.first_length[:, None] - np.arange(3)).ravel()
        start = np.concatenate([[0], np.cumsum(lengths)])
        self.entry_count = int(start[-1])
        self.node_start = start[0:-1:3]
        rank = np.arange(len(keys)) - np.concatenate([[0], np.cumsum(per_node)])[self.column]
        self.block_start = self.node_start[self.column] + 3 * rank

    def block(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Positions of the blocks that couple two nodes among the keys."""
        row, column = np.maximum(first, second), np.minimum(first, second)
        return np.searchsorted(self.keys, column.astype(np.int64) * self.node_count + row)

    def entry(self, block: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Place of entry (row, column), 0...2 each, of a block; row >= column in diagonal ones."""
        length = self.first_length[self.column[block]]
        # Each column of a node is one entry shorter than the one before.
        before = column * length - (column == 2)
        return self.block_start[block] + before + row - column

    def entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        block = np.repeat(np.arange(len(self.keys)), 9)
        r, c = (np.tile(one.ravel(), len(self.keys)) for one in np.mgrid[0:3, 0:3])
        below = (self.row[block] != self.column[block]) | (r >= c)
        return block[below], r[below], c[below]

    def matrix(self) -> cvxopt.spmatrix:
        block, r, c = self.entries()
        rows = np.empty(self.entry_count, dtype=np.int64)
        columns = np.empty(self.entry_count, dtype=np.int64)
        place = self.entry(block, r, c)
        rows[place], columns[place] = 3 * self.row[block] + r, 3 * self.column[block] + c
        size = 3 * self.node_count
        return cvxopt.spmatrix(1.0, cvxopt.matrix(rows), cvxopt.matrix(columns), (size, size))


class Assembly:
    """Positions in the tangent stiffness to which the elements of a mesh contribute.

    Elements (n, k) list the nodes that they couple. ``template`` has the identity at fixed
    coordinates (V, 3), ``entries`` (n, 9 k^2) where an element's entries go, -1 above the diagonal
    or fixed, and ``node_entries`` (V, 6) likewise of a node's block (xx, yx, yy, zx, zy, zz).
    """

    def __init__(self, elements: list[np.ndarray], fixed: np.ndarray, device: str):
        self.device = device
        self._fixed = fixed.ravel()
        self.node_count = V = len(fixed)
        keys = [np.arange(V, dtype=np.int64) * (V + 1)]
        keys += [self.pair_keys(nodes) for nodes in elements]
        self.pattern = _Pattern(np.unique(np.concatenate(keys)), V)
        template = np.zeros(self.pattern.entry_count)
        node, axis = np.divmod(np.flatnonzero(self._fixed), 3)
        template[self.pattern.entry(self.pattern.block(node, node), axis, axis)] = 1.0
        self.template = wp.array(template, dtype=wp.float64, device=device)
        self.entries = [self._places(nodes) for nodes in elements]
        node = np.arange(V)[:, None]
        row, column = np.array([0, 1, 1, 2, 2, 2]), np.array([0, 0, 1, 0, 1, 2])
        place = self.pattern.entry(self.pattern.block(node, node), row, column)
        loose = ~self._fixed.reshape(V, 3)
        place = np.where(loose[:, row] & loose[:, column], place, -1)
        self.node_entries = wp.array(place.astype(np.int32), dtype=wp.int32, device=device)

    def pair_keys(self, nodes: np.ndarray) -> np.ndarray:
        """Keys of the blocks that elements couple; nodes of shape (n, k)."""
        k = nodes.shape[1]
        a, b = (nodes[:, one].ravel().astype(np.int64) for one in np.tril_indices(k, -1))
        return np.unique(np.minimum(a, b) * self.node_count + np.maximum(a, b))

    def _places(self, nodes: np.ndarray) -> wp.array:
        size = 3 * nodes.shape[1]
        dof = (nodes[:, :, None] * 3 + np.arange(3)).reshape(len(nodes), size)
        rows, columns = np.repeat(dof, size, axis=1), np.tile(dof, (1, size))
        kept = (rows >= columns) & ~self._fixed[rows] & ~self._fixed[columns]
        place = np.full(rows.shape, -1, dtype=np.int32)
        r, c = rows[kept], columns[kept]
        block = self.pattern.block(r // 3, c // 3)
        place[kept] = self.pattern.entry(block, r % 3, c % 3)
        return wp.array(place, dtype=wp.int32, device=self.device)


class Tangent:
    """Tangent stiffness of one sheet, to whose values elements add; factored by CHOLMOD."""

    def __init__(self, assembly: Assembly, elimination_order: np.ndarray, values: wp.array):
        self._assembly = assembly
        self._own = assembly.pattern
        self._order = elimination_order
        self._values = values
        self.uncouple()

    # -- contacts between far nodes -------------------------------------------------------

    def uncouple(self) -> None:
        """Hold the elements' couplings only."""
        self._whole = self._own
        self._moved = None
        self._extended = self._values
        self._new_pattern(self._order)

    def couple(self, contacts: np.ndarray) -> tuple[wp.array, wp.array]:
        """Make room for contacts (N, 4), each of which couples four nodes.

        Return (N, 10) of the node pairs b <= a: start and length of the block's first column.
        """
        keys = np.union1d(self._own.keys, self._assembly.pair_keys(contacts))
        whole = self._whole = _Pattern(keys, self._assembly.node_count)
        size = (whole.node_count, whole.node_count)
        ends = cvxopt.matrix(whole.row), cvxopt.matrix(whole.column)
        lower = cvxopt.spmatrix(1.0, *ends, size)
        self._new_pattern(np.array(cvxopt.amd.order(lower)).ravel())
        self._moved = self._entry_map()
        self._extended = wp.zeros(whole.entry_count, dtype=wp.float64, device=self._assembly.device)
        a, b = np.tril_indices(4)
        block = whole.block(contacts[:, a], contacts[:, b])
        return tuple(
            wp.array(one.astype(np.int32), dtype=wp.int32, device=self._assembly.device)
            for one in (whole.block_start[block], whole.first_length[whole.column[block]])
        )

    def _entry_map(self) -> np.ndarray:
        """Places in the whole pattern of the entries of the elements' own pattern."""
        own, whole = self._own, self._whole
        block, r, c = own.entries()
        moved = np.empty(own.entry_count, dtype=np.int64)
        to_block = np.searchsorted(whole.keys, own.keys)
        moved[own.entry(block, r, c)] = whole.entry(to_block[block], r, c)
        return moved

    def _new_pattern(self, node_order: np.ndarray) -> None:
        order = (node_order[:, None] * 3 + np.arange(3)).ravel()
        self._matrix = self._whole.matrix()
        self._permutation = cvxopt.matrix(order.astype(np.int64))
        self._factor = None
        self.factored = False

    # -- assembly and solution ------------------------------------------------------------

    def contact_values(self) -> wp.array:
        """Entries that contacts add to, once the elements have added theirs."""
        if self._moved is not None:
            extended = np.zeros(self._whole.entry_count)
            extended[self._moved] = self._values.numpy()
            self._extended.assign(extended)
        return self._extended

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
