"""The planar drop-and-drag in the cloth simulator is the heavy elastica, whatever the law."""

import numpy as np
import pytest

from slipstitch.criticise.protocols.dragged_cloth import rest_state, sliding_state
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.experiments.strip_drag import steady_strip_drag
from slipstitch.physics.experiments.tracked_drag import DragRun, Sheet, drag_tracked
from slipstitch.physics.friction_law import Contact, FrictionLaw

SHEET = Sheet(areal_density_kg_m2=0.2, bending_Nm=6e-6, length_m=0.2)
WEIGHT_N_M2 = SHEET.areal_density_kg_m2 * GRAVITY_M_S2


def steady(law, height_m, **run):
    """Lag and contact length at the end of a stroke, in mm; contact length at rest."""
    seen = drag_tracked(law, SHEET, DragRun(height_m, 0.02, 0.08, **run), frame_rate_hz=5)
    lag_m = (seen.stage_m - seen.edge_m)[-5:]
    assert np.ptp(lag_m) < 1e-4
    return 1e3 * lag_m.mean(), 1e3 * seen.contact_m[-1], 1e3 * seen.contact_m[0]


@pytest.mark.parametrize("height_m, friction", [(0.10, 0.45), (0.13, 0.3)])
def test_coulomb_friction_gives_the_elastica_at_rest_and_sliding(height_m, friction):
    lag_mm, contact_mm, contact_at_rest_mm = steady(FrictionLaw(friction), height_m)
    length_m = (SHEET.bending_Nm / WEIGHT_N_M2) ** (1 / 3)
    sliding, rest = (
        steady_strip_drag(mu, SHEET.length_m, height_m, length_m, holder_angle_rad=None)
        for mu in (friction, 1e-9)
    )
    expected = sliding.holder_ahead_of_tail_m - rest.holder_ahead_of_tail_m
    assert lag_mm == pytest.approx(1e3 * expected, abs=0.1)
    assert contact_mm == pytest.approx(1e3 * sliding.flat_tail_m, abs=0.4)
    assert contact_at_rest_mm == pytest.approx(1e3 * rest.flat_tail_m, abs=0.4)


@pytest.mark.parametrize(
    "mechanisms",
    [
        {"adhesion": {"adhesion": 0.6}},
        {"load_power": {"load_power": -0.15}},
        {"static_kinetic": {"static_kinetic": 0.4}},
        {"rate": {"rate": 0.1}},
        {"anisotropy": {"anisotropy": 0.25}},
        {"nap": {"nap": 0.2}},
    ],
    ids=lambda law: "+".join(law),
)
def test_an_extended_law_gives_what_the_analytic_protocol_says(mechanisms):
    law, orientation_rad = FrictionLaw(0.45, mechanisms), 0.4
    lag_mm, contact_mm, _ = steady(law, 0.10, orientation_rad=orientation_rad)
    fabric = [np.array([v]) for v in (WEIGHT_N_M2, SHEET.bending_Nm, SHEET.length_m, 0.10)]
    moving = Contact(normal_force_N=np.nan, direction_rad=orientation_rad, speed_m_s=0.02)
    distance, contact = sliding_state(law, *fabric, moving, False)
    # The load's power differs a little: the law sees local pressures here, their mean there.
    assert lag_mm == pytest.approx(1e3 * (distance - rest_state(*fabric)[0])[0], abs=0.25)
    assert contact_mm == pytest.approx(1e3 * contact[0], abs=0.6)


@pytest.mark.parametrize("tilt_deg", [-3.0, 3.0])
def test_on_a_tilted_floor_gravity_leans_on_the_lifted_cloth_too(tilt_deg):
    tilt = np.radians(tilt_deg)
    lag_mm, contact_mm, _ = steady(FrictionLaw(0.45), 0.10, tilt_downhill_rad=tilt)
    fabric = [np.array([v]) for v in (WEIGHT_N_M2, SHEET.bending_Nm, SHEET.length_m, 0.10)]
    moving = Contact(normal_force_N=np.nan, speed_m_s=0.02)
    distance, contact = sliding_state(FrictionLaw(0.45), *fabric, moving, False, tilt)
    assert contact_mm == pytest.approx(1e3 * contact[0], abs=0.6)
    # The simulation starts from the shape on level ground, leaned: 0.1 and 0.65 mm further back
    # than that without tension.
    lag = 1e3 * (distance - rest_state(*fabric, tilt)[0])[0]
    assert lag_mm == pytest.approx(lag, abs=0.75)
    level = 1e3 * (
        sliding_state(FrictionLaw(0.45), *fabric, moving, False)[0] - rest_state(*fabric)[0]
    )
    assert np.sign(lag_mm - level[0]) == np.sign(tilt_deg)
