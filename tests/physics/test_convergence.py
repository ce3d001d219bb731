"""The convergence study: which runs, how far apart they are, what simulations say of it."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.refusal import run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, recorded_path, write_json
from slipstitch.config import resolve_config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.convergence import study as module
from slipstitch.physics.convergence.cases import case_settings, cases
from slipstitch.physics.convergence.study import common_vertices, compare, describe, events
from slipstitch.physics.convergence.study_files import convergence_figure
from slipstitch.physics.simulation import convergence
from slipstitch.physics.simulation.convergence import measured_convergence, worst_verdict
from slipstitch.physics.simulation.trajectory import Trajectory

CONFIG = resolve_config(
    {
        "convergence": {
            "materials": ["gray-interlock", "royal-target"],
            "frictions": [0.1, 0.5],
            "vertices_per_side": [9, 17],
            "window_s": 20,
        }
    }
)


def made_up_run(side=9, late_s=0.0, offset_m=0.0, offset_from_s=0.0, bump_m=0.0):
    """A flat square carried by the stage that rolls over at 12 s, touches down at 2 s.

    ``bump_m``: how far it is thrown aside as it rolls over.
    """
    time_s = np.arange(201) / 10
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    uv = np.column_stack([u.ravel(), v.ravel()])
    x, z = StagePath().position_m(time_s)
    turned = 0.03 * np.tanh((time_s - 12 - late_s) / 0.2)
    # The lower edge stays where the stage found it until 10 s, then follows.
    height_m = np.where(uv[:, 1] == 1, 0.0, 0.05) + np.maximum(0.02 - 0.01 * time_s, 0)[:, None]
    positions = np.zeros((len(time_s), side**2, 3))
    positions[..., 0] = x[:, None] + turned[:, None] * uv[:, 1]
    positions[..., 1] = 0.2 * uv[:, 0] + offset_m * (time_s >= offset_from_s)[:, None]
    positions[..., 1] += bump_m * np.exp(-(((time_s - 12 - late_s) / 0.3) ** 2))[:, None]
    positions[..., 2] = height_m
    settings = SimulationSettings(vertices_per_side=side)
    return Trajectory(
        np.zeros((side**2, 3)), uv, np.zeros((1, 3), int), np.array([0]), np.arange(201), time_s,
        x, z, positions.astype(np.float32),
        {"step_s": 0.02, "settings": settings.model_dump(mode="json"),
         "solver": {"steps": 1}, "provenance": {"cpu_s": 1.0}},
    )  # fmt: skip


def test_steps_are_refined_on_the_first_mesh_and_meshes_at_the_first_step():
    found = [(c.friction, c.vertices_per_side, c.halvings) for c in cases(CONFIG)]
    assert len(found) == 2 * len(set(found))  # both fabrics
    assert sorted(set(found)) == [
        (friction, *refined) for friction in (0.1, 0.5) for refined in ((9, 0), (9, 2), (17, 0))
    ]
    assert len({case.pair for case in cases(resolve_config({}))}) == 30  # every fabric
    # The finest run has all of stepping finer, and the same frames.
    finest = next(c for c in cases(CONFIG) if c.halvings == 2)
    chosen = SimulationSettings(time_step_s=0.02, step_error_m=1.6e-4, friction_tolerance=1.6e-4)
    settings = case_settings(finest, CONFIG, chosen)
    assert settings.time_step_s == settings.steady_step_s == 0.005
    assert settings.step_error_m == settings.friction_tolerance == pytest.approx(1e-5)
    assert settings.bending_stiffness_at == "end"
    assert settings.frames == 241  # 20 s at 12 a second


def test_common_vertices_are_the_same_places_on_every_mesh():
    for side in (41, 61, 81):
        uv = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, side)]), -1).reshape(-1, 2)
        places = uv[common_vertices(side, (41, 61, 81))].reshape(21, 21, 2)
        np.testing.assert_allclose(places[0, :, 0], np.linspace(0, 1, 21))
        np.testing.assert_allclose(places[:, 0, 1], np.linspace(0, 1, 21))


def test_runs_are_compared_at_the_same_and_at_shifted_times():
    finest = made_up_run()
    assert compare(made_up_run(), made_up_run(17), (9, 17))["worst_m"] < 1e-7
    offset = compare(made_up_run(offset_m=0.002), finest, (9,))
    assert offset["mean_m"] == pytest.approx(0.002, rel=1e-4)
    assert offset["worst_m"] == pytest.approx(0.002, rel=1e-4)
    assert offset["shifted_mean_m"] == pytest.approx(0.002, rel=1e-2)
    # What only happens later is a matter of time, up to two seconds. Between frames a motion is
    # compared with the way from one to the next.
    for late_s, shifted_m in ((0.5, 1e-4), (0.05, 3e-4)):
        later = compare(made_up_run(late_s=late_s), finest, (9,))
        assert later["shifted_largest_m"] < shifted_m and later["steady_largest_m"] < 1e-4
        assert later["mean_largest_m"] > 1e-3
        assert later["worst_time_s"] == pytest.approx(12, abs=1)
        assert later["events"]["flip"]["shift_s"] == pytest.approx(late_s, abs=0.101)
    far = compare(made_up_run(late_s=module.SHIFT_MAX_S + 1.5), finest, (9,))
    assert far["shifted_largest_m"] > 1e-3
    with pytest.raises(BadInput, match="different frames"):
        compare(finest, replace(finest, time_s=finest.time_s * 2), (9,))


@pytest.mark.parametrize(
    "run, verdict",
    [
        ({"late_s": 0.0}, "converged"),
        ({"late_s": 0.5}, "converged but for the moment of an event (± 0.50 s)"),
        # 0.3 mm may be what a straight line from frame to frame leaves out.
        ({"bump_m": 3e-3}, "converged but for the course of an event (± 0.00 s, 2.7 mm)"),
        ({"offset_m": 0.002, "offset_from_s": 16.0}, "not converged"),  # at rest in another shape
        ({"late_s": 100.0}, "not converged"),  # it never rolls over
    ],
    ids=["same", "later", "thrown aside", "other shape", "no event"],
)
def test_what_happens_at_another_time_is_told_from_what_is_something_else(run, verdict):
    finest = {case.id: made_up_run(case.vertices_per_side) for case in cases(CONFIG)}
    rows = describe(CONFIG, finest | {"m09_f0500_n9_h0": made_up_run(**run)})["summary"]
    found = {(row["material"], row["friction"]): row for row in rows}["royal-target", 0.5]
    assert found["verdict"] == found["time_step"]["verdict"] == verdict
    assert {row["verdict"] for row in rows if row is not found} == {"converged"}


def test_events_are_told_by_the_motion_stroke_by_stroke():
    found = events(made_up_run())
    assert found["landing"] == pytest.approx(1.9, abs=0.01)
    assert found["flip"] == pytest.approx(12.0, abs=0.06)
    # v = a t on the ramp: 2 mm after sqrt(2 * 0.002 / 0.01) s.
    assert found["slip"] == pytest.approx(7 + np.sqrt(0.4), abs=0.02)
    assert events(made_up_run(late_s=100.0))["flip"] is None  # it does not roll over
    run = made_up_run()
    found = events(replace(run, time_s=run.time_s * 3))  # to 60 s, the flip at 36 s
    assert {"slip", "flip", "slip 2", "flip 2"} < set(found) and "flip 3" not in found
    assert found["flip 2"] is None


@pytest.mark.parametrize(
    "first_m, second_m, shift_s",
    [
        (2.1e-3, 1.9e-3, pytest.approx(0, abs=0.1)),  # a little farther than where it counts
        (1.9e-3, 2.1e-3, pytest.approx(0, abs=0.1)),
        (3.5e-3, 0.5e-3, None),
        (1.9e-3, 1.8e-3, "no event"),
    ],
)
def test_an_edge_that_stops_a_little_short_has_not_slipped_at_another_time(
    first_m, second_m, shift_s
):
    def dragged(far_m):
        run = made_up_run()
        lower = run.uv[:, 1] == 1
        run.positions_m[:, lower, 0] = far_m * np.clip(run.time_s - 8, 0, 1)[:, None]
        return run

    found = compare(dragged(first_m), dragged(second_m), (9,))["events"]
    assert found.get("slip", {"shift_s": "no event"})["shift_s"] == shift_s
    run, lower = made_up_run(), made_up_run().uv[:, 1] == 1
    run.positions_m[:, lower, 0] = 7e-3 * (np.abs(run.time_s - 12) < 0.15)[:, None]
    assert events(run)["slip"] is None  # thrown, it falls back
    run.positions_m[np.ix_(run.time_s > 14, lower, [0])] = 3e-3
    assert events(run)["slip"] == pytest.approx(14, abs=0.11)


def test_a_study_is_described_and_drawn():
    late = {0: 0.3, 2: 0.0}
    runs = {
        case.id: made_up_run(case.vertices_per_side, late[case.halvings]) for case in cases(CONFIG)
    }
    study = describe(CONFIG, runs)
    json.dumps(study, allow_nan=False)
    by_pair = {(row["material"], row["friction"]): row for row in study["summary"]}
    assert len(by_pair) == 4
    found = by_pair["gray-interlock", 0.5]
    assert found["time_step"]["event_shift_s"] == pytest.approx(0.3, abs=0.101)
    assert found["mesh"]["worst_m"] < 1e-7
    assert len(convergence_figure(study).axes) == 4


def test_a_study_that_is_not_complete_says_what_is_missing_and_claims_no_convergence():
    runs = {name: made_up_run() for name in ("m09_f0500_n9_h0", "m09_f0500_n9_h2")}
    late = describe(CONFIG, runs | {"m09_f0500_n9_h0": made_up_run(late_s=0.5)})["summary"][0]
    assert late["time_step"]["verdict"].startswith("converged but") and late["verdict"] is None
    study = describe(CONFIG, runs)
    assert len(study["missing"]) == len(cases(CONFIG)) - 2
    (row,) = study["summary"]
    assert row["time_step"]["finest"] == "m09_f0500_n9_h2"
    assert row["mesh"] is None and row["verdict"] is None
    with pytest.raises(BadInput, match="no runs of the study found"):
        describe(CONFIG, {})


@pytest.mark.parametrize(
    "change, message",
    [
        ({"vertices_per_side": [41, 61, 82]}, "too few positions in common"),
        ({"vertices_per_side": [81, 41]}, "must increase"),
        ({"window_s": 0}, "window_s: must be greater than 0"),
    ],
)
def test_an_impossible_study_is_refused(change, message):
    with pytest.raises(BadInput, match=message):
        resolve_config({"convergence": change})


def _record(tmp_path, material, friction, **settings):
    path = tmp_path / "convergence.json"
    found = {"mean_m": 2e-4, "mean_largest_m": 1.5e-3, "shifted_largest_m": 4e-4}
    studied = SimulationSettings(time_step_s=0.02)
    table = {
        "studied": {"time_step_s": studied.step_used_s, "window_s": 56.0, "mean_distance_m": 1e-3,
                    "simulation": studied.model_dump(mode="json")},
        "cases": [
            {"material": name, "friction": mu, "time_step": found, "mesh": None, "verdict": verdict}
            for name, mu, verdict in (
                ("gray-interlock", 0.1, "converged"),
                ("gray-interlock", 0.5, convergence.BUT_FOR_ITS_MOMENT.format(0.2)),
                ("gray-interlock", 1.5, "not converged"),
                ("royal-target", 0.1, "converged"),
                ("royal-target", 1.5, None),
            )
        ],
    }  # fmt: skip
    path.write_text(json.dumps(table))
    chosen = studied.model_copy(update=settings)
    return measured_convergence(material, friction, chosen, path)


@pytest.mark.parametrize(
    "material, friction, frictions, verdict",
    [
        ("gray-interlock", 0.1, [0.1], "converged"),
        ("gray-interlock", 0.3, [0.1, 0.5], "converged but for the moment of an event (± 0.20 s)"),
        ("gray-interlock", 0.7, [0.5, 1.5], "not converged"),
        ("gray-interlock", 1.6, [], None),
        ("royal-target", 0.1, [0.1], "converged"),
        ("royal-target", 0.2, [0.1, 1.5], None),
        ("ivory-rib-knit", 0.1, [], None),
    ],
)
def test_a_simulation_s_record_speaks_of_its_own_fabric_and_the_worse_neighbour(
    tmp_path, material, friction, frictions, verdict
):
    found = _record(tmp_path, material, friction)
    assert [case["friction"] for case in found["cases"]] == frictions
    assert found["verdict"] == verdict
    assert found["note"].startswith("this fabric was not studied") == (not frictions)
    assert found["table_sha256"] == file_digest(tmp_path / "convergence.json")


COARSER = {"time_step_s": 0.04, "friction_tolerance": 0.5, "steady_step_s": 0.9,
           "step_error_m": 1e9, "vertices_per_side": 31}  # fmt: skip
OTHER = {"bending_stiffness_at": "start", "damping_s": 0.0, "pins": "corner"}
FINER = {"time_step_s": 0.01, "vertices_per_side": 61, "step_error_m": 1e-5}
NO_MATTER = {"frames": 3, "yaw_sd_deg": 0.0, "newton_iterations_max": 2}


@pytest.mark.parametrize(
    "changes, differ", [(COARSER, [*COARSER]), (OTHER, [*OTHER]), (FINER, []), (NO_MATTER, [])]
)
def test_a_study_speaks_only_of_runs_with_its_settings_or_finer_ones(tmp_path, changes, differ):
    found = _record(tmp_path, "gray-interlock", 0.1, **changes)
    assert found["differ"] == differ
    assert found["verdict"] == (None if differ else "converged")
    assert ("other settings than those studied" in found["note"]) == bool(differ)


def test_of_verdicts_the_worse_has_the_larger_numbers():
    moments = [convergence.BUT_FOR_ITS_MOMENT.format(apart_s) for apart_s in (0.1, 9.0, 10.5)]
    apart = (0.1, 1.5), (0.5, 9.5), (0.5, 10.0), (9.0, 20.0), (10.5, 1.5), (99.0, 99.0)
    courses = [convergence.BUT_FOR_ITS_COURSE.format(*both) for both in apart]
    for pair in pairwise(["converged", *moments, *courses, "not converged"]):
        assert worst_verdict(pair) == worst_verdict(pair[::-1]) == pair[1]


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """A study with its picture and records, and where its summary is kept."""
    place = "slipstitch.physics.convergence.study_files.MEASURED"
    monkeypatch.setattr(place, tmp_path / "table.json")
    study = describe(CONFIG, {c.id: made_up_run(c.vertices_per_side) for c in cases(CONFIG)})
    write_json(tmp_path / "study.json", study, {"stage": "convergence"})
    with recorded_path(tmp_path / "study.png", {"stage": "convergence"}) as temporary:
        temporary.write_bytes(b"picture")
    return tmp_path / "study.json"


def published(study, capsys):
    """Exit code, last line of standard error, and files written."""
    out = study.parent / "published"
    code = run(f"convergence publish --study {study} --out {out}")
    written = {path.name for path in out.iterdir()} if out.exists() else set()
    assert (study.parent / "table.json").exists() == bool(written)
    return code, capsys.readouterr().err, written


def test_a_finished_study_is_published_with_picture_records_and_summary(finished, capsys):
    names = {"study.json", "study.png"}
    names |= {f"{name}.provenance.json" for name in names}
    assert published(finished, capsys) == (0, "", names)
    table = json.loads((finished.parent / "table.json").read_text())
    assert len(table["cases"]) == 4 and table["studied"]["window_s"] == 20


@pytest.mark.parametrize(
    "name, content, message",
    [
        ("study.json", {"missing": ["m09_f0500_n9_h2", "n17"]}, "m09_f0500_n9_h2 is not run (2 "),
        ("study.json", {"settings": {}}, "damaged or not a convergence study"),
        ("study.png", None, "study.png: no such file"),
        ("study.json.provenance.json", None, "study.json.provenance.json: no such file"),
        ("study.json.provenance.json", f'{{"sha256": "{"0" * 64}"}}', "does not match its record"),
        ("study.json.provenance.json", "{}", "does not match its record"),
        ("study.png.provenance.json", "[]", "damaged or not a record of provenance"),
        ("study.png", "another picture", "does not match its record"),
    ],
)
def test_what_is_not_finished_or_has_no_record_of_its_origin_is_not_published(
    finished, capsys, name, content, message
):
    file = finished.parent / name
    if isinstance(content, dict):
        write_json(file, json.loads(file.read_text()) | content, {"stage": "convergence"})
    else:
        file.unlink() if content is None else file.write_text(content)
    code, said, written = published(finished, capsys)
    assert (code, written) == (2, set())
    assert message in said and said.count("\n") == 1
