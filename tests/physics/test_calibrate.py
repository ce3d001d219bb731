"""The calibrate stage's own logic, on a runner that answers as told; no simulator here."""

import json
import math

import pytest

from slipstitch.base.errors import NotConverged, SlipstitchError
from slipstitch.base.page.figures import save_figure
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.calibration.calibration import DemandNotMet, calibrate, write_calibration
from slipstitch.physics.calibration.calibration_figure import calibration_figure
from slipstitch.physics.calibration.experiments import Quantity, experiments
from slipstitch.physics.experiments.incline import incline_theory
from slipstitch.physics.experiments.strip_drag import steady_strip_drag

SIMULATION = SimulationSettings()


def answers_of_theory(name, options, settings):
    """What a perfect simulator would return."""
    friction = options["friction"]
    if name == "incline":
        result = incline_theory(friction, math.radians(options["slope_deg"]))
        return {
            "sticks": result.sticks,
            "creep_m": 0.0,
            "acceleration_m_s2": result.acceleration_m_s2,
            "theory_acceleration_m_s2": result.acceleration_m_s2,
        }
    if name == "flat-drag":
        return {"pull_over_weight": friction, "theory_pull_over_weight": friction}
    drag = steady_strip_drag(
        friction, 0.2, 0.15, options["gravity_length_m"], holder_angle_rad=None
    )
    keys = ("pull_over_w_m", "floor_load_over_w_m", "flat_tail_m", "holder_ahead_of_tail_m")
    measured = {key: getattr(drag, key) for key in keys}
    return measured | {f"theory_{key}": value for key, value in measured.items()}


def spoiled(protocol, key, change):
    """A runner that is perfect but for one key of one protocol."""

    def run(name, options, settings):
        result = answers_of_theory(name, options, settings)
        if name == protocol:
            result[key] = change(result[key])
        return result

    return run


def test_a_perfect_simulator_meets_every_demand():
    calibration = calibrate(SIMULATION, answers_of_theory)
    assert calibration["met"]
    names = {check["name"] for check in calibration["checks"]}
    assert names == {
        "incline sticks",
        "incline creep",
        "incline acceleration",
        "flat-drag pull over weight",
        "strip-drag pull",
        "strip-drag tail",
    }
    assert calibration["settings"]["time_step_s"] == SIMULATION.time_step_s
    assert "frames" not in calibration["settings"]


@pytest.mark.parametrize(
    ("protocol", "key", "change", "name"),
    [
        ("incline", "sticks", lambda value: False, "incline sticks"),
        ("incline", "sticks", lambda value: True, "incline sticks"),
        ("incline", "creep_m", lambda value: 2e-6, "incline creep"),
        ("incline", "creep_m", lambda value: math.nan, "incline creep"),
        ("incline", "acceleration_m_s2", lambda value: 1.002 * value, "incline acceleration"),
        ("flat-drag", "pull_over_weight", lambda value: 0.99 * value, "flat-drag pull"),
        ("strip-drag", "pull_over_w_m", lambda value: 1.03 * value, "strip-drag pull"),
        ("strip-drag", "pull_over_w_m", lambda value: None, "strip-drag pull"),
        ("strip-drag", "holder_ahead_of_tail_m", lambda value: value + 1.1e-3, "strip-drag tail"),
    ],
)
def test_every_demand_can_fail_and_then_nothing_is_written(
    protocol, key, change, name, tmp_path, capsys
):
    calibration = calibrate(SIMULATION, spoiled(protocol, key, change))
    assert not calibration["met"]
    path = tmp_path / "calibration.json"
    with pytest.raises(DemandNotMet, match=rf"^{name}.* measured .* theory .* allowed"):
        write_calibration(calibration, path, {})
    assert list(tmp_path.iterdir()) == []
    assert f'"name": "{name}' in capsys.readouterr().err


def test_small_errors_within_the_demand_pass():
    run = spoiled("strip-drag", "holder_ahead_of_tail_m", lambda value: value + 0.9e-3)
    assert calibrate(SIMULATION, run)["met"]


def test_the_written_file_holds_settings_checks_and_raw_results(tmp_path):
    path = tmp_path / "calibration.json"
    write_calibration(calibrate(SIMULATION, answers_of_theory), path, {"stage": "calibrate"})
    written = json.loads(path.read_text())
    assert {"settings", "checks", "experiments", "met"} <= set(written)
    assert len(written["experiments"]) == len(experiments()) == 17
    assert (tmp_path / "calibration.json.provenance.json").exists()


def test_experiments_straddle_the_angle_of_friction():
    slopes = [
        math.tan(math.radians(one.options["slope_deg"])) / one.options["friction"]
        for one in experiments()
        if one.protocol == "incline" and one.options["friction"] == 0.5
    ]
    assert slopes == pytest.approx([0.999, 1.001, 1.5])


def test_an_experiment_that_fails_is_named():
    def run(name, options, settings):
        raise NotConverged("step 7: residual 0.1")

    with pytest.raises(NotConverged, match=r"incline friction=0\.1 .*: step 7"):
        calibrate(SIMULATION, run)


def test_a_result_without_a_key_is_said():
    with pytest.raises(SlipstitchError, match="no 'sticks' in its result"):
        calibrate(SIMULATION, lambda name, options, settings: {})


def test_relative_error_where_theory_is_zero_needs_exactly_zero():
    quantity = Quantity("x", "k", 0.1, relative=True, theory=0.0)
    assert quantity.check("p", {}, {"k": 0.0}).met
    assert not quantity.check("p", {}, {"k": 1e-9}).met


def test_picture_is_the_same_every_time_and_survives_what_was_not_run(tmp_path):
    calibration = calibrate(SIMULATION, answers_of_theory)
    save_figure(calibration_figure(calibration), tmp_path / "a.svg", "svg")
    save_figure(calibration_figure(calibration), tmp_path / "b.svg", "svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    save_figure(calibration_figure({"experiments": []}), tmp_path / "c.png", "png")
    assert (tmp_path / "c.png").stat().st_size > 1000
