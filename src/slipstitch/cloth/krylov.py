"""Flexible GMRES, which keeps the preconditioned basis instead of solving once more at the end."""

from __future__ import annotations

from collections.abc import Callable

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
    hessenberg = np.zeros((products_max + 1, products_max))
    for count in range(1, products_max + 1):
        solutions.append(solve(basis[-1]))
        # The product is orthogonalised in place.
        vector = np.array(product(basis[-1], solutions[-1]))
        for row, earlier in enumerate(basis):
            hessenberg[row, count - 1] = np.dot(vector, earlier)
            vector -= hessenberg[row, count - 1] * earlier
        rest = hessenberg[count, count - 1] = float(np.linalg.norm(vector))
        parts = hessenberg[: count + 1, :count]
        wanted = size * np.eye(count + 1)[0]
        weights = np.linalg.lstsq(parts, wanted, rcond=None)[0]
        left = float(np.linalg.norm(wanted - parts @ weights))
        if left <= accuracy * size or rest <= LEAST_NEW * size:
            break
        basis.append(vector / rest)
    return sum(weight * one for weight, one in zip(weights, solutions, strict=True))
