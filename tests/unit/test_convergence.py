"""The convergence study: which runs, how far apart they are, what simulations say of it."""

import json

import numpy as np
import pytest

from slipstitch.bench.stage_path import StagePath
from slipstitch.config import resolve_config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.convergence.cases import case_settings, cases
from slipstitch.convergence.distance_figure import convergence_figure
from slipstitch.convergence.study import SHIFT_MAX_S, common_vertices, compare, describe, events
from slipstitch.errors import BadInput
from slipstitch.simulate.convergence import measured_convergence
from slipstitch.simulate.trajectory import Trajectory

CONFIG = resolve_config(
    {
        "convergence": {
            "materials": ["gray-interlock", "royal-target"],
            "frictions": [0.1, 0.5],
            "finest_frictions": [0.5],
            "vertices_per_side": [9, 13, 17],
            "window_s": 20,
        }
    }
)


def made_up_run(side=9, late_s=0.0, offset_m=0.0):
    """A flat square carried by the stage that rolls over at 12 s, touches down at 2 s."""
    time_s = np.arange(201) / 10
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    uv = np.column_stack([u.ravel(), v.ravel()])
    x, z = StagePath().position_m(time_s)
    turned = 0.03 * np.tanh((time_s - 12 - late_s) / 0.2)
    # The lower edge stays where the stage found it until 10 s, then follows.
    height_m = np.where(uv[:, 1] == 1, 0.0, 0.05) + np.maximum(0.02 - 0.01 * time_s, 0)[:, None]
    positions = np.zeros((len(time_s), side**2, 3))
    positions[..., 0] = x[:, None] + turned[:, None] * uv[:, 1]
    positions[..., 1] = 0.2 * uv[:, 0] + offset_m
    positions[..., 2] = height_m
    settings = SimulationSettings(vertices_per_side=side)
    return Trajectory(
        np.zeros((side**2, 3)), uv, np.zeros((1, 3), int), np.array([0]), np.arange(201), time_s,
        x, z, positions.astype(np.float32),
        {"step_s": 0.02, "settings": settings.model_dump(mode="json"),
         "solver": {"steps": 1}, "provenance": {"cpu_s": 1.0}},
    )  # fmt: skip


def test_time_steps_are_halved_on_the_first_mesh_and_meshes_refined_at_the_first_step():
    found = [(c.friction, c.vertices_per_side, c.halvings) for c in cases(CONFIG)]
    assert len(found) == 2 * len(set(found))  # both fabrics
    assert sorted(set(found)) == [
        (0.1, 9, 0), (0.1, 9, 1),
        (0.5, 9, 0), (0.5, 9, 1), (0.5, 9, 2), (0.5, 13, 0), (0.5, 17, 0),
    ]  # fmt: skip


def test_a_halved_run_has_half_the_step_and_the_same_frames():
    finest = next(c for c in cases(CONFIG) if c.halvings == 2)
    settings = case_settings(finest, CONFIG, SimulationSettings(time_step_s=0.02))
    assert settings.time_step_s == 0.005
    assert settings.frames == 241  # 20 s at 12 a second


@pytest.mark.parametrize("side", [41, 61, 81])
def test_common_vertices_are_the_same_places_on_every_mesh(side):
    line = np.linspace(0, 1, side)
    uv = np.stack(np.meshgrid(line, line, indexing="xy"), -1).reshape(-1, 2)
    expected = np.linspace(0, 1, 21)
    places = uv[common_vertices(side, (41, 61, 81))].reshape(21, 21, 2)
    np.testing.assert_allclose(places[0, :, 0], expected)
    np.testing.assert_allclose(places[:, 0, 1], expected)


def test_equal_runs_on_different_meshes_are_no_distance_apart():
    found = compare(made_up_run(9), made_up_run(17), (9, 13, 17))
    assert found["worst_m"] < 1e-7


def test_a_constant_offset_is_the_mean_and_the_worst_distance():
    found = compare(made_up_run(offset_m=0.002), made_up_run(), (9,))
    assert found["mean_m"] == pytest.approx(0.002, rel=1e-4)
    assert found["worst_m"] == pytest.approx(0.002, rel=1e-4)
    assert found["shifted_mean_m"] == pytest.approx(0.002, rel=1e-2)


def test_what_only_happens_later_is_found_to_be_a_matter_of_time():
    found = compare(made_up_run(late_s=0.5), made_up_run(), (9,))
    assert found["events"]["flip"]["shift_s"] == pytest.approx(0.5, abs=0.101)
    assert found["mean_largest_m"] > 0.02
    assert found["shifted_largest_m"] < 1e-3
    assert abs(found["worst_time_s"] - 12) < 1


def test_events_are_told_by_the_motion():
    found = events(made_up_run())
    assert found["landing"] == pytest.approx(1.9, abs=0.01)
    assert found["flip"] == pytest.approx(12.0, abs=0.06)
    # v = a t on the ramp: 2 mm after sqrt(2 * 0.002 / 0.01) s.
    assert found["slip"] == pytest.approx(7 + np.sqrt(0.4), abs=0.02)


def test_a_run_without_a_roll_over_has_no_flip():
    assert events(made_up_run(late_s=100.0))["flip"] is None


def test_shifts_are_bounded():
    found = compare(made_up_run(late_s=SHIFT_MAX_S + 1.5), made_up_run(), (9,))
    assert found["shifted_largest_m"] > 1e-3


def test_runs_with_different_frames_are_refused():
    run = made_up_run()
    other = made_up_run()
    object.__setattr__(other, "time_s", other.time_s * 2)
    with pytest.raises(BadInput, match="different frames"):
        compare(run, other, (9,))


def test_a_study_is_described_and_drawn():
    late = {0: 0.3, 1: 0.1, 2: 0.0}
    runs = {
        case.id: made_up_run(case.vertices_per_side, late[case.halvings]) for case in cases(CONFIG)
    }
    study = describe(CONFIG, runs)
    json.dumps(study, allow_nan=False)
    by_pair = {(row["material"], row["friction"]): row for row in study["summary"]}
    assert len(by_pair) == 4
    # Against the run halved once where that is the finest, else against the one halved twice.
    once = by_pair["gray-interlock", 0.1]["time_step"]["event_shift_s"]
    twice = by_pair["gray-interlock", 0.5]["time_step"]["event_shift_s"]
    assert (once, twice) == (pytest.approx(0.2, abs=0.101), pytest.approx(0.3, abs=0.101))
    assert by_pair["gray-interlock", 0.1]["mesh"] is None
    assert by_pair["gray-interlock", 0.5]["mesh"]["worst_m"] < 1e-7
    assert len(convergence_figure(study).axes) == 4


def test_a_study_that_is_not_complete_says_what_is_missing_and_claims_no_convergence():
    runs = {name: made_up_run() for name in ("m09_f01_n9_h0", "m09_f01_n9_h1")}
    study = describe(CONFIG, runs)
    assert len(study["missing"]) == len(cases(CONFIG)) - 2
    (row,) = study["summary"]
    assert row["time_step"]["finest"] == "m09_f01_n9_h1"
    assert row["mesh"] is None and row["converged"] is None
    with pytest.raises(BadInput, match="no runs of the study found"):
        describe(CONFIG, {})


@pytest.mark.parametrize(
    "change, message",
    [
        ({"vertices_per_side": [41, 61, 82]}, "too few positions in common"),
        ({"vertices_per_side": [81, 41]}, "must increase"),
        ({"materials": ["silk"]}, "unknown material 'silk'"),
        ({"window_s": 0}, "window_s: must be greater than 0"),
    ],
)
def test_an_impossible_study_is_refused(change, message):
    with pytest.raises(BadInput, match=message):
        resolve_config({"convergence": change})


def _record(tmp_path, material, friction, **settings):
    path = tmp_path / "convergence.json"
    found = {"mean_m": 2e-4, "mean_largest_m": 1.5e-3, "worst_m": 5e-3,
             "shifted_mean_m": 1e-4, "event_shift_s": 0.12, "events_missing": []}  # fmt: skip
    table = {
        "studied": {"time_step_s": 0.02, "vertices_per_side": 41, "window_s": 38.0},
        "cases": [
            {"material": name, "friction": mu, "time_step": found, "mesh": None, "converged": ok}
            for name, mu, ok in (
                ("gray-interlock", 0.1, True),
                ("gray-interlock", 1.0, False),
                ("royal-target", 0.1, True),
            )
        ],
    }
    path.write_text(json.dumps(table))
    chosen = SimulationSettings(**{"time_step_s": 0.02, **settings})
    return measured_convergence(material, friction, chosen, chosen.time_step_s, path)


def test_a_simulation_s_record_names_the_nearest_studied_case(tmp_path):
    found = _record(tmp_path, "gray-interlock", 0.7)
    assert found["nearest"] == {"material": "gray-interlock", "friction": 1.0}
    assert found["converged"] is False
    assert found["note"] == (
        "not converged at gray-interlock, friction 1: 0.20 mm from the finest time step on "
        "average, 1.50 mm at the worst time, 5.0 mm at the worst vertex, events up to 0.12 s "
        "apart; mesh not studied"
    )
    assert _record(tmp_path, "royal-target", 0.0)["converged"] is True


def test_a_run_coarser_than_the_study_says_that_nothing_is_known(tmp_path):
    for coarser in ({"time_step_s": 0.04}, {"vertices_per_side": 31}):
        found = _record(tmp_path, "gray-interlock", 0.1, **coarser)
        assert found["applies"] is False and found["converged"] is None
        assert "coarser than the studied settings" in found["note"]


def test_without_a_study_the_record_is_empty(tmp_path):
    settings = SimulationSettings()
    assert measured_convergence("silk", 0.1, settings, 0.02, tmp_path / "none.json") is None
