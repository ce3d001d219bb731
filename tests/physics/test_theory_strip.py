"""The pushed strip of Sano et al. 2017 and the strip that lands: closed forms and figures."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.special import ellipeinc, ellipk, ellipkinc

from slipstitch.physics.experiments.landed_strip import (
    _flat_foot,
    landed_strip_slip_strain,
    landed_strip_theory,
)
from slipstitch.physics.experiments.strip import (
    strip_buckling_load,
    strip_slip_strain,
    strip_state,
    strip_state_at_foot_angle,
)

PUBLISHED = (0.01238, 0.04687, 0.09690, 0.15487, 0.21446, 0.27156, 0.32399)


def test_slip_strains_are_the_published_ones():
    found = [strip_slip_strain(friction / 20) for friction in range(1, 8)]
    assert found == pytest.approx(PUBLISHED, abs=1e-5)


def test_the_foot_lies_flat_at_the_published_strain_and_with_more_friction_never_slips():
    flat = strip_state_at_foot_angle(math.pi / 2)
    assert flat.strain == pytest.approx(0.3303, abs=5e-5)
    assert flat.load_ratio == pytest.approx(0.3564, abs=5e-5)
    assert strip_slip_strain(0.3563) is not None
    assert strip_slip_strain(0.3565) is None
    assert strip_slip_strain(1.5) is None


def test_without_friction_it_slips_as_soon_as_it_buckles():
    assert strip_slip_strain(0.0) == 0.0
    assert 0.0 < strip_slip_strain(1e-3) < 1e-5


def test_it_buckles_at_the_clamped_hinged_load():
    assert strip_buckling_load() == pytest.approx(20.19, abs=5e-3)
    assert strip_state_at_foot_angle(0.01).vertical_load == pytest.approx(
        strip_buckling_load(), rel=1e-4
    )


@pytest.mark.parametrize("foot_angle", [0.1, 0.5, 1.0, 1.4, math.pi / 2])
def test_state_satisfies_the_elliptic_integrals_of_the_elastica(foot_angle):
    """ψ = θ + atan(Q/P) swings like a pendulum: ψ'' = −R sin ψ, which Jacobi solved."""
    state = strip_state_at_foot_angle(foot_angle)
    total = math.hypot(state.vertical_load, state.horizontal_load)
    lean = math.atan2(state.horizontal_load, state.vertical_load)
    # Friction pushes the foot back under the clamp: ψ = lean at the clamp, lean − α at the foot,
    # where the pendulum is at rest, having passed the other turning point on its way.
    modulus = math.sin(0.5 * (foot_angle - lean))
    amplitude = math.asin(math.sin(0.5 * lean) / modulus)
    quarter = ellipk(modulus**2)
    offset = ellipkinc(amplitude, modulus**2)
    arcs = {sign * offset + turns * quarter: (sign, turns) for sign in (1, -1) for turns in (1, 3)}
    arc = min(arcs, key=lambda value: abs(value - math.sqrt(total)))
    assert arc == pytest.approx(math.sqrt(total), rel=1e-8)
    sign, turns = arcs[arc]
    # ∫ cos ψ ds = (2 E − arc)/√R with E the integral of dn² over that arc.
    second_kind = sign * ellipeinc(amplitude, modulus**2) + turns * ellipeinc(
        math.pi / 2, modulus**2
    )
    along = (2.0 * second_kind - arc) / math.sqrt(total)
    # With the foot under the clamp the whole chord is vertical: ∫ cos ψ = (1 − ε) cos lean.
    assert along == pytest.approx((1.0 - state.strain) * math.cos(lean), abs=1e-8)


def test_shape_has_the_strips_length_and_its_foot_under_the_clamp():
    state = strip_state(0.2)
    pieces = np.linalg.norm(np.diff(state.curve, axis=0), axis=1)
    assert pieces.sum() == pytest.approx(1.0, abs=1e-4)
    assert state.curve[-1] == pytest.approx((0.0, 0.8), abs=1e-8)


def test_state_at_the_slip_strain_needs_exactly_that_friction():
    assert strip_state(strip_slip_strain(0.2)).load_ratio == pytest.approx(0.2, abs=1e-7)


@pytest.mark.parametrize("friction", [0.05, 0.2, 0.3])
def test_without_weight_it_is_the_pushed_strip(friction):
    expected = strip_slip_strain(friction)
    assert landed_strip_slip_strain(friction, 0.0) == pytest.approx(expected, abs=1e-5)
    flat = strip_state_at_foot_angle(np.pi / 2)
    assert landed_strip_theory(0.0).load_ratio == pytest.approx(flat.load_ratio, abs=1e-5)


@pytest.mark.parametrize("gamma, threshold", [(10.0, 0.3802), (100.0, 0.4272), (1000.0, 0.3960)])
def test_thresholds_of_the_physics_page(gamma, threshold):
    assert landed_strip_theory(gamma).load_ratio == pytest.approx(threshold, abs=2e-4)
    assert landed_strip_slip_strain(threshold + 1e-3, gamma) is None
    assert landed_strip_slip_strain(threshold - 1e-3, gamma) > 0


def test_forces_and_moments_on_the_whole_strip_balance():
    """Moment at the clamp: Q at the foot's depth less the weight at its lever."""
    gamma = 300.0
    station, (_, curvature, across, down), (_, horizontal) = _flat_foot(gamma)
    moment = horizontal * down[-1] - gamma * trapezoid(across, station)
    assert curvature[0] == pytest.approx(moment, abs=1e-3 * abs(curvature).max())
    assert curvature[-1] == pytest.approx(0.0, abs=1e-6)
