"""Flexible GMRES against dense solutions."""

import numpy as np
import pytest

from slipstitch.physics.cloth.tangent import flexible_gmres


def system(size, seed=0):
    generator = np.random.default_rng(seed)
    near = np.diag(generator.uniform(1.0, 10.0, size))
    exact = near + 0.3 * generator.normal(size=(size, size)) / np.sqrt(size)
    return near, exact, generator.normal(size=size)


def solved(near, exact, right, accuracy, products_max):
    calls = []

    def solve(y):
        calls.append(1)
        return np.linalg.solve(near, y)

    return flexible_gmres(solve, lambda y, d: exact @ d, right, accuracy, products_max), len(calls)


def test_a_system_that_is_not_symmetric_is_solved_to_the_accuracy_with_one_solve_a_product():
    near, exact, right = system(40)
    x, _ = solved(near, exact, right, 1e-12, 40)
    assert x == pytest.approx(np.linalg.solve(exact, right), rel=1e-9, abs=1e-12)
    x, solves = solved(near, exact, right, 0.1, 40)
    assert np.linalg.norm(exact @ x - right) <= 0.1 * np.linalg.norm(right)
    fewer, _ = solved(near, exact, right, 0.1, solves - 1)
    assert np.linalg.norm(exact @ fewer - right) > 0.1 * np.linalg.norm(right)


def test_an_exact_preconditioner_needs_one_product_and_more_never_let_the_residual_grow():
    near, exact, right = system(30, seed=3)
    x, solves = solved(near, near, right, 1e-10, 5)
    assert solves == 1
    assert x == pytest.approx(np.linalg.solve(near, right))
    residuals = [
        np.linalg.norm(exact @ solved(near, exact, right, 0.0, count)[0] - right)
        for count in range(1, 12)
    ]
    assert np.all(np.diff(residuals) <= 1e-12)
