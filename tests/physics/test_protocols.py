"""Known answers: friction in the simulator against closed forms and the heavy elastica."""

import math

import pytest

from slipstitch.errors import BadInput
from slipstitch.protocol import run_protocol
from slipstitch.simulate.settings import SimulationSettings

FRICTIONS = (0.1, 0.5, 1.2)
STEPS_S = (0.005, 0.02)


def _incline(friction, multiple, step_s):
    slope_deg = math.degrees(math.atan(multiple * friction))
    return run_protocol(
        "incline",
        {"friction": friction, "slope_deg": slope_deg},
        SimulationSettings(time_step_s=step_s),
    )


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("friction", FRICTIONS)
def test_cloth_sticks_just_below_the_threshold_and_does_not_creep(friction, step_s):
    result = _incline(friction, 0.999, step_s)
    assert result["sticks"]
    assert result["creep_m"] < 1e-6


@pytest.mark.parametrize("step_s", STEPS_S)
@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("multiple", [1.001, 1.5])
def test_cloth_slides_above_the_threshold_with_the_theoretical_acceleration(
    friction, multiple, step_s
):
    result = _incline(friction, multiple, step_s)
    assert not result["sticks"]
    assert result["acceleration_m_s2"] == pytest.approx(
        result["theory_acceleration_m_s2"], rel=1e-3
    )


@pytest.mark.parametrize("friction", [0.1, 0.5, 1.0])
def test_dragging_flat_cloth_takes_friction_times_weight(friction):
    result = run_protocol("flat-drag", {"friction": friction}, SimulationSettings())
    assert result["pull_over_weight"] == pytest.approx(friction, rel=5e-3)


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_steady_drag_of_a_hanging_strip_is_the_heavy_elastica(friction):
    result = run_protocol("strip-drag", {"friction": friction}, SimulationSettings())
    assert result["pull_over_w_m"] == pytest.approx(result["theory_pull_over_w_m"], rel=0.01)
    assert result["floor_load_over_w_m"] == pytest.approx(
        result["theory_floor_load_over_w_m"], rel=0.01
    )
    assert result["holder_ahead_of_tail_m"] == pytest.approx(
        result["theory_holder_ahead_of_tail_m"], abs=1e-3
    )


def test_frictionless_cloth_slides_on_any_slope():
    result = run_protocol("incline", {"friction": 0.0, "slope_deg": 0.5}, SimulationSettings())
    assert not result["sticks"]
    assert result["acceleration_m_s2"] == pytest.approx(
        9.81 * math.sin(math.radians(0.5)), rel=1e-3
    )


@pytest.mark.parametrize(
    "name, options, message",
    [
        ("tilt", {}, "unknown protocol 'tilt'; allowed: incline"),
        ("incline", {"friction": 0.3}, "slope_deg is missing"),
        ("incline", {"friction": -0.3, "slope_deg": 5}, "friction -0.3: must be finite"),
        ("flat-drag", {"friction": float("nan")}, "friction nan: must be finite"),
        ("flat-drag", {"friction": 0.3, "colour": 1}, "unknown option 'colour'"),
    ],
)
def test_bad_options_are_named(name, options, message):
    with pytest.raises(BadInput, match=message):
        run_protocol(name, options)
