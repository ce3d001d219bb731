"""The heavy strip that lands: limits, moment balance, and the table of the physics page."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

from slipstitch.physics.experiments.landed_strip import (
    _flat_foot,
    landed_strip_slip_strain,
    landed_strip_theory,
)
from slipstitch.physics.experiments.strip import strip_slip_strain, strip_state_at_foot_angle


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
