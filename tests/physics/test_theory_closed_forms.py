"""Incline, capstan, lateral buckling, heavy cantilever; arguments that no theory takes."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.linalg import eig

from slipstitch.base.errors import BadInput
from slipstitch.physics.experiments.cantilever import heavy_cantilever
from slipstitch.physics.experiments.capstan import capstan_theory
from slipstitch.physics.experiments.landed_strip import landed_strip_theory
from slipstitch.physics.experiments.lateral_buckling import lateral_buckling_theory
from slipstitch.physics.experiments.plane import incline_theory
from slipstitch.physics.experiments.strip import strip_slip_strain, strip_state
from slipstitch.physics.experiments.strip_drag import steady_strip_drag


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.5, 1.2])
def test_incline_sticks_up_to_the_angle_of_friction(friction):
    assert incline_theory(friction, math.atan(0.999 * friction)) == 0.0
    assert 0.0 < incline_theory(friction, math.atan(1.001 * friction) + 1e-9) < 0.02


def test_incline_without_friction_falls_with_the_slopes_share_of_gravity():
    assert incline_theory(0.0, math.radians(30)) == pytest.approx(9.81 / 2)


def test_sliding_loses_in_heat_what_friction_takes():
    """Energy over 1 s from rest: m g h = ½ m v² + μ m g cos θ · distance."""
    friction, slope = 0.3, math.radians(35)
    acceleration = incline_theory(friction, slope)
    distance, speed = 0.5 * acceleration, acceleration
    released = 9.81 * distance * math.sin(slope)
    heat = friction * 9.81 * math.cos(slope) * distance
    assert released == pytest.approx(0.5 * speed**2 + heat)


def test_capstan_is_the_limit_of_many_small_turns():
    friction, wrap, pieces = 0.4, math.radians(200), 200_000
    ratio = (1.0 + friction * wrap / pieces) ** pieces
    assert capstan_theory(friction, wrap) == pytest.approx(ratio, rel=1e-5)


def test_narrow_strip_buckles_where_the_torsion_equation_has_its_first_eigenvalue():
    """φ'' = −(k²/4)(1 − s)⁴ φ, φ(0) = 0, φ'(1) = 0: the smallest k, by Chebyshev collocation."""
    n = 40
    nodes = np.cos(np.pi * np.arange(n + 1) / n)
    c = np.hstack((2, np.ones(n - 1), 2)) * (-1) ** np.arange(n + 1)
    spread = nodes[:, None] - nodes[None, :] + np.eye(n + 1)
    first = np.outer(c, 1 / c) / spread
    first -= np.diag(first.sum(axis=1))
    first *= 2.0  # to [0, 1]; nodes[0] is s = 1
    station = (1 + nodes) / 2
    left = first @ first
    right = -np.diag((1 - station) ** 4) / 4
    left[0], right[0] = first[0], 0.0
    left[-1], right[-1] = np.eye(n + 1)[-1], 0.0
    values = eig(left, right, right=False)
    values = values[np.isfinite(values) & (np.abs(values) < 1e6)].real
    k = math.sqrt(values[values > 1].min())
    assert k == pytest.approx(12.854, abs=1e-3)
    assert lateral_buckling_theory(1.0, 2.0) == pytest.approx(k * math.sqrt(2), rel=1e-4)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.5])
def test_lateral_buckling_combines_bending_and_torsion_of_the_strip(ratio):
    """k √(EI·GJ)/(D b) with EI and GJ of a thin rectangle."""
    young, thickness, width = 1e6, 1e-3, 0.01
    bending = young * width * thickness**3 / 12
    torsion = young / (2 * (1 + ratio)) * width * thickness**3 / 3
    plate = young * thickness**3 / (12 * (1 - ratio**2)) * width
    expected = 12.854 * math.sqrt(2) * (1 - ratio) * math.sqrt(1 + ratio)
    found = lateral_buckling_theory(bending / plate, torsion / plate)
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("theory", "arguments", "said"),
    [
        (incline_theory, (-1.0, 0.1), "friction must be at least 0, not -1"),
        (incline_theory, (0.3, 2.0), "slope_rad"),
        (capstan_theory, (0.3, -1.0), "wrap_rad"),
        (heavy_cantilever, (1e6,), "gamma"),
        (landed_strip_theory, (1e5,), "gamma must be at least 0 and at most 3000, not 100000"),
        (strip_slip_strain, ("rough",), "friction must be a number, not 'rough'"),
        (strip_slip_strain, (math.nan,), "friction"),
        (strip_state, (0.34,), r"strain must be .* at most 0\.330"),
        (steady_strip_drag, (0.3, 0.0, 0.15, 0.01), "^length_m"),
        (steady_strip_drag, (0.3, 0.2, math.inf, 0.01), "height_m"),
        (steady_strip_drag, (0.3, 0.2, 0.15, 0.3), "gravity_length_m"),
        (steady_strip_drag, (0.3, 0.1, 0.15, 0.01), "height_m must be below length_m"),
    ],
)
def test_impossible_arguments_are_refused_by_name(theory, arguments, said):
    with pytest.raises(BadInput, match=said):
        theory(*arguments)


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
