"""Forward models against published values, closed forms and other solvers."""

import numpy as np
import pytest
from support.departures import drop_drag, strip

from slipstitch.criticise.protocols.dragged_cloth import (
    lifted_part,
    rest_state,
    sliding_state,
    sticking_path,
)
from slipstitch.criticise.protocols.incline import slip_angle_rad
from slipstitch.criticise.protocols.strip import areal_contact, foot, slip_strain
from slipstitch.physics.friction_law import Contact, FrictionLaw

# Sano, Yamaguchi and Wada 2017, weightless strip: friction -> strain at slip.
PUBLISHED_SLIP = {
    0.05: 0.01238,
    0.10: 0.04687,
    0.15: 0.09690,
    0.20: 0.15487,
    0.25: 0.21446,
    0.30: 0.27156,
    0.35: 0.32399,
}


@pytest.mark.parametrize("friction, strain", PUBLISHED_SLIP.items())
def test_weightless_strip_slips_where_published(friction, strain):
    found = slip_strain(
        FrictionLaw(friction), np.zeros(1), np.ones(1), Contact(1.0, 1e-6, edge=True)
    )
    assert found[0] == pytest.approx(strain, abs=1e-5)


def test_weightless_strip_lies_flat_where_published():
    ratio, strain = areal_contact(np.zeros(1))
    assert ratio[0] == pytest.approx(0.3564, abs=1e-4)
    assert strain[0] == pytest.approx(0.3303, abs=1e-4)


@pytest.mark.parametrize("weight", [0.0, 2.0, 9.0, 25.0, 40.0])
def test_heavy_strip_agrees_with_collocation(weight):
    strain, load, pull, _ = strip.pushed_strip(weight)[:, 3:-8:4]
    found = foot(np.full(len(load), weight), pull / load)
    assert found[0] == pytest.approx(strain, abs=2e-6)
    assert found[1] == pytest.approx(load, rel=1e-5)


@pytest.mark.parametrize("tilt_deg, error", [(0.0, 2e-5), (-2.0, 1e-4), (4.0, 1e-4)])
def test_lifted_cloth_agrees_with_collocation(tilt_deg, error):
    lean = np.tan(np.radians(tilt_deg))
    for stiffness in (1e-3, 5e-3, 0.03, 0.2, 0.6):
        tension, *exact = drop_drag.lifted(stiffness, lean)[:, :28:6]
        for found, expected in zip(lifted_part(stiffness, tension, lean), exact, strict=True):
            assert found == pytest.approx(expected, abs=error)


def test_limp_cloth_hangs_plumb_over_a_tilted_floor():
    tilt, length, height = np.radians(3.0), 0.2, 0.1
    distance, contact = rest_state(
        np.array([2.0]), np.array([1e-13]), np.array([length]), np.array([height]), tilt
    )
    assert contact[0] == pytest.approx(length - height / np.cos(tilt), rel=1e-3)
    assert distance[0] == pytest.approx(contact[0] - height * np.tan(tilt), rel=1e-3)


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_limp_cloth_is_dragged_as_the_closed_form_says(friction):
    length, height = 0.2, 0.15
    reach = length + friction * height
    contact = reach - np.sqrt(reach**2 - length**2 + height**2)
    _, found = sliding_state(
        FrictionLaw(friction),
        np.array([2.0]),
        np.array([1e-13]),
        np.array([length]),
        np.array([height]),
        Contact(1.0),
        static=False,
    )
    assert found[0] == pytest.approx(contact, rel=1e-3)


def test_a_sticking_cloth_lifts_off_as_the_clamp_goes_on():
    advance, contact = sticking_path(2.0, 1e-5, 0.2, np.array([0.1]))
    assert advance[0, 0] == 0.0
    assert np.all(np.diff(advance[0]) > 0) and np.all(np.diff(contact[0]) < 0)


def test_coulomb_slips_at_the_friction_angle_whatever_the_load():
    slope = slip_angle_rad(FrictionLaw(0.5), np.array([1e-3, 1.0, 50.0]), Contact(1.0, 0.01))
    assert np.tan(slope) == pytest.approx(0.5)


def test_adhesion_on_the_incline_balances_the_forces():
    law = FrictionLaw(0.3, {"adhesion": {"adhesion": 5.0}})
    weight, area = 0.1, 0.005
    slope = slip_angle_rad(law, np.array([weight]), Contact(1.0, area))
    pull, load = weight * np.sin(slope), weight * np.cos(slope)
    assert pull == pytest.approx(0.3 * load + 5.0 * area)
