"""The report on a made-up results folder, whole, partial, empty and damaged."""

import base64
import io
import json
import re
import shutil
from datetime import UTC, datetime

import numpy as np
import pytest
import synthetic_results
from PIL import Image

from slipstitch.command import main
from slipstitch.errors import BadInput
from slipstitch.evaluate.cumulative import cumulative_error
from slipstitch.evaluate.wording import percent
from slipstitch.report.learning_pictures import confusion_counts
from slipstitch.report.page import (
    closest_frictions,
    page_context,
    render_page,
    scale_in_words,
    write_report,
)
from slipstitch.report.results import Results
from slipstitch.report.wording import duration, evenly
from slipstitch.simulate.settings import SimulationSettings

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


def test_the_result_is_that_of_held_out_simulations_beside_chance(page, whole):
    scores = Results(whole, CONFIG).metrics()["by_simulation"]
    best = max(row["friction_lt_0.1"] for row in scores.values())
    text = text_of(page)
    assert f"for {percent(best)} of 36 test videos from 6 simulations" in text
    assert "whole simulations held out" in text
    assert "A uniform guess is right for 33.3 %" in text


def test_table_2_shows_the_paper_where_known_and_says_where_not(page):
    rows = {
        re.sub(r"<[^>]+>", "", cells[0]): [re.sub(r"<[^>]+>", "", cell) for cell in cells[1:]]
        for cells in (re.findall(r"<td.*?</td>", row) for row in page.split("<tr>"))
        if len(cells) == 4
    }
    assert rows["Material, first guess"][0] == "99.5 %"
    assert rows["Friction, error &lt; 0.1, given the material"][0] == "95.5 %"
    assert rows["Friction, error &lt; 0.2, given the material"][0] == "99.2 %"
    assert rows["Friction, error &lt; 0.1, baseline"][0] == "not available"
    assert rows["Material, first two guesses"][0] == "not available"
    assert rows["Material, first guess"][1:] == ["75.0 %", "75.0 %"]


def test_a_coarse_grid_is_said_to_make_both_error_columns_the_same(page):
    assert "no wrong class is that close" in text_of(page)


def test_a_convergence_study_is_shown_with_what_is_not_converged(whole, tmp_path):
    """The published one stands in where the folder has none of its own."""
    distance = {"finest": "m09_f01_n41_h1", "mean_m": 5e-4, "mean_largest_m": 2.5e-3,
                "worst_m": 0.03, "shifted_mean_m": 4e-4, "event_shift_s": 0.3,
                "events_missing": ["flip"]}  # fmt: skip
    curve = {"time_s": [0, 1], "mean_m": [0, 1e-3], "shifted_mean_m": [0, 1e-4]}
    study = {
        "settings": {
            "convergence": {"window_s": 38, "mean_distance_m": 1e-3, "vertices_per_side": [41, 61]},
            "time_step_s": 0.02,
        },
        "summary": [{"material": "royal-target", "friction": 0.5, "time_step": distance,
                     "mesh": None, "converged": False}],
        "comparisons": [{"material": "royal-target", "friction": 0.5, "kind": "time step",
                         "curve": curve}],
        "missing": ["m09_f01_n61_h0"],
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
    assert "not converged" in text
    assert "Not run, and so not compared: m09_f01_n61_h0" in text


def test_checks_show_measured_theory_and_demand(page):
    text = text_of(page)
    assert "All 25 checks, 25 met" in text
    assert f"Verified settings: time_step_s = {SimulationSettings().time_step_s}" in text


def test_an_empty_folder_gives_a_page_that_says_so_for_every_stage(tmp_path):
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert text.count("Not run.") == 10
    assert "None of the 12 simulations is there" in text
    assert "0 of 12" in text


@pytest.mark.parametrize(
    ("write", "there", "absent"),
    [
        (synthetic_results.write_calibrate, "All 25 checks, 25 met", "None of the 12"),
        (synthetic_results.write_simulate, "125 s of motion each", "No contact sheet"),
        (synthetic_results.write_render_and_sample, "72 videos", "None of the 12"),
        (synthetic_results.write_evaluate, "Every test set", "No network has been trained"),
    ],
)
def test_what_is_there_is_shown_and_what_is_not_is_said(write, there, absent, tmp_path):
    write(CONFIG, tmp_path)
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert re.search(there, text)
    assert absent in text


def test_missing_simulations_are_named(tmp_path):
    synthetic_results.write_simulate(CONFIG, tmp_path)
    (tmp_path / "simulate" / "m05_f01_r00.parquet").unlink()
    text = text_of(render_page(page_context(Results(tmp_path, CONFIG), NOW)))
    assert "1 not run: m05_f01_r00" in text


def test_costs_add_up_over_jobs(whole):
    costs = {one.stage: one for one in Results(whole, CONFIG).benchmarks()}
    assert list(costs) == ["calibrate", "simulate", "render", "sample", "train", "evaluate"]
    assert costs["simulate"].jobs == 12
    assert costs["simulate"].wall_s == pytest.approx(12 * 29.0)
    assert costs["simulate"].cpu_s == pytest.approx(12 * 27.5)
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


def test_confusion_counts_have_true_rows_and_predicted_columns():
    predictions = [
        {"split": "s", "network": "n", "true_value": 0.1, "predicted_value": 0.3},
        {"split": "s", "network": "n", "true_value": 0.1, "predicted_value": 0.1},
        {"split": "other", "network": "n", "true_value": 0.1, "predicted_value": 0.1},
    ]
    assert confusion_counts(predictions, "s", "n", [0.1, 0.3]).tolist() == [[1, 1], [0, 0]]


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


@pytest.mark.parametrize(
    ("place", "content"),
    [
        ("evaluate/metrics.json", "{"),
        ("simulate/m05_f00_r00.parquet", "no parquet"),
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
