"""The calibrate stage's own logic, on a runner that answers as told; no simulator here."""

import json
import math
import re
from functools import cache, partial
from pathlib import Path

import pytest
from support.refusal import run
from support.synthetic_results import protocol_answer, strip_answer

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.base.page.figures import save_figure
from slipstitch.base.provenance import file_digest, read_provenance
from slipstitch.config import resolve_config, write_config
from slipstitch.config.simulation import BASE, KEYS, CalibrateSettings, SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.calibration import calibration as module
from slipstitch.physics.calibration import pictures
from slipstitch.physics.calibration.calibration import DemandNotMet, calibrate, strip_calibration
from slipstitch.physics.calibration.sweep import gamma_of, sweep, sweep_to_file, variations
from slipstitch.physics.experiments import strip
from slipstitch.physics.experiments.specimen import AREAL_DENSITY_KG_M2
from slipstitch.physics.simulation.convergence import MEASURED

SIMULATION = SimulationSettings(time_step_s=0.02, friction_tolerance=1e-4)
SETTINGS = CalibrateSettings(
    strip_frictions=(0.1, 0.3, 0.4),
    sweep_time_step_s=(0.005, 0.1, 0.4),
    sweep_friction_tolerance=(1e-5, 10.0),
    sweep_newton_iterations_max=(5,),
    sweep_damping_s=(0.0,),
)

# -- checks against theory ----------------------------------------------------------------------


def spoiled(protocol, key, change):
    """A runner that is perfect but for one key of one protocol."""

    def run(name, options, settings):
        result = protocol_answer(name, options, settings)
        if name == protocol:
            result[key] = change(result[key])
        return result

    return run


def test_a_simulator_with_small_errors_meets_every_demand(tmp_path):
    calibration = calibrate(SIMULATION, protocol_answer)
    assert calibration["met"]
    assert {check["name"] for check in calibration["checks"]} == {
        *("incline sticks", "incline creep", "incline acceleration"),
        *("flat-drag pull over weight", "strip-drag pull", "strip-drag tail"),
    }
    assert calibration["settings"]["time_step_s"] == SIMULATION.time_step_s
    assert "frames" not in calibration["settings"]
    inclines = [
        one["options"] for one in calibration["experiments"] if "slope_deg" in one["options"]
    ]
    slopes = [math.tan(math.radians(one["slope_deg"])) / one["friction"] for one in inclines]
    assert slopes == pytest.approx(3 * [0.999, 1.001, 1.5])  # about the angle of friction
    path = tmp_path / "calibration.json"
    module.write_calibration(calibration, path, {"stage": "calibrate"})
    written = json.loads(path.read_text())
    assert {"settings", "checks", "experiments", "met"} <= set(written)
    assert len(written["experiments"]) == 17
    assert (tmp_path / "calibration.json.provenance.json").exists()


@pytest.mark.parametrize(
    ("protocol", "key", "change", "name"),
    [
        ("incline", "sticks", lambda value: not value, "incline sticks"),
        ("incline", "creep_m", lambda value: math.nan, "incline creep"),
        ("incline", "acceleration_m_s2", lambda value: 1.002 * value, "incline acceleration"),
        ("flat-drag", "pull_over_weight", lambda value: 0.99 * value, "flat-drag pull"),
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
        module.write_calibration(calibration, path, {})
    assert list(tmp_path.iterdir()) == []
    assert f'"name": "{name}' in capsys.readouterr().err


def test_an_experiment_that_fails_is_named():
    def run(name, options, settings):
        raise NotConverged("step 7: residual 0.1")

    with pytest.raises(NotConverged, match=r"incline friction=0\.1 .*: step 7"):
        calibrate(SIMULATION, run)


# -- settings chosen with the pushed strip --------------------------------------------------------


def answer(name, options, simulation):
    """The error grows with the step; a loose tolerance slips where it should not.

    Ten times finer steps or tolerances cost more, five iterations fewer.
    """
    if name != "strip":
        return protocol_answer(name, options, simulation)
    if simulation.time_step_s > 0.3:
        raise NotConverged("at 0.4 s a step did not converge")
    iterations = round(20 / simulation.time_step_s) + (simulation.newton_iterations_max - 30)
    iterations += 50 * (simulation.friction_tolerance < 1e-4)
    result = dict(strip_answer(options["friction"], 0.1 * simulation.time_step_s, iterations))
    if simulation.friction_tolerance > 1:
        result |= {"slip_strain": 0.001, "regime": "slipped", "friction_read_from_strain": 0.01}
    return result


def trials(runner=answer):
    return [one for key in (BASE, *KEYS) for one in sweep(key, SETTINGS, SIMULATION, runner)]


@cache
def calibrated():
    return strip_calibration(trials())


def demand(monkeypatch, slip_strain, friction=module.STRIP_FRICTION):
    monkeypatch.setattr(module, "STRIP_SLIP_STRAIN", slip_strain)
    monkeypatch.setattr(module, "STRIP_FRICTION", friction)


def fails_as_configured(name, options, simulation):
    as_configured = simulation.newton_iterations_max, simulation.time_step_s
    if name == "strip" and as_configured == (30, SIMULATION.time_step_s):
        raise NotConverged("as configured")
    return answer(name, options, simulation)


@pytest.mark.parametrize(
    "runner, demands, iterations, step_s",
    [
        # Five iterations at most, or 0.1 s steps, would make a push cheaper.
        (answer, (module.STRIP_SLIP_STRAIN,), 30, 0.02),
        # Else the cheapest that meet the demand.
        (fails_as_configured, (module.STRIP_SLIP_STRAIN,), 5, 0.02),
        (answer, (0.02, 0.02), 30, 0.02),
        (answer, (1e-3,), 30, 0.005),
    ],
    ids=["configured", "cheapest", "never looser", "smaller step"],
)
def test_the_configured_settings_are_chosen_unless_they_fail(
    monkeypatch, runner, demands, iterations, step_s
):
    demand(monkeypatch, *demands)
    found = strip_calibration(trials(runner))
    chosen = found["chosen"]["settings"]
    assert (chosen["newton_iterations_max"], chosen["time_step_s"]) == (iterations, step_s)
    coarse = next(one for one in found["trials"] if one["settings"]["time_step_s"] == 0.1)
    assert coarse["meets"] == (demands == (0.02, 0.02)) and not coarse["may_be_chosen"]
    assert coarse["work"] < found["chosen"]["work"]


def test_wrong_regimes_and_pushes_that_cannot_be_solved_are_counted_and_kept():
    found = calibrated()
    loose = next(one for one in found["trials"] if one["settings"]["friction_tolerance"] == 10.0)
    assert not loose["meets"]
    assert loose["wrong_regimes"] == 2  # friction 0.4, two fabrics
    assert {run["theory_regime"] for run in loose["runs"]} == {"slipped", "partially slipped"}
    coarse = next(one for one in found["trials"] if one["settings"]["time_step_s"] == 0.4)
    assert coarse["wrong_regimes"] == len(coarse["runs"]) == 6
    assert "did not converge" in coarse["runs"][0]["failure"]
    json.dumps(found, allow_nan=False)


def test_settings_differ_from_the_configured_ones_in_one_key_only():
    base = variations(BASE, SETTINGS, SIMULATION)[0]
    for key in KEYS:
        for one in variations(key, SETTINGS, SIMULATION):
            assert {name for name in KEYS if one[name] != base[name]} == {key}


def test_the_strip_is_the_protocol_s():
    rigidity_Nm = 1e9 * strip.THICKNESS_M**3 / 12
    weight = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * strip.LENGTH_M**3
    assert gamma_of(1e9) == pytest.approx(weight / rigidity_Nm)
    assert gamma_of(6.3e8) <= strip.LARGEST_GAMMA


@pytest.mark.slow
def test_pictures_are_the_same_every_time_and_survive_what_was_not_run(tmp_path):
    data = calibrate(SIMULATION, protocol_answer) | {"strip": calibrated()}
    for figure in (pictures.calibration_figure, pictures.strip_figure, pictures.settings_figure):
        for copy in "ab":
            save_figure(figure(data), tmp_path / f"{copy}.svg", "svg")
        assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    save_figure(pictures.calibration_figure({"experiments": []}), tmp_path / "c.png", "png")
    assert (tmp_path / "c.png").stat().st_size > 1000


@pytest.fixture
def config(monkeypatch):
    monkeypatch.setattr("slipstitch.physics.experiments.registry.run_protocol", answer)
    return resolve_config(
        {
            "simulation": {"time_step_s": 0.02, "friction_tolerance": 1e-4},
            "calibrate": SETTINGS.model_dump(mode="json"),
        }
    )


def sweeps(config, folder):
    paths = [folder / f"{key}.json" for key in (BASE, *KEYS)]
    for key, path in zip((BASE, *KEYS), paths, strict=True):
        sweep_to_file(config, key, path)
    return paths


def test_sweeps_read_from_files_give_the_settings_and_every_file_names_its_rule_s_code(
    config, tmp_path
):
    """Else a release would refuse as made by other code what the workflow finds up to date."""
    out, again = tmp_path / "calibration.json", tmp_path / "again.svg"
    drawn = {name: tmp_path / f"{name}.svg" for name in ("checks", "strip", "settings")}
    paths = sweeps(config, tmp_path)
    module.calibrate_to_file(config, out, paths, partial(pictures.draw_pictures, drawn))
    written = json.loads(out.read_text())
    assert written["settings"]["newton_iterations_max"] == 30
    assert written["strip"]["not_told"] and written["convergence"]
    assert written["convergence_table_sha256"] == file_digest(MEASURED)
    assert all(path.exists() for path in drawn.values())
    pictures.draw_again(out, {"strip": again})
    stages = {path: read_provenance(path)["stage"] for path in (*paths, out, again)}
    assert stages == dict.fromkeys(paths, "calibrate.sweep") | {
        out: "calibrate.calibration", again: "calibrate.pictures"
    }  # fmt: skip
    rules = (Path(__file__).parents[2] / "rules/calibrate.smk").read_text(encoding="utf-8")
    assert set(stages.values()) == set(re.findall(r'code_of\("(.*?)"\)', rules))


def test_an_impossible_demand_says_what_came_closest_and_leaves_a_picture_of_what_failed(
    config, tmp_path, monkeypatch
):
    demand(monkeypatch, 1e-6)
    out, picture = tmp_path / "calibration.json", tmp_path / "settings.svg"
    draw = partial(pictures.draw_pictures, {"settings": picture})
    closest = "closest: time_step_s = 0.005 with slip strain within 0.0005"
    with pytest.raises(DemandNotMet, match=rf"\(slip strain within 1e-06.* {closest}"):
        module.calibrate_to_file(config, out, sweeps(config, tmp_path), draw)
    assert (tmp_path / "settings.failed.svg").exists()
    assert not out.exists() and not picture.exists()


@pytest.mark.slow
def test_with_only_failures_nothing_is_drawn_of_a_calibration_that_meets_the_demand(
    config, tmp_path
):
    write_config(config, tmp_path / "config.json")
    files = " ".join(map(str, sweeps(config, tmp_path)))
    command = f"calibrate --config {tmp_path}/config.json --sweeps {files}"
    command += f" --out {tmp_path}/calibration.json --settings-picture {tmp_path}/settings.svg"
    for words, is_drawn in ((" --only-failures", False), ("", True)):
        assert run(command + words) == 0
        assert (tmp_path / "settings.svg").exists() == is_drawn


def test_sweeps_of_another_configuration_are_refused(config, tmp_path):
    paths = sweeps(config, tmp_path)
    other = resolve_config({"calibrate": {"sweep_damping_s": [0.5]}})
    with pytest.raises(BadInput, match=r"base: pushed with other .*, tried than the"):
        module.read_sweeps(paths, other)
    with pytest.raises(BadInput, match=r"settings tried, but the configuration has"):
        module.read_sweeps(paths[:-1], config)
    stepped = config.simulation.model_copy(update={"step_error_m": 1e-5})
    with pytest.raises(BadInput, match=r"base: pushed with other simulation"):
        module.read_sweeps(paths, config.model_copy(update={"simulation": stepped}))
    (tmp_path / "base.json").write_text("{")
    with pytest.raises(BadInput, match=r"base\.json: damaged or not a JSON file"):
        module.read_sweeps(paths, config)
