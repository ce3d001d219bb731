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
from support import headless_browser, synthetic_results
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.page.templates import render
from slipstitch.base.provenance import (
    file_digest,
    provenance_record,
    read_sidecar,
    write_json,
    write_sidecar,
)
from slipstitch.config import write_config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import simulations
from slipstitch.film.captures_scores import capture_errors
from slipstitch.learning.evaluation.metrics import entry
from slipstitch.learning.evaluation.paper import cumulative_error
from slipstitch.learning.evaluation.test_sets import MIDDLE_FRAME
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.report.cost import benchmarks
from slipstitch.report.dataset import dataset
from slipstitch.report.headline import headline, share_interval
from slipstitch.report.page import TEMPLATE, page_context, write_report
from slipstitch.report.physics import simulation_section
from slipstitch.report.results import Results
from slipstitch.report.scores import Scores, model_title

CONFIG = synthetic_results.config()
NOW = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)
MOST_WORDS, MOST_WORDS_OF_A_SECTION = 2000, 150
SECTIONS = ["limits", "physics", "dataset", "training", "criticism", "release", "cost"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    synthetic_results.write_all(CONFIG, folder)
    return folder


def page_of(folder, config=CONFIG):
    return render(TEMPLATE, **page_context(Results(folder, config), NOW))


@pytest.fixture(scope="module")
def page(whole):
    return page_of(whole)


def text_of(page):
    """What a reader reads: no style, no tags, single spaces."""
    body = re.sub(r"<(style|title)>.*?</\1>", "", page, flags=re.S)
    return html.unescape(" ".join(re.sub(r"<[^>]+>", " ", body).split()))


def table(page, title):
    """Rows of the table that is folded away under a title, as lists of what the cells say."""
    after = page[page.index(f"<summary>{title}") :]
    rows = re.findall(r"<tr.*?</tr>", after[: after.index("</table>")], flags=re.S)
    return [
        [text_of(cell) for cell in re.findall(r"<t[dh].*?</t[dh]>", row, flags=re.S)]
        for row in rows
    ]


def edit(folder, name, change, stage="evaluate"):
    """Change the content of a JSON file of a stage, and renew its record."""
    path = folder / stage.partition(".")[0] / name
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    write_sidecar(path, provenance_record(stage))


def evaluated(folder, *of, change=lambda details: None):
    """The page of an evaluation whose details were changed."""
    synthetic_results.write_evaluate(CONFIG, folder, *of)
    edit(folder, "details.json", change)
    return page_of(folder)


def rows_of(page, title):
    """What the cells of such a table say, by the first of their row."""
    return {row[0]: row[1:] for row in table(page, title)}


def test_the_page_needs_no_other_file_and_every_picture_has_a_text(page):
    assert not re.findall(r"https?://", re.sub(r'(?:src|href)="data:[^"]*"', "", page))
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "<script" not in page and "@import" not in page
    images = re.findall(r'<img src="data:image/([a-z+]+);base64,([^"]+)" alt="[^"]+"', page)
    assert len(images) == page.count("<img") > 20
    for kind, content in images:
        raw = base64.b64decode(content)
        whole = b"<svg" in raw and b"</svg>" in raw
        assert whole if kind == "svg+xml" else Image.open(io.BytesIO(raw)).size[0] > 8


def test_the_result_stands_first_and_the_page_is_short(page):
    assert len(text_of(page).split()) <= MOST_WORDS
    header, main_part = page.split("<main>")
    order = ["<h1>", 'class="sequence"', "Predicted against true", "What the simulation gets wrong"]
    assert sorted(order, key=header.index) == order
    sections = re.findall(r'<section id="(\w+)">(.*?)</section>', main_part, flags=re.S)
    assert [name for name, _ in sections] == SECTIONS
    for name, content in sections:
        unfolded = re.sub(r"<details>.*?</details>", "", content, flags=re.S)
        assert len(text_of(unfolded).split()) <= MOST_WORDS_OF_A_SECTION, name
        assert name == "limits" or "<img" in unfolded


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_shows_the_page_without_a_flaw(page, tmp_path, width):
    found = headless_browser.look(page, tmp_path, width)
    assert found == {"wider": [], "broken": [], "faint": [], "errors": []}


def test_criticism_and_audit_are_shown_and_damage_is_not_hidden(page, tmp_path):
    text = text_of(page)
    assert "Not run." not in text and "No network" not in text  # everything is there
    assert "the model is wrong and no known mechanism explains how" in text.split("Limits")[0]
    assert "clearest trace is a step in the place on the substrate" in text
    assert "Audit: intact ." in text and "5e" * 32 in text
    for case in CONFIG.criticise.cases:
        assert f"results/criticise/{case.rpartition('/')[2]}/index.html" in text
    synthetic_results.write_audit(tmp_path, "damaged")
    shown = text_of(page_of(tmp_path))
    assert "Audit: damaged (altered: 1)." in shown
    assert "No measured case was analysed." in shown


@pytest.mark.slow
def test_the_headline_is_the_error_of_the_best_network_beside_the_best_probe(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path, seeds=(0, 1, 2))

    def add_probes(metrics):
        for split, share, error in (("by_simulation", 0.9, 0.01), ("by_video", 0.5, 0.4)):
            scores = {"friction_lt_0.1": share, "mean_absolute_error": error}
            metrics[split][MIDDLE_FRAME] = entry(36, [0], scores)

    edit(tmp_path, "metrics.json", add_probes)
    page = page_of(tmp_path)
    own = Results(tmp_path, CONFIG).json("evaluate", "metrics.json")["by_simulation"]
    best = min(row["mean_absolute_error"] for name, row in own.items() if "lrcn" in name)
    assert (
        "the conditional network predicts the friction coefficient µ with a mean error of "
        f"{best:.3f} on simulations that it never saw; the best probe is better, with 0.010."
    ) in text_of(page)
    # 23, 25 and 21 of 36: the interval is over simulations and seeds.
    shown = re.search(r"63.9 % of 36 .* interval ([\d.]+) % to ([\d.]+) %", text_of(page))
    assert float(shown[1]) < 63.9 < float(shown[2])
    assert "90.0 % for the best probe (linear probe, one frame from the middle)" in text_of(page)
    assert rows_of(page, "All test sets")["linear probe, one frame from the middle"][0] == "36"
    edit(tmp_path, "metrics.json", lambda metrics: metrics.pop("by_simulation"))
    text = text_of(page_of(tmp_path))
    assert "on new videos of simulations that it saw; the best probe has 0.400" in text


def test_the_mark_of_a_prediction_has_its_interval_or_that_of_its_distribution(monkeypatch):
    common = {"split": "by_simulation", "network": "instrument", "seed": 0, "simulation": "m05_a"}
    common |= {"true_value": 0.3, "predicted_value": 0.3}
    rows = [
        common | {"low": 0.25, "high": 0.4, "probabilities": [0.1]},
        common | {"low": None, "high": None, "probabilities": [0.04, 0.9, 0.06]},
    ]
    known = entry(2, [0], {"mean_absolute_error": 0.0, "friction_lt_0.1": 1.0})
    drawn, draw = [], "slipstitch.report.headline.predicted_against_true"
    monkeypatch.setattr(draw, lambda own, _: drawn.extend(own))
    headline(CONFIG, Scores({"by_simulation": {"instrument": known}}, {}), rows)
    assert [(row["low"], row["high"]) for row in drawn] == [(0.25, 0.4), (0.3, 1.0)]


def test_table_2_shows_every_figure_of_the_paper_beside_ours(page):
    rows = rows_of(page, "Table 2")
    size = "36 videos, 6 simulations, one seed only"
    calibrated = "12 videos, 6 simulations, one seed only"
    assert rows["share of test videos"] == [
        "paper (384 videos)", f"ours by video ({size})", f"its calibrated view ({calibrated})",
        f"ours by simulation ({size})",
    ]  # fmt: skip
    # 32 and 33 of 36 by video, 22 and 23 by simulation.
    for row, shares in {
        "fabric network: top 1": ["99.5 %", "75.0 %", "75.0 %", "75.0 %"],
        "fabric network: top 2": ["100.0 %"],
        "baseline network: error < 0.1": ["78.6 %", "88.9 %", "91.7 %", "61.1 %"],
        "baseline network: error < 0.2": ["88.5 %"],
        "conditional network: error < 0.1": ["95.5 %", "91.7 %", "91.7 %", "63.9 %"],
        "conditional network: error < 0.2": ["99.2 %"],
    }.items():
        assert rows[row][: len(shares)] == shares
    assert "and so does “< 0.2”" in text_of(page)  # the grid is that coarse


def test_an_unseen_texture_stands_beside_the_papers_and_beside_seen_ones(tmp_path):
    def other(details):
        for network, share in (("friction_baseline", 0.5), ("friction_conditional", 0.25)):
            seen = details["unseen_texture"][network]["viewpoints"]["calibrated"]
            seen["mean"]["friction_lt_0.1"] = share

    rows = rows_of(evaluated(tmp_path, change=other), "Section 6.2.1")
    # The paper's are of one view, so those from the calibrated view come first.
    heads = ["paper", "ours, calibrated view", "ours, all views", "ours, trained textures"]
    assert [head.partition(" (")[0] for head in rows["share of test videos"]] == heads
    shares = ["87.2 %", "25.0 %", "83.3 %", "91.7 %"]
    assert rows["conditional network: error < 0.1"] == shares
    assert rows["conditional network: error < 0.2"][0] == "95.0 %"
    assert rows["baseline network: error < 0.1"] == ["not printed", "50.0 %", "80.6 %", "88.9 %"]


def test_of_the_calibrated_view_and_of_turned_ones_the_fine_tuned_networks_are_shown(tmp_path):
    """Where those before fine-tuning are kept, whose scores are those of all views."""

    def add(details):
        for networks in details.values():
            one = json.loads(json.dumps(networks["friction_conditional"]))
            for scores in (one, one["viewpoints"]["calibrated"]):
                scores["mean"]["friction_lt_0.1"] = 0.25
            networks["friction_conditional_calibrated"] = one

    page = evaluated(tmp_path, {"by_video": 32, "view_+5": 30}, change=add)
    shares = rows_of(page, "Table 2")["conditional network: error < 0.1"]
    assert shares == ["95.5 %", "91.7 %", "25.0 %"]
    head, *rows = table(page, "Table 3")
    assert [row[head.index("conditional network, < 0.1")] for row in rows] == ["25.0 %"] * 2
    assert model_title("lrcn_conditional_calibrated").startswith("conditional network, fine-tuned")


def test_every_turn_of_the_camera_has_its_own_scores_with_their_spread(tmp_path):
    turned = {"view_-15": 6, "view_-10": 11, "view_+5": 30, "view_+15": 9}
    page = evaluated(tmp_path, {"by_video": 32, **turned}, (0, 1, 2))
    # 32, 34 and 30 of 36: a standard deviation of 2 / 36.
    rows = rows_of(page, "Table 2")
    assert rows["share of test videos"][1].endswith("(36 videos, 6 simulations, 3 seeds)")
    assert rows["baseline network: error < 0.1"][1] == "88.9 ± 5.6 %"
    assert "88.9 ± 5.6" in table(page, "All test sets")[2]
    head, *rows = table(page, "Table 3")
    assert head[:5] == [
        "rotation", "videos", "paper, < 0.1", "paper, < 0.2", "fabric network, fabric, first"
    ]  # fmt: skip
    assert [row[:4] for row in rows] == [
        ["−15°", "36", "65.0 %", "70.0 %"], ["−10°", "36", "75.0 %", "85.0 %"],
        ["0°", "12", "not printed", "not printed"],
        ["+5°", "36", "75.0 %", "80.0 %"], ["+15°", "36", "50.0 %", "65.0 %"],
    ]  # fmt: skip
    # At 0 degrees 11, 12 and 10 of 12.
    shares = ["16.7 ± 5.6 %", "30.6 ± 5.6 %", "91.7 ± 8.3 %", "83.3 ± 5.6 %", "25.0 ± 5.6 %"]
    assert [row[head.index("baseline network, < 0.1")] for row in rows] == shares
    # One video more.
    assert rows[1][head.index("conditional network, < 0.1")] == "33.3 ± 5.6 %"


@pytest.mark.slow
def test_captures_stand_beside_the_papers(tmp_path):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    synthetic_results.write_captures(tmp_path, seeds=(0, 1))
    page = page_of(tmp_path)
    rows = rows_of(page, "Figure 6")
    # The paper counts pairs, so its figures stand beside medians, not beside single films.
    assert rows["tested on"][7:] == ["medians < 0.1", "medians within 0.1", "all repeats equal"]
    for subset, shares in {
        "all": ["61.9 %", "76.2 %"], "matte": ["86.1 %"], "all, reflective training": ["93.6 %"]
    }.items():  # fmt: skip
        assert rows[f"paper, real videos: {subset}"][8 : 8 + len(shares)] == shares
    assert rows["conditional network, by video"] == []
    assert rows["captures without reflective"][:3] == ["5", "1", "100.0 ± 0.0 %"]
    # Of the mirror's five films two and three are within half a step, four and three within 0.1.
    mirror = rows["captures, reflective only"]
    assert (mirror[2], mirror[4]) == ("50.0 ± 14.1 %", "70.0 ± 14.1 %")
    assert mirror[8:] == ["100.0 ± 0.0 %", "0.0 ± 0.0 %"]  # the pair's median; all five equal
    text = text_of(page)
    assert "Surrogate captures: simulated videos" in text
    assert "the captures are surrogates, simulated too" in text
    synthetic_results.write_captures(tmp_path / "real", surrogate=False)
    shutil.copytree(tmp_path / "real/captures", tmp_path / "captures", dirs_exist_ok=True)
    text = text_of(page_of(tmp_path))
    assert "Real captures: videos of a bench" in text and "urrogates" not in text.split("Phys")[0]


def test_the_papers_last_curve_is_of_the_second_training_set(tmp_path, monkeypatch):
    synthetic_results.write_evaluate(CONFIG, tmp_path)
    trained_on = {0: "by_video", 1: "by_video_reflective"}
    synthetic_results.write_captures(tmp_path, seeds=(0, 1), trained_on=trained_on)
    path = tmp_path / "captures" / "predictions.parquet"
    captured = pq.read_table(path).to_pylist()
    for row in captured[15:]:  # seed 1 on the mirror: 0.26 off the reference in the median
        row["friction"] += 0.3
    pq.write_table(pa.Table.from_pylist(captured), path)
    panels, draw = {}, "slipstitch.report.learning_pictures.cumulative"
    monkeypatch.setattr(draw, lambda drawn, _: panels.update(drawn))
    rows = table(page_of(tmp_path), "Figure 6")
    curves = panels["conditional network, by video"]
    assert sorted(curves["all captures"].round(2)) == [0.0, 0.0]  # a pair each, not a video
    assert sorted(curves["all captures, reflective training"].round(2)) == [0.0, 0.26]
    titles = [f"conditional network, by video{more}" for more in ("", ", reflective floors")]
    assert [row[0] for row in rows if len(row) == 1] == titles
    assert capture_errors(captured[10:])["all"].round(2).tolist() == [0.0, 0.26]


@pytest.mark.slow
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


def test_what_was_not_tested_has_no_table_and_is_named(tmp_path):
    page = evaluated(tmp_path, {"by_video": 32, "by_simulation": 22})
    assert "<summary>Section 6.2.1" not in page and "<summary>Table 3" not in page
    assert (
        "Not tested in this run: an unseen texture (Sec. 6.2.1; render.test_textures); rotated "
        "viewpoints (Table 3; render.test_viewpoints); captures"
    ) in text_of(page)


def test_a_convergence_study_is_shown_with_what_is_not_converged(whole, tmp_path):
    """The published one stands in where the folder has none of its own."""
    distance = {
        "finest": "m09_f0300_n41_h1", "mean_m": 5e-4, "mean_largest_m": 2.5e-3, "worst_m": 0.03,
        "shifted_mean_m": 4e-4, "event_shift_s": 0.3, "events_missing": ["flip"],
        "verdict": "not converged",
    }  # fmt: skip
    simulated = {**SimulationSettings().model_dump(mode="json"), "bending_stiffness_at": "start"}
    demand = {"window_s": 38, "mean_distance_m": 1e-3, "vertices_per_side": [41, 61]}
    case = {"material": "royal-target", "friction": 0.5, "time_step": distance}
    study = {
        "settings": {"convergence": demand, "time_step_s": 0.02, "simulation": simulated},
        "summary": [case | {"mesh": distance | {"verdict": "converged"}}],
        "missing": ["m09_f0300_n61_h0"],
    }
    folder = shutil.copytree(whole, tmp_path / "results")
    write_json(folder / "published" / "convergence" / "convergence.json", study)
    page = page_of(folder)
    apart = ["0.5 mm", "2.5 mm", "30 mm", "0.3 s; flip in one only"]
    rows = table(page, "Time step and mesh")[1:]
    assert rows == [["royal-target 0.5", "time step over 2", *apart]]
    text = text_of(page)
    assert "1 comparison with time step over 2: 1 not converged; 1 comparison with 41" in text
    assert "Not run: m09_f0300_n61_h0." in text
    assert "made with other settings (time_step_s, bending_stiffness_at)" in text


def test_the_check_nearest_to_its_limit_is_shown_and_all_that_are_not_met(whole, tmp_path):
    rows = rows_of(page_of(whole), "Checks against theory")
    assert rows["flat drag pull over weight"] == ["3 of 3", "0.1 %", "0.5 %"]
    assert len(rows) == 7
    shutil.copytree(whole / "calibrate", tmp_path / "calibrate")

    def miss_two(calibration):
        pulls = (one for one in calibration["checks"] if one["name"] == "strip-drag pull")
        for check in (next(pulls), next(pulls)):
            check["met"] = False

    edit(tmp_path, "calibration.json", miss_two, "calibrate.calibration")
    page = page_of(tmp_path)
    pulls = [row[1] for row in table(page, "Checks") if row[0] == "strip drag pull"]
    assert pulls == ["3 of 5"] * 2
    assert "23 of 25 checks are met" in text_of(page)


PARTS = [
    (synthetic_results.write_calibrate, "25 of 25 checks are met", "12 of 12 simulations: "),
    (synthetic_results.write_simulate, "125 s of motion each", "not compared with theory"),
    (synthetic_results.write_render_and_sample, "72 videos", "12 of 12 simulations: "),
    (synthetic_results.write_evaluate, "All test sets", "No network was trained"),
]


@pytest.mark.parametrize(("write", "there", "absent"), PARTS)
def test_what_is_there_is_shown_and_what_is_not_is_said(write, there, absent, tmp_path):
    write(CONFIG, tmp_path)
    text = text_of(page_of(tmp_path))
    assert there in text and absent in text


def test_curves_of_an_earlier_configuration_are_not_shown(tmp_path):
    synthetic_results.write_train(tmp_path)
    shutil.copytree(tmp_path / "train/by_video", tmp_path / "train/by_video_reflective")
    seed = tmp_path / "train/by_video/friction_baseline/seed"
    shutil.copytree(f"{seed}0", f"{seed}7")
    shutil.copytree(f"{seed}0", tmp_path / "instrument/by_video/seed7")
    found = Results(tmp_path, CONFIG).histories()
    networks = ("material_baseline", "friction_baseline", "friction_conditional")
    expected = [(split, name, 0) for split in ("by_video", "by_simulation") for name in networks]
    assert [(one.split, one.network, one.seed) for one in found] == expected


@pytest.mark.slow
def test_the_simulations_are_summed_up_and_those_that_lack_are_named(tmp_path):
    grid = {"materials": ["gray-interlock"], "frictions": [0.1 * k for k in range(1, 9)]}
    config = synthetic_results.config(grid=grid | {"replicates": 1})
    synthetic_results.write_simulate(config, tmp_path, residuals={"m05_f0300_r00": 4.7e-4})
    (tmp_path / "simulate" / "m05_f0400_r00.parquet").unlink()
    results = Results(tmp_path, config)
    section = simulation_section(results)
    # Of all simulations, drawn or not: 0.3 is not.
    assert section["residual"] == 4.7e-4
    assert section["tolerance"] == config.simulation.friction_tolerance
    assert "1 of 8 simulations: m05_f0400_r00" in text_of(page_of(tmp_path, config))
    line = next(iter(results.trajectories(results.simulated()[:1])))
    run = read_trajectory(results.simulation_path(line.simulation))
    assert line.centre_m.shape == (300, 11, 2)
    assert line.centre_m[:, 0, 1] == pytest.approx(run.stage_z_m, abs=0.02)
    assert line.centre_m[-1, -1, 1] < 0.02 and np.abs(line.centre_m[:, 0, 0]).max() < 0.02


def test_costs_add_up_over_jobs_and_an_unknown_one_is_a_dash(whole, tmp_path):
    costs = {one.stage: one for one in benchmarks(whole)}
    assert list(costs) == ["calibrate", "simulate", "render", "sample", "train", "evaluate"]
    of = costs["simulate"]
    # The logs' CPU time, not the samples' 27.5.
    assert (of.jobs, of.wall_s, of.cpu_s) == pytest.approx((12, 12 * 29.0, 12 * 28.5))
    assert of.memory_mib == 490.0
    folder = tmp_path / "benchmarks" / "sample"
    folder.mkdir(parents=True)
    (folder / "sample.tsv").write_text("s\tmax_rss\tcpu_time\n0.4\t-\tNA\n")
    row = ["sample", "1", "–", "0.4 s", "–", "0.4 s", "–"]
    assert table(page_of(tmp_path), "Every stage")[1] == row


def test_the_interval_of_the_share_counts_simulations():
    def found(error):
        known = {"seed": 0, "true_value": 0.2}
        return share_interval(
            [known | {"simulation": k, "predicted_value": 0.2 + error * k} for k in range(4)]
        )

    # All of four simulations right says little of the next.
    assert found(0.01) == pytest.approx((0.05**0.25, 1.0))
    assert found(0.02)[1] > 0.75 > found(0.02)[0]  # the last is wrong


def test_pictures_are_of_their_time_also_where_more_phases_are_kept(monkeypatch, tmp_path):
    config = synthetic_results.config(
        grid={"materials": ["gray-interlock", "royal-target"], "frictions": [0.1, 0.3]},
        simulation={"frames": 80},
        render={"pixels": 32, "viewpoints": ["calibrated"], "textures": ["stripes"]},
        sample={"frames": 10, "phases": 2},
    )
    synthetic_results.write_render_and_sample(config, tmp_path)
    asked, images = [], Results.images

    def noted(self, row, positions):
        asked.append(list(positions))
        return images(self, row, positions)

    monkeypatch.setattr(Results, "images", noted)
    dataset(Results(tmp_path, config))
    file = tmp_path / "sample" / f"{simulations(config)[0].id}.parquet"
    time_s = pq.read_table(file, columns=["time_s"])["time_s"].to_pylist()
    single, series = ([one for one in asked if len(one) == count] for count in (1, 10))
    assert single and series and len(single) + len(series) == len(asked)
    shown_s = np.array([time_s[place] for (place,) in single])
    assert shown_s == pytest.approx(22.5, abs=time_s[1] / 2)
    assert {(one[0], one[-1]) for one in series} == {(0, 19)}


def command_of(folder):
    """The command that writes a page of results."""
    write_config(CONFIG, folder / "c.json")
    return f"report --config {folder}/c.json --out {folder}/index.html --results {folder}/results"


def test_predictions_of_another_grid_are_refused_in_one_line(tmp_path, capsys):
    other = {"materials": ["gray-interlock"], "frictions": [0.0, 0.3, 1.0], "replicates": 2}
    synthetic_results.write_evaluate(synthetic_results.config(grid=other), tmp_path / "results")
    said = refused(capsys, command_of(tmp_path))
    assert "predictions.parquet: friction_conditional by_simulation has friction 0, not" in said
    assert "grid's: 0.1, 0.3, 1; evaluate again" in said
    assert not (tmp_path / "index.html").exists()


def test_a_cumulative_error_counts_the_share_of_what_is_no_further_off():
    errors, shares = cumulative_error(np.array([0.0, 0.2, 0.0, 0.7]))
    assert errors == pytest.approx([0.0, 0.2, 0.7]) and shares == pytest.approx([0.5, 0.75, 1.0])


@pytest.mark.slow
def test_equal_input_gives_an_equal_page_whose_time_can_be_set(whole, page, monkeypatch, tmp_path):
    assert page_of(whole) == page
    assert "2 fabrics × 3 friction coefficients × 2 replicates" in text_of(page)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    write_report(CONFIG, tmp_path, tmp_path / "index.html")
    assert "14 November 2023" in (tmp_path / "index.html").read_text()
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(BadInput, match="SOURCE_DATE_EPOCH=yesterday: must be a number of seconds"):
        write_report(CONFIG, tmp_path, tmp_path / "index.html")


def test_the_record_names_everything_that_the_page_shows(monkeypatch, whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "results")
    synthetic_results.write_captures(folder)
    simulated = [one.id for one in simulations(CONFIG)]
    (folder / "render" / "preview" / f"{simulated[0]}.mp4").write_bytes(b"film")
    monkeypatch.chdir(tmp_path)
    write_report(CONFIG, "results", "index.html")
    inputs = read_sidecar("index.html")["inputs"]
    first = simulated[0]
    assert {
        f"results/{name}"
        for name in (
            *("calibrate/calibration.json", "calibrate/calibration.png", "calibrate/strip.png"),
            *(f"simulate/{name}.parquet" for name in simulated),
            *(f"render/preview/{first}.mp4", "sample/manifest.parquet", f"sample/{first}.parquet"),
            "train/by_video/friction_baseline/seed0/history.csv",
            *("evaluate/details.json", "evaluate/predictions.parquet", "captures/metrics.json"),
            *("evaluate/metrics.json", "captures/predictions.parquet", "calibrate/settings.png"),
            *(f"criticise/paper_on_paper/{name}" for name in ("verdict.json", "picture.svg")),
            *("audit/audit.json", "release/previews/through_time.png"),
        )
    } <= set(inputs)
    assert all(file_digest(path) == digest for path, digest in inputs.items())
    # What was kept of the runs themselves is no result.
    assert not [path for path in inputs if re.match("results/(benchmarks|logs|status)/", path)]


@pytest.mark.parametrize("place", ["evaluate/metrics.json", "simulate/m05_f0100_r00.parquet"])
def test_a_damaged_file_is_named_and_no_page_is_left(place, tmp_path):
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text("{")
    with pytest.raises(BadInput, match=path.name):
        write_report(CONFIG, tmp_path, tmp_path / "index.html")
    assert not (tmp_path / "index.html").exists()


def test_the_verb_and_the_page_of_an_empty_folder_say_what_was_not_run(tmp_path, capsys):
    assert "results: no such folder" in refused(capsys, command_of(tmp_path))
    (tmp_path / "results").mkdir()
    assert run(command_of(tmp_path)) == 0
    shown = capsys.readouterr().out
    assert "not run: calibrate, simulate, render, sample, train, evaluate" in shown
    text = text_of((tmp_path / "index.html").read_text())
    assert text.count("Not run.") == 8 and "No network has been evaluated yet." in text
    assert "12 of 12 simulations: " in text and "0 of 12" in text
