"""The heavy cantilever against the published figures, small sag and an independent solver."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from slipstitch.physics.experiments.cantilever import heavy_cantilever


@pytest.mark.parametrize(("gamma", "ratio"), [(1.0, 0.12456), (10.0, 1.0668), (100.0, 5.888)])
def test_height_over_width_is_the_published_one(gamma, ratio):
    assert heavy_cantilever(gamma).height_over_width == pytest.approx(ratio, rel=1e-4)


def test_small_sag_is_that_of_a_beam():
    """Tip deflection w L⁴ / 8 B."""
    assert heavy_cantilever(0.01).height_over_width == pytest.approx(0.01 / 8, rel=1e-4)


@pytest.mark.parametrize("gamma", [5.0, 300.0])
def test_collocation_finds_the_same_tip_angle(gamma):
    def slope(s, state):
        return np.vstack((state[1], -gamma * (1.0 - s) * np.cos(state[0])))

    station = np.linspace(0.0, 1.0, 400)
    guess = np.vstack((1.5 * (1 - np.exp(-math.sqrt(gamma) * station)), np.zeros(400)))
    solution = solve_bvp(
        slope, lambda a, b: np.array([a[0], b[1]]), station, guess, tol=1e-9, max_nodes=20000
    )
    assert solution.success
    assert solution.y[0, -1] == pytest.approx(heavy_cantilever(gamma).tip_angle_rad, abs=1e-6)


def test_it_hangs_lower_the_heavier_it_is():
    gammas = (0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0)
    ratios = [heavy_cantilever(gamma).height_over_width for gamma in gammas]
    assert ratios == sorted(ratios)


def test_the_textile_rule_of_41_5_degrees_is_gamma_8():
    """Peirce 1930, ASTM D1388: where the chord stands at 41.5°, B = ρ g (L/2)³."""
    chord = math.atan(heavy_cantilever(8.0).height_over_width)
    assert math.degrees(chord) == pytest.approx(41.5, abs=0.02)
