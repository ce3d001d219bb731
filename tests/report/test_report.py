"""The report on a made-up results folder, whole, partial, empty and damaged."""

import base64
import html
import io
import json
import re
import shutil
from datetime import UTC, datetime

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from support import synthetic_results

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import duration, evenly, percent
from slipstitch.base.provenance import file_digest, provenance_record, read_sidecar, write_sidecar
from slipstitch.cli.main import main
from slipstitch.config.simulation import SimulationSettings
from slipstitch.dataset.manifest import write_manifest
from slipstitch.dataset.videos import ROLES
from slipstitch.design.grid import simulations
from slipstitch.learning.evaluation.cumulative import cumulative_error
from slipstitch.learning.evaluation.metrics import entry
from slipstitch.learning.evaluation.probes import MIDDLE_FRAME
from slipstitch.report import learning_pictures
from slipstitch.report.captures_section import floors_in_words, training_floors
from slipstitch.report.dataset import dataset
from slipstitch.report.learning import share_interval
from slipstitch.report.learning_pictures import confusion_counts
from slipstitch.report.page import (
    closest_frictions,
    page_context,
    render_page,
    scale_in_words,
    write_report,
)
from slipstitch.report.results import Results
from slipstitch.report.simulations import simulation_section

CONFIG = synthetic_results.config()
NOW = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    synthetic_results.write_all(CONFIG, folder)
    return folder


@pytest.fixture(scope="module")
def page(whole):
    return render_page(page_context(Results(whole, CONFIG), NOW))


def text_of(page):
    """What a reader reads: no style, no tags, single spaces."""
    body = re.sub(r"<style>.*?</style>", "", page, flags=re.S)
    return " ".join(re.sub(r"<[^>]+>", " ", body).split())


def test_page_needs_no_other_file_and_no_network(page):
    assert not re.findall(r"https?://", re.sub(r'src="data:[^"]*"', "", page))
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "<script" not in page and "@import" not in page


def test_every_picture_can_be_decoded(page):
    uris = re.findall(r'src="data:image/([a-z+]+);base64,([^"]+)"', page)
    assert len(uris) > 20
    for kind, content in uris:
        raw = base64.b64decode(content)
        if kind == "svg+xml":
            assert b"<svg" in raw and b"</svg>" in raw
        else:
            assert Image.open(io.BytesIO(raw)).size[0] > 8


def test_nothing_is_called_missing_where_everything_is_there(page):
    text = text_of(page)
    assert "Not run." not in text
    assert "not there" not in text


def test_criticism_and_audit_are_shown_and_damage_is_not_hidden(whole, page, tmp_path):
    text = text_of(page)
    assert "The model is wrong and no known mechanism explains how" in text
    assert "clearest trace is a step in the place on the substrate" in text
    assert "Audit: intact ." in text and "5e" * 32 in text
    synthetic_results.write_audit(tmp_path, "damaged")
    shown = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert "Audit: damaged (altered: 1)." in shown
    assert "No measured case has been analysed." in shown


def test_the_result_is_that_of_held_out_simulations_beside_chance(page, whole):
    scores = Results(whole, CONFIG).metrics()["by_simulation"]
    best = max(row["friction_lt_0.1"] for row in scores.values())
    text = text_of(page)
    assert f"for {percent(best)} of 36 test videos from 6 simulations" in text
    assert "whole simulations held out" in text
    assert "A uniform random guess is correct for 33.3 %" in text


def table(page, heading):
    """Rows of the first table under a heading, as lists of what the cells say."""
    after = page[page.index(f"<h3>{heading}") :]
    rows = re.findall(r"<tr.*?</tr>", after[: after.index("</table>")], flags=re.S)
    return [
        [html.unescape(text_of(cell)) for cell in re.findall(r"<t[dh].*?</t[dh]>", row, flags=re.S)]
        for row in rows
    ]


def page_of(folder, config=CONFIG):
    return render_page(page_context(Results(folder, config), NOW))


def test_table_2_shows_every_figure_of_the_paper(page):
    rows = {row[0]: row[1:] for row in table(page, "Table 2")}
    assert rows["Material, top 1"][0] == "99.5 %"
    assert rows["Friction, error < 0.1, given the material"][0] == "95.5 %"
    assert rows["Friction, error < 0.2, given the material"][0] == "99.2 %"
    assert rows["Friction, error < 0.1, baseline"][0] == "78.6 %"
    assert rows["Friction, error < 0.2, baseline"][0] == "88.5 %"
    assert rows["Material, top 2"][0] == "100.0 %"
    assert rows["Material, top 1"][1:] == ["75.0 %", "75.0 %"]
    # 32 and 33 of 36 by video, 22 and 23 by simulation.
    assert rows["Friction, error < 0.1, baseline"][1:] == ["88.9 %", "61.1 %"]
    assert rows["Friction, error < 0.1, given the material"][1:] == ["91.7 %", "63.9 %"]


def test_the_headline_has_its_interval_and_a_single_frame_beside_it(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path, seeds=(0, 1, 2))
    path = tmp_path / "evaluate" / "metrics.json"
    metrics = json.loads(path.read_text())
    for split, share in (("by_simulation", 0.9), ("by_video", 0.5)):
        metrics[split][MIDDLE_FRAME] = entry(36, [0], {"friction_lt_0.1": share})
    path.write_text(json.dumps(metrics))
    write_sidecar(path, provenance_record("evaluate"))
    page = page_of(tmp_path)
    text = text_of(page).split("The result")[1]
    held_out, by_video = text.split("With videos held out")[:2]
    # 23, 25 and 21 of 36: the best network is one, whatever the probe has.
    assert "given the material predicts the correct one of 3" in held_out and "63.9 %" in held_out
    assert "whole simulations held out (90 % interval over simulations and seeds: " in held_out
    low, high = re.search(r"seeds: ([\d.]+) % to ([\d.]+) %", held_out).groups()
    assert float(low) < 63.9 < float(high)
    assert "single frame from the middle of the video is correct for 90.0 %" in held_out
    assert "for 91.7 % of 36" in by_video and "video is correct for 50.0 %" in by_video
    rows = table(page, "All test sets")
    assert ["linear: one frame from the middle", "36"] in [row[:2] for row in rows]


def test_the_headline_is_of_one_network_in_both_splits(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    path = tmp_path / "evaluate" / "metrics.json"
    metrics = json.loads(path.read_text())
    metrics["by_video"]["lrcn_baseline"]["friction_lt_0.1"] = 0.999
    path.write_text(json.dumps(metrics))
    write_sidecar(path, provenance_record("evaluate"))
    text = text_of(page_of(tmp_path)).split("The result")[1]
    assert "99.9 %" not in text.split("Is the simulator")[0]
    assert "for 91.7 % of 36" in text.split("With videos held out")[1]


def test_one_seed_is_said_to_be_one_beside_the_number_of_videos(page):
    assert table(page, "Table 2")[0][2:] == [
        f"ours, by {split} 36 videos of 6 simulations one seed only"
        for split in ("video", "simulation")
    ]
    assert "±" not in " ".join(map(" ".join, table(page, "Table 2")))


def test_several_seeds_have_their_spread(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path, {"by_simulation": 22}, seeds=(0, 1, 2))
    page = page_of(tmp_path)
    rows = {row[0]: row[1:] for row in table(page, "Table 2")}
    assert rows["share of test videos"][1].endswith("36 videos of 6 simulations 3 seeds")
    # 22, 24 and 20 of 36: a standard deviation of 2 / 36.
    assert rows["Friction, error < 0.1, baseline"][1:] == ["61.1 ± 5.6 %"]
    assert "61.1 ± 5.6 %" in table(page, "All test sets")[1]


def test_an_unseen_texture_stands_beside_the_papers_and_beside_seen_ones(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    path = tmp_path / "evaluate" / "details.json"
    details = json.loads(path.read_text())
    for network, share in (("friction_baseline", 0.5), ("friction_conditional", 0.25)):
        seen = details["unseen_texture"][network]["viewpoints"]["calibrated"]
        seen["mean"]["friction_lt_0.1"] = share
    path.write_text(json.dumps(details))
    page = page_of(tmp_path)
    rows = {row[0]: row[1:] for row in table(page, "Sec. 6.2.1")}
    # The paper's are of one view, so those from the calibrated view come first.
    assert rows["share of test videos"] == [
        "paper 160 videos",
        "ours, unseen texture, calibrated view 12 videos of 5 simulations one seed only",
        "ours, unseen texture, all views 36 videos of 6 simulations one seed only",
        "ours, trained textures, all views 36 videos of 6 simulations one seed only",
    ]
    assert rows["Friction, error < 0.1, given the material"] == [
        "87.2 %", "25.0 %", "83.3 %", "91.7 %"
    ]  # fmt: skip
    assert rows["Friction, error < 0.2, given the material"][0] == "95.0 %"
    assert rows["Friction, error < 0.1, baseline"] == ["not printed", "50.0 %", "80.6 %", "88.9 %"]


TURNED = {"view_-15": 6, "view_-10": 11, "view_+5": 30, "view_+15": 9}


def test_every_turn_of_the_camera_has_its_own_scores(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path, {"by_video": 32, **TURNED}, (0, 1, 2))
    rows = {row[0]: row for row in table(page_of(tmp_path), "Table 3")}
    head = ["rotation", "videos", "sim.", "paper", "material network", "baseline network"]
    assert list(rows["rotation"])[:6] == head
    shown = {turn: row for turn, row in rows.items() if turn.endswith("°")}
    assert list(shown) == ["−15°", "−10°", "0°", "+5°", "+15°"]
    assert [row[6] if turn != "0°" else row[5] for turn, row in shown.items()] == [
        f"{share} ± 5.6 %" for share in ("16.7", "30.6", "88.9", "83.3", "25.0")
    ]
    # The network given the material: one video more.
    assert rows["−10°"][8] == "33.3 ± 5.6 %"
    assert [row[3:5] for turn, row in shown.items() if turn != "0°"] == [
        ["65.0 %", "70.0 %"], ["75.0 %", "85.0 %"], ["75.0 %", "80.0 %"], ["50.0 %", "65.0 %"]
    ]  # fmt: skip
    assert shown["0°"][3] == "not printed"
    assert (rows["0°"][1:3], rows["+5°"][1:3]) == (["12", "5"], ["36", "6"])


def test_the_picture_of_the_turns_has_the_scores_at_their_turns(tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(learning_pictures, "accuracy_by_turn", lambda curves: drawn.update(curves))
    synthetic_results.write_evaluate(CONFIG, tmp_path, {"by_video": 32, **TURNED})
    page_of(tmp_path)
    means = {turn: one.mean for turn, one in drawn["friction_baseline", "friction_lt_0.1"].items()}
    assert means == pytest.approx({-15: 6 / 36, -10: 11 / 36, 0: 32 / 36, 5: 30 / 36, 15: 9 / 36})


def test_captures_stand_beside_the_simulated_test_set(whole, tmp_path):
    shutil.copytree(whole / "sample", tmp_path / "sample")
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    synthetic_results.write_captures(tmp_path, seeds=(0, 1))
    page = page_of(tmp_path)
    rows = {row[0]: row[1:] for row in table(page, "Fig. 6")}
    # The paper counts pairs, so its figures stand beside medians, not beside single films.
    assert rows["tested on"][7:] == ["medians < 0.1", "medians within 0.1", "all repeats equal"]
    assert rows["paper, real videos: all"][2:] == ["not printed", "61.9 %", "76.2 %"]
    assert rows["paper, real videos: matte"][3] == "86.1 %"
    assert rows["paper, real videos: all, reflective training"][3] == "93.6 %"
    group = "network given the material, videos held out (the paper’s split)"
    assert [key for key in rows if key.startswith(group)] == [
        f"{group} , trained on matte floors only; 2 seeds"
    ]
    assert rows["simulated test set"][:3] == ["36", "–", "91.7 %"]
    assert rows["captures without reflective"][:3] == ["5", "1", "100.0 ± 0.0 %"]
    # Of the mirror's five films two and three are within half a step, four and three within 0.1.
    assert rows["captures, reflective only"][2] == "50.0 ± 14.1 %"
    assert rows["captures, reflective only"][4] == "70.0 ± 14.1 %"
    assert rows["captures, reflective only"][8] == "100.0 ± 0.0 %"  # the pair's median is 0.6
    assert rows["captures, reflective only"][9] == "0.0 ± 0.0 %"  # of the pairs, all five equal
    assert rows["all captures"][9] == "50.0 ± 0.0 %"
    assert "Surrogate captures: simulated videos" in text_of(page)
    assert "No real videos come with the project" in text_of(page)


def test_real_captures_are_called_real(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    synthetic_results.write_captures(tmp_path, surrogate=False)
    text = text_of(page_of(tmp_path))
    assert "Real captures: videos of a bench" in text
    assert "Surrogate captures" not in text and "No real video" not in text


def test_the_papers_last_curve_is_of_the_second_training_set(whole, tmp_path, monkeypatch):
    shutil.copytree(whole / "sample", tmp_path / "sample")
    rows = pq.read_table(whole / "sample" / "manifest.parquet").to_pylist()
    mirrored = {"floor": "glass", "floor_reflectance": 0.04, "floor_role": "test"}
    again = [
        {**row, **mirrored, "viewpoint_id": f"v0{int(row['viewpoint_id'][1:]) + 2}"} for row in rows
    ]
    write_manifest(rows + again, tmp_path / "sample", {})
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    # Of the mirror's five films seed 0 has four within 0.1, seed 1 three.
    trained_on = {0: "by_video", 1: "by_video_reflective"}
    synthetic_results.write_captures(tmp_path, seeds=(0, 1), trained_on=trained_on)
    path = tmp_path / "captures" / "predictions.parquet"
    captured = pq.read_table(path).to_pylist()
    for row in captured[15:]:  # seed 1 on the mirror: 0.26 off the reference in the median
        row["friction"] += 0.3
    pq.write_table(pa.Table.from_pylist(captured), path)
    panels = []
    draw = learning_pictures.cumulative_captures
    monkeypatch.setattr(
        learning_pictures,
        "cumulative_captures",
        lambda drawn, shares: panels.extend(drawn) or draw(drawn, shares),
    )
    page = page_of(tmp_path)
    rows = table(page, "Fig. 6")
    within = [row[5] for row in rows if row[0].startswith("all captures")]
    assert within == ["90.0 %", "80.0 %", "80.0 %"]  # the last row again, as the model's own
    heads = [row[0] for row in rows if row[0].startswith("network given the material")]
    assert "trained on matte floors only" in heads[0]
    assert "trained with reflective floors: 22 of 44 films (glass 22)" in heads[1]
    assert "is not on this page" not in text_of(page)
    curves = panels[0]["curves"]
    assert sorted(curves["all captures"].round(2)) == [0.0, 0.0]  # a pair each, not a video
    assert sorted(curves["all captures, reflective training"].round(2)) == [0.0, 0.26]


def test_captures_scored_with_other_networks_are_said_to_be(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    synthetic_results.write_captures(tmp_path)
    weights = tmp_path / "model.safetensors"
    said = []
    for folder, content in (("captures", "old"), ("evaluate", "new"), ("captures", "new")):
        weights.write_text(content)
        record = provenance_record("evaluate", inputs=[weights])
        write_sidecar(tmp_path / folder / "metrics.json", record)
        said.append("Different networks." in text_of(page_of(tmp_path)))
    assert said == [True, True, False]
    for folder in ("captures", "evaluate"):
        (tmp_path / folder / "metrics.json.provenance.json").write_text("{}")
    assert "Different networks." not in text_of(page_of(tmp_path))


def test_floors_of_the_training_simulations_are_counted():
    def row(simulation, floor, reflectance, side="train", view="train"):
        roles = dict.fromkeys((f"{kind}_role" for kind in ROLES), "train")
        return {"simulation": simulation, "viewpoint_id": "v00", "floor": floor,
                "floor_reflectance": reflectance, "split_by_video": side, **roles,
                "viewpoint_role": view}  # fmt: skip

    rows = [row("a", "matte", 0.0), row("a", "matte", 0.0), row("b", "ceramic", 0.04)]
    rows += [row("c", "ceramic", 0.05), row("d", "rough-glass", 0.04, side="test")]
    rows += [row("e", "rough-glass", 0.04, view="test")]
    floors = training_floors(rows, "by_video")
    assert floors == {"ceramic": (2, True), "matte": (1, False)}
    assert floors_in_words(floors) == ("trained with reflective floors: 2 of 3 films (ceramic 2)")
    assert floors_in_words({"matte": (1, False)}) == "trained on matte floors only"


def test_what_was_not_tested_has_no_heading_and_is_named(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path, {"by_video": 32, "by_simulation": 22})
    page = page_of(tmp_path)
    for heading in ("Sec. 6.2.1", "Table 3", "Fig. 6"):
        assert f"<h3>{heading}" not in page
    assert (
        "not tested in this run, because there are no such videos: an unseen texture (Sec. 6.2.1; "
        "render.test_textures); rotated viewpoints (Table 3; render.test_viewpoints); captures"
    ) in text_of(page)


def test_a_coarse_grid_is_said_to_make_both_error_columns_the_same(page):
    assert "no wrong class is that close" in text_of(page)


def test_a_convergence_study_is_shown_with_what_is_not_converged(whole, tmp_path):
    """The published one stands in where the folder has none of its own."""
    distance = {"finest": "m09_f0300_n41_h1", "mean_m": 5e-4, "mean_largest_m": 2.5e-3,
                "worst_m": 0.03, "shifted_mean_m": 4e-4, "event_shift_s": 0.3,
                "events_missing": ["flip"], "verdict": "not converged"}  # fmt: skip
    curve = {"time_s": [0, 1], "mean_m": [0, 1e-3], "shifted_mean_m": [0, 1e-4]}
    study = {
        "settings": {
            "convergence": {"window_s": 38, "mean_distance_m": 1e-3, "vertices_per_side": [41, 61]},
            "time_step_s": 0.02,
            "simulation": {
                **SimulationSettings().model_dump(mode="json"),
                "bending_stiffness_at": "start",
            },
        },
        "summary": [{"material": "royal-target", "friction": 0.5, "time_step": distance,
                     "mesh": None, "verdict": "not converged"}],
        "comparisons": [{"material": "royal-target", "friction": 0.5, "kind": "time step",
                         "curve": curve}],
        "missing": ["m09_f0300_n61_h0"],
    }  # fmt: skip
    folder = tmp_path / "results"
    shutil.copytree(whole, folder)
    (folder / "published" / "convergence").mkdir(parents=True)
    (folder / "published" / "convergence" / "convergence.json").write_text(json.dumps(study))
    text = text_of(render_page(page_context(Results(folder, CONFIG), NOW)))
    assert (
        "royal-target 0.5 time step over 2 0.5 mm 2.5 mm 30 mm 0.4 mm 0.3 s; flip in one only"
        in text
    )
    assert "1 comparison with time step over 2: 1 not converged." in text
    assert "Not run, so not compared: m09_f0300_n61_h0" in text
    assert "made with other settings (time_step_s, bending_stiffness_at)" in text


def test_checks_show_measured_theory_and_demand(page):
    text = text_of(page)
    assert "All 25 checks, 25 met" in text
    assert f"Verified settings: time_step_s = {SimulationSettings().time_step_s}" in text


def test_an_empty_folder_gives_a_page_that_says_so_for_every_stage(tmp_path):
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert text.count("Not run.") == 12
    assert "None of the 12 simulations is finished" in text
    assert "0 of 12" in text


@pytest.mark.parametrize(
    ("write", "there", "absent"),
    [
        (synthetic_results.write_calibrate, "All 25 checks, 25 met", "None of the 12"),
        (synthetic_results.write_simulate, "125 s of motion each", "No contact sheet"),
        (synthetic_results.write_render_and_sample, "72 videos", "None of the 12"),
        (synthetic_results.write_evaluate, "All test sets", "No network has been trained"),
    ],
)
def test_what_is_there_is_shown_and_what_is_not_is_said(write, there, absent, tmp_path):
    write(CONFIG, tmp_path)
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert re.search(there, text)
    assert absent in text


def test_curves_of_an_earlier_configuration_are_not_shown(tmp_path):
    synthetic_results.write_train(tmp_path)
    shutil.copytree(tmp_path / "train/by_video", tmp_path / "train/by_video_reflective")
    seed = tmp_path / "train/by_video/friction_baseline/seed"
    shutil.copytree(f"{seed}0", f"{seed}7")
    shutil.copytree(f"{seed}0", tmp_path / "instrument/by_video/seed7")
    found = Results(tmp_path, CONFIG).histories()
    networks = ("material_baseline", "friction_baseline", "friction_conditional")
    assert [(one.split, one.network, one.seed) for one in found] == [
        (split, network, 0) for split in ("by_video", "by_simulation") for network in networks
    ]


def test_missing_simulations_are_named(tmp_path):
    synthetic_results.write_simulate(CONFIG, tmp_path)
    (tmp_path / "simulate" / "m05_f0300_r00.parquet").unlink()
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert "1 not run: m05_f0300_r00" in text


def test_costs_add_up_over_jobs(whole):
    costs = {one.stage: one for one in Results(whole, CONFIG).benchmarks()}
    assert list(costs) == ["calibrate", "simulate", "render", "sample", "train", "evaluate"]
    assert costs["simulate"].jobs == 12
    assert costs["simulate"].wall_s == pytest.approx(12 * 29.0)
    assert costs["simulate"].cpu_s == pytest.approx(12 * 28.5)  # the logs', not the samples' 27.5
    assert costs["simulate"].memory_mib == 490.0


def test_a_benchmark_without_cpu_time_is_shown_as_a_dash(tmp_path):
    folder = tmp_path / "benchmarks" / "sample"
    folder.mkdir(parents=True)
    (folder / "sample.tsv").write_text("s\tmax_rss\tcpu_time\n0.4\t-\tNA\n")
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert "sample 1 – 0.4 s – 0.4 s –" in text


def test_centre_line_runs_from_the_clamps_to_the_lower_edge(whole):
    results = Results(whole, CONFIG)
    trajectory = next(results.trajectories(results.simulated()[:1]))
    assert trajectory.centre_m.shape == (300, 11, 2)
    assert trajectory.centre_m[:, 0, 1] == pytest.approx(trajectory.stage_z_m, abs=0.02)
    assert trajectory.centre_m[-1, -1, 1] < 0.02
    assert np.abs(trajectory.centre_m[:, 0, 0]).max() < 0.02


def test_the_interval_of_the_share_counts_by_the_step_of_the_scores():
    predictions = [
        {"split": "s", "network": "n", "seed": 0, "simulation": f"{k}",
         "true_value": 0.2, "predicted_value": 0.2 + 0.02 * k}
        for k in range(4)
    ]  # fmt: skip
    # All of four simulations right says little of the next.
    assert share_interval(predictions, "s", "n", 0.2) == pytest.approx((0.05**0.25, 1.0))
    assert share_interval(predictions, "s", "n", 0.1)[0] < 1.0


def test_confusion_counts_have_true_rows_and_predicted_columns():
    predictions = [
        {"split": "s", "network": "n", "true_value": 0.1, "predicted_value": 0.3},
        {"split": "s", "network": "n", "true_value": 0.1, "predicted_value": 0.1},
        {"split": "other", "network": "n", "true_value": 0.1, "predicted_value": 0.1},
    ]
    assert confusion_counts(predictions, "s", "n", [0.1, 0.3]).tolist() == [[1, 1], [0, 0]]


def test_predictions_of_another_grid_are_refused_in_one_line(tmp_path, capsys):
    other = synthetic_results.config(
        grid={"materials": ["gray-interlock"], "frictions": [0.0, 0.3, 1.0], "replicates": 2}
    )
    synthetic_results.write_evaluate(other, tmp_path / "results")
    (tmp_path / "config.json").write_text(CONFIG.model_dump_json())
    words = ["report", "--config", str(tmp_path / "config.json")]
    words += ["--results", str(tmp_path / "results"), "--out", str(tmp_path / "index.html")]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "predictions.parquet: friction_baseline by_video has friction 0, not one of" in said
    assert "grid's: 0.1, 0.3, 1; evaluate again" in said
    assert not (tmp_path / "index.html").exists()


def test_cumulative_error_is_the_share_within_each_error():
    errors, shares = cumulative_error(np.array([0.0, 0.2, 0.0, 0.7]))
    assert errors == pytest.approx([0.0, 0.2, 0.7])
    assert shares == pytest.approx([0.5, 0.75, 1.0])


def test_some_of_many_keep_the_ends():
    assert evenly(range(16), 6) == [0, 3, 6, 9, 12, 15]
    assert evenly([1, 2], 6) == [1, 2]


def test_words_for_numbers():
    assert [duration(value) for value in (3.21, 600, 7300, float("nan"))] == [
        "3.2 s",
        "10.0 min",
        "2.0 h",
        "–",
    ]
    assert closest_frictions([0.1, 0.6, 0.9]) == pytest.approx(0.3)
    assert closest_frictions([0.5]) is None
    assert scale_in_words(CONFIG).startswith(
        "2 fabrics × 3 friction coefficients × 2 replicates = 12 simulations; "
    )


def test_equal_input_gives_an_equal_page(whole, page):
    assert render_page(page_context(Results(whole, CONFIG), NOW)) == page


def test_the_time_can_be_set_from_outside_and_the_page_has_its_record(monkeypatch, tmp_path):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    write_report(CONFIG, tmp_path, tmp_path / "index.html")
    assert "14 November 2023" in (tmp_path / "index.html").read_text()
    assert (tmp_path / "index.html.provenance.json").exists()


def test_a_time_that_is_none_is_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(BadInput, match="SOURCE_DATE_EPOCH=yesterday: must be a number of seconds"):
        write_report(CONFIG, tmp_path, tmp_path / "index.html")


def test_the_record_names_everything_that_the_page_shows(monkeypatch, whole, tmp_path):
    folder = tmp_path / "results"
    shutil.copytree(whole, folder)
    synthetic_results.write_captures(folder)
    simulated = [one.id for one in simulations(CONFIG)]
    (folder / "render" / "preview" / f"{simulated[0]}.mp4").write_bytes(b"film")
    monkeypatch.chdir(tmp_path)
    write_report(CONFIG, "results", "index.html")
    inputs = read_sidecar("index.html")["inputs"]
    ends = f"{simulated[0]}.png", f"{simulated[-2]}.png"  # contact sheets of the first replicate
    assert {
        "results/calibrate/calibration.json",
        *(f"results/simulate/{name}.parquet" for name in simulated),
        f"results/render/preview/{simulated[0]}.mp4",
        *(f"results/render/preview/{name}" for name in ends),
        "results/sample/manifest.parquet",
        f"results/sample/{simulated[0]}.parquet",
        "results/train/by_video/friction_baseline/seed0/history.csv",
        *(f"results/evaluate/{name}" for name in ("metrics.json", "details.json")),
        *(f"results/{stage}/predictions.parquet" for stage in ("evaluate", "captures")),
        "results/captures/metrics.json",
        "results/criticise/paper_on_paper/verdict.json",
        "results/criticise/paper_on_paper/picture.svg",
        "results/audit/audit.json",
    } <= set(inputs)
    assert all(file_digest(path) == digest for path, digest in inputs.items())
    # What was kept of the runs themselves is no result.
    assert not [path for path in inputs if re.match("results/(benchmarks|logs|status)/", path)]


def test_pictures_are_of_their_time_also_where_more_phases_are_kept(monkeypatch, tmp_path):
    config = synthetic_results.config(
        grid={"materials": ["gray-interlock", "royal-target"], "frictions": [0.1, 0.3],
              "replicates": 2},
        simulation={"frames": 80},
        render={"pixels": 32, "viewpoints": ["calibrated"], "textures": ["stripes"]},
        sample={"frames": 10, "phases": 2},
    )  # fmt: skip
    synthetic_results.write_render_and_sample(config, tmp_path)
    asked = []
    images = Results.images
    monkeypatch.setattr(
        Results,
        "images",
        lambda self, row, positions: asked.append(positions) or images(self, row, positions),
    )
    dataset(Results(tmp_path, config))
    file = tmp_path / "sample" / f"{simulations(config)[0].id}.parquet"
    time_s = pq.read_table(file, columns=["time_s"])["time_s"].to_pylist()
    interval_s = time_s[1]  # of the frames that are kept
    for positions in asked:
        if len(positions) == 1:
            assert time_s[positions[0]] == pytest.approx(22.5, abs=interval_s / 2)
        else:
            assert (positions[0], positions[-1]) == (0, 19)
    assert {len(positions) for positions in asked} == {1, 10}


def test_the_largest_residual_is_that_of_all_simulations_drawn_or_not(tmp_path):
    grid = {"materials": ["gray-interlock"], "frictions": [0.1 * k for k in range(1, 9)]}
    config = synthetic_results.config(grid=grid | {"replicates": 1})
    synthetic_results.write_simulate(config, tmp_path, residuals={"m05_f0300_r00": 4.7e-4})
    section = simulation_section(Results(tmp_path, config))
    assert 0.3 not in section["frictions"] and section["residual"] == 4.7e-4
    assert section["tolerance"] == config.simulation.friction_tolerance


@pytest.mark.parametrize(
    ("place", "content"),
    [
        ("evaluate/metrics.json", "{"),
        ("simulate/m05_f0100_r00.parquet", "no parquet"),
        ("sample/manifest.parquet", "no parquet"),
        ("calibrate/calibration.json", "\x00"),
    ],
)
def test_a_damaged_file_is_named_and_no_page_is_left(place, content, tmp_path):
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(BadInput, match=path.name):
        write_report(CONFIG, tmp_path, tmp_path / "index.html")
    assert not (tmp_path / "index.html").exists()


def test_the_verb_says_what_was_not_run(tmp_path, capsys):
    config = tmp_path / "config.json"
    config.write_text(CONFIG.model_dump_json())
    (tmp_path / "results").mkdir()
    words = ["report", "--config", str(config), "--results", str(tmp_path / "results")]
    assert main([*words, "--out", str(tmp_path / "index.html")]) == 0
    shown = capsys.readouterr().out
    assert "not run: calibrate, simulate, render, sample, train, evaluate" in shown
    assert main([*words[:-1], str(tmp_path / "nowhere"), "--out", str(tmp_path / "x.html")]) == 2
    assert "nowhere: no such folder" in capsys.readouterr().err
