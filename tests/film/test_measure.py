"""``slipstitch measure``: one video in, one line and one page out."""

import csv
import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.special import ndtr
from support import analytic_stage as stage
from support.models import untrained_instrument
from support.refusal import refused, run

from slipstitch.cli.measure import ALARM_EXIT_CODE
from slipstitch.config import write_config
from slipstitch.design.stage_path import StagePath
from slipstitch.film.measure.measurements import MeasuredPair, names_of
from slipstitch.film.measure.measuring_bench import _half_width, measuring_bench
from slipstitch.film.measure.pages import measurement_page
from slipstitch.learning.instrument.alarm import Alarm
from slipstitch.learning.instrument.distribution import friction_grid, probabilities_on_grid
from slipstitch.learning.instrument.measuring import ErrorBars, save_instrument
from slipstitch.learning.instrument.network import RECURRENT_UNITS

START_S = 3.1
LENS = stage.LENS
CONFIG, _ = stage.protocol()


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A video, its camera, and an instrument that knows nothing."""
    folder = tmp_path_factory.mktemp("measure")
    seen = stage.Bench(LENS)
    times = np.concatenate([np.arange(0, 6.2, 0.1), np.arange(6.2, 13.2, 0.5)])
    images = (seen.image(time_s - START_S) for time_s in times)
    stage.write_video(folder / "video.mp4", images, times)
    stage.camera_file(LENS, folder / "camera.json")
    write_config(CONFIG, folder / "results" / "config.json")
    write_config(stage.protocol(sampled=4)[0], folder / "other.json")
    (folder / "link.mp4").symlink_to(folder / "video.mp4")
    shutil.copy(folder / "video.mp4", folder / "copy.mp4")
    save_instrument(untrained_instrument(64), folder / "results" / "instrument" / "seed0")
    return folder


def another(bench, path):
    """The video once more, in a file of other bytes: with an empty box at its end."""
    path.write_bytes((bench / "video.mp4").read_bytes() + b"\x00\x00\x00\x08free")
    return path


def command_of(bench, words):
    files = f"{bench}/video.mp4 --camera {bench}/camera.json"
    return f"measure {files} --model {bench}/results/instrument/seed0 --threads 1 {words}"


def measure(bench, folder, words=""):
    """The exit code; a page, a table and numbers are written: x.html, x.csv, x.json."""
    files = f"--out {folder}/x.html --csv {folder}/x.csv --json {folder}/x.json"
    return run(command_of(bench, f"{words} {files}"))


def written(folder):
    """The numbers, the table's rows and the page."""
    rows = list(csv.DictReader((folder / "x.csv").read_text().splitlines()))
    return json.loads((folder / "x.json").read_text()), rows, (folder / "x.html").read_text()


def test_result_numbers_and_page(bench, tmp_path, capsys):
    assert measure(bench, tmp_path) == ALARM_EXIT_CODE == 3
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("friction ")
    assert said[0].endswith(", no error bar: calibrated on 0 simulations; 9 are needed")
    assert "±" not in said[0]
    assert said[1].startswith("most similar fabric ")
    assert said[-1].startswith("ALARM: the instrument is not calibrated")
    told, _, content = written(tmp_path)
    assert told["stage_start_s"] == pytest.approx(START_S, abs=0.01) and told["stage_start_found"]
    assert np.sum(told["moments"]) == pytest.approx(1, abs=1e-3)
    assert len(told["frame_time_s"]) == 6
    assert content.count("data:image/png;base64,") == 6
    assert "These numbers are not reliable" in content
    assert "No error bar: calibrated on 0 simulations; 9 are needed." in content
    assert told["uncertainty"] is None and "±" not in content.split("<h2>")[0]
    assert f"{told['friction_coefficient']:.3f}" in content
    assert measure(bench, tmp_path, "--start-s 3.0") == ALARM_EXIT_CODE
    stated, *_ = written(tmp_path)
    assert stated["stage_start_s"] == 3.0 and not stated["stage_start_found"]


def test_the_page_shows_where_the_instrument_sees_the_cloth(bench):
    model = bench / "points" / "instrument" / "seed0"
    write_config(CONFIG, bench / "points" / "config.json")
    instrument = untrained_instrument(64, points_weight=1.0, through_points=True)
    # Says of every frame: a point 5 cm below the clamps, 9 times.
    place_m = [0.0, 0.0, StagePath().start_height_m - 0.05]
    instrument.networks[0].points_mean_m.copy_(torch.tensor(place_m))
    instrument.networks[0].points_spread_m.fill_(1e-9)
    save_instrument(instrument, model)
    measuring = measuring_bench(bench / "camera.json", model)
    result = measuring.measure(bench / "video.mp4")
    assert result.keypoints_px.shape == (6, 9, 2)
    expected = measuring.schedule.crop(0.0).project(np.array([place_m]))
    np.testing.assert_allclose(result.keypoints_px[0], np.repeat(expected, 9, axis=0), atol=0.2)
    content = measurement_page(result)
    assert "Rings: where the instrument sees nine points" in content
    assert content != measurement_page(replace(result, keypoints_px=None))


def test_the_error_bar_of_a_distribution_at_the_end_of_the_grid_is_not_zero():
    """Half of the middle 68 %, here from 0 to one standard deviation."""
    grid = friction_grid(1.5)
    middles = (grid[1:] + grid[:-1]) / 2
    shares = probabilities_on_grid(ndtr(middles / 0.005)[None])[0]
    assert _half_width(grid, shares) == pytest.approx(0.0025, rel=0.02)
    shares = probabilities_on_grid(ndtr((middles - 0.5) / 0.03)[None])[0]
    assert _half_width(grid, shares) == pytest.approx(0.03, rel=0.02)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("--start-s -1", "--start-s -1: must be at least 0"),
        ("--start-s 9", "the stage is seen to start at 3.1"),
        ("--camera no.json", "no.json: no such file"),
        ("--model nowhere", "nowhere"),
        ("--config nowhere.json", "nowhere.json: cannot be read"),
        ("--config {bench}/other.json", "sample.frames is 4, the instrument"),
        ("--json {bench}/./camera.json", "camera.json: the command reads this file"),
        ("{bench}/link.mp4", "link.mp4: given twice; each video counts once"),
        ("{bench}/copy.mp4", "/video.mp4; each video counts once"),
    ],
)
def test_bad_input_is_one_line(bench, capsys, words, problem):
    before = (bench / "camera.json").read_bytes()
    assert problem in refused(capsys, command_of(bench, words.format(bench=bench)))
    assert (bench / "camera.json").read_bytes() == before


def test_repeats_of_a_pair_are_measured_one_by_one_and_together(bench, tmp_path, capsys):
    damaged = tmp_path / "damaged.mp4"
    damaged.write_text("no video\n" * 40)
    missing = tmp_path / "missing.mp4"
    (tmp_path / "again").mkdir()
    again = another(bench, tmp_path / "again" / "video.mp4")
    # Two cannot be measured.
    assert measure(bench, tmp_path, f"{again} {damaged} {missing}") == 2
    said = capsys.readouterr().out
    # As much of each path as tells the films from one another.
    assert f"\n{bench.name}/video.mp4: friction " in f"\n{said}"
    assert "\nagain/video.mp4: friction " in said
    assert said.count("not measured: ") == 2 and "damaged.mp4: a text file" in said
    assert "missing.mp4" in said
    assert "ALARM in every video: no combined value" in said
    told, rows, content = written(tmp_path)
    assert len(told["videos"]) == 2 and len(told["refused"]) == 2
    assert told["combined"] is None
    bad = [f"{tmp_path.name}/{name}.mp4" for name in ("damaged", "missing")]
    names = [f"{bench.name}/video.mp4", "again/video.mp4", *bad]
    assert [row["video"] for row in rows] == names
    assert rows[2]["friction_coefficient"] == ""
    assert rows[2]["notes"].startswith(f"not measured: {damaged}: a text file")
    assert "No measurement" in content and content.count("data:image/png;base64,") == 10


def test_repeats_have_no_combined_interval_where_the_instrument_has_no_error_bar(
    bench, tmp_path, capsys
):
    instrument = untrained_instrument(64)
    instrument.card["calibration_simulations"] = 4
    width = 2 * RECURRENT_UNITS
    parts = np.zeros((4, 6 * 144)), np.ones(4), np.zeros(width), np.eye(width)
    calm = Alarm(np.zeros(6 * 144), *parts, np.zeros(4), np.ones(4), threshold=1e9)
    bars = ErrorBars(1.0, 1.0, np.inf, calm)
    save_instrument(replace(instrument, error_bars=bars), tmp_path / "model")
    write_config(CONFIG, tmp_path / "config.json")
    again = another(bench, tmp_path / "price$5_$6_.mp4")
    assert measure(bench, tmp_path, f"{again} --model {tmp_path}/model") == 0
    why = "no error bar: calibrated on 4 simulations; 9 are needed"
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("combined (2 of 2 videos): friction 0.") and why in last
    assert "interval" not in last
    told, rows, content = written(tmp_path)
    told = told["combined"]
    assert told["interval_90"] is None and told["without_error_bar"] == why
    for row in rows:
        assert (row["interval_90_low"], row["interval_90_high"], row["notes"]) == ("", "", why)
    assert "<!-- price$5_$6_.mp4 -->" in content  # in the figure, as it is
    assert f"N{why[1:]}, from 2 of 2 videos" in content
    assert "0.000 … " not in content


def test_a_result_that_cannot_be_written_is_not_lost(bench, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("slipstitch.film.measure.pages.write_json", full)
    assert measure(bench, tmp_path) == 1
    told = capsys.readouterr()
    assert told.out.startswith("friction 0.")
    assert "no space left on device" in told.err


def test_videos_are_named_by_what_tells_them_apart_no_formula_and_not_as_the_last_row():
    for videos, names in (
        (["day/film_1.mp4", "day/film_2.mp4"], ["film_1.mp4", "film_2.mp4"]),
        (["a/film.mp4", "b/film.mp4", "c/film.mp4"], ["a/film.mp4", "b/film.mp4", "c/film.mp4"]),
        (["a/1/film.mp4", "b/1/film.mp4"], ["a/1/film.mp4", "b/1/film.mp4"]),
    ):
        assert names_of([Path(video) for video in videos]) == names
    cells = {"combined": "./combined", "=1+1.mp4": "./=1+1.mp4", "glass_1.mp4": "glass_1.mp4"}
    table = MeasuredPair([], dict.fromkeys(cells, "damaged")).table()
    assert [row["video"] for row in csv.DictReader(table.splitlines())] == [*cells.values()]
