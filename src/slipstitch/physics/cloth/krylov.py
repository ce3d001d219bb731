"""Flexible GMRES, which keeps the preconditioned basis instead of solving once more at the end."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot

import numpy as np

LEAST_NEW = 1e-12  # part of a product that no earlier product had: less is rounding


def flexible_gmres(
    solve: Callable[[np.ndarray], np.ndarray],
    product: Callable[[np.ndarray, np.ndarray], np.ndarray],
    right: np.ndarray,
    accuracy: float,
    products_max: int,
) -> np.ndarray:
    """Solve K x = b for x, to where it comes within the products allowed.

    Saad, A flexible inner-outer preconditioned GMRES algorithm, SIAM J. Sci. Comput. 14 (1993).
    SciPy's GMRES solves with the preconditioner once more for its answer: of two or three
    products a correction, as the cloth needs, that is a third of the solves.

    Parameters
    ----------
    solve : callable
        The preconditioner: d = A^-1 y.
    product : callable
        K d from y and d = A^-1 y.
    right : ndarray, shape (n,)
        b, not zero.
    accuracy : float
        Residual wanted, over the size of b.
    products_max : int

    Returns
    -------
    ndarray, shape (n,)
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
