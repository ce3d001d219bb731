"""Films of the example, altered, read by the instrument that ships; and repeats of a pair."""

import csv
import json

import numpy as np
import pytest
from support import analytic_stage as stage
from support import example_film

from slipstitch.cli.main import main
from slipstitch.film.measure import EXAMPLE_CAMERA
from slipstitch.film.measure.measurement_files import HALF_WIDTH, MeasuredPair, combined
from slipstitch.film.measure.measuring_bench import MeasuringBench


@pytest.mark.slow
def test_a_camera_outside_the_range_raises_the_alarm_although_the_images_do_not(
    tmp_path, capsys, monkeypatch
):
    videos = []
    measure = MeasuringBench.measure

    def kept(*arguments, **options):
        videos.append(measure(*arguments, **options))
        return videos[-1]

    monkeypatch.setattr(MeasuringBench, "measure", kept)
    film, camera = example_film.rolled(tmp_path, 25)
    words = ["measure", str(film), "--camera", str(camera), "--force"]
    out = [f"--{kind}={tmp_path / 'x'}.{kind}" for kind in ("json", "csv")]
    assert main([*words, *out, f"--out={tmp_path / 'x.html'}"]) == 3
    reason = (
        "the pose of the camera is outside the training range of the instrument: roll +25.1 "
        "degrees (trained on -2.1 ... +2.1)"
    )
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == f"ALARM: {reason}: these numbers are not reliable"
    told = json.loads((tmp_path / "x.json").read_text())
    assert told["alarm"] and told["alarm_reason"] == reason
    assert not told["alarm_of_images"]
    assert reason in (tmp_path / "x.csv").read_text().splitlines()[1]
    page = (tmp_path / "x.html").read_text()
    assert f"<b>Alarm:</b> {reason}" in page and "No alarm" not in page
    # Of several films, it has no part in the combined value.
    assert MeasuredPair(videos, {}).together is None


@pytest.mark.slow
def test_repeats_are_combined_with_their_scatter_an_outlier_and_a_refused_film_named(
    tmp_path, capsys
):
    images, times_s = example_film.images_and_times()
    films = [tmp_path / day / "film.mp4" for day in ("mon", "tue", "wed", "thu", "fri")]
    for film in films:
        film.parent.mkdir()
    for film, quality in zip(films, (16, 20, 24), strict=False):
        stage.write_video(film, images, times_s, preset="ultrafast", crf=str(quality))
    # As if the camera had been pushed down by four pixels.
    moved = (np.roll(image, -4, axis=0) for image in images)
    stage.write_video(films[3], moved, times_s, preset="ultrafast")
    films[4].write_text("no video")
    out = [f"--{kind}={tmp_path / 'x'}.{kind}" for kind in ("json", "csv")]
    words = ["--camera", str(EXAMPLE_CAMERA), f"--out={tmp_path / 'x.html'}", *out]
    assert main(["measure", *map(str, films), *words]) == 2
    *_, outlier, combined = capsys.readouterr().out.splitlines()
    assert outlier == "outlier: thu/film.mp4 disagrees with the others"

    told = json.loads((tmp_path / "x.json").read_text())["combined"]
    low, high = told["interval_90"]
    assert combined == (
        f"combined (4 of 5 videos): friction {told['friction_coefficient']:.3f}, 90 % interval "
        f"{low:.3f} ... {high:.3f}; standard deviation between the videos {told['scatter']:.3f}"
    )
    assert told["videos"] == ["mon/film.mp4", "tue/film.mp4", "wed/film.mp4", "thu/film.mp4"]
    assert told["outliers"] == ["thu/film.mp4"]

    rows = {row["video"]: row for row in csv.DictReader((tmp_path / "x.csv").open())}
    assert list(rows) == [*told["videos"], "fri/film.mp4", "combined"]
    assert [rows[name]["outlier"] for name in told["videos"]] == ["0", "0", "0", "1"]
    assert rows["fri/film.mp4"]["notes"] == f"not measured: {films[4]}: a text file, not a video"
    for key, value in (
        ("friction_coefficient", told["friction_coefficient"]),
        ("interval_90_low", low),
        ("interval_90_high", high),
        ("scatter", told["scatter"]),
    ):
        assert float(rows["combined"][key]) == pytest.approx(value, abs=1e-4), key

    page = (tmp_path / "x.html").read_text()
    assert f"<h1>Friction {told['friction_coefficient']:.3f}</h1>" in page
    assert f"90 % interval {low:.3f} … {high:.3f}, from 4 of 5 videos" in page
    assert f"Standard deviation between the videos: {told['scatter']:.3f}" in page
    assert "<b>thu/film.mp4</b> disagrees with the others" in page
    assert "<b>mon/film.mp4</b>" not in page
    assert "fri/film.mp4: a text file, not a video" in page


ENDS = (0.0, 1.5)


def _coverage(shared, own, count, extra=0.0, draws=200, truths=(0.3, 1.0)):
    """Share of intervals that hold the truth, and their mean width over that of one video's.

    Medians and intervals are clipped to the grid, as an instrument's are.
    """
    generator = np.random.default_rng(3)
    half = HALF_WIDTH * np.hypot(shared, own)
    holds, width = [], []
    for _ in range(draws):
        truth = generator.uniform(*truths)
        values = truth + shared * generator.normal()
        values = values + np.hypot(own, extra) * generator.normal(size=count)
        # Never of no width: a distribution on the grid is one step wide at least.
        lower, upper = np.minimum(values - half, 1.49), np.maximum(values + half, 0.01)
        intervals = np.clip(np.column_stack([lower, upper]), *ENDS)
        low, high = combined(np.clip(values, *ENDS), intervals, ENDS).interval_90
        assert ENDS[0] <= low <= high <= ENDS[1]
        holds.append(low <= truth <= high)
        width.append((high - low) / (2 * half))
    return np.mean(holds), np.mean(width)


@pytest.mark.parametrize(
    ("sd", "truths"), [(0.02, (0.3, 1.0)), (0.05, (0.0, 0.1)), (0.05, (1.45, 1.45))]
)
@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize(("shared", "own"), [(1.0, 0.0), (0.7, 0.7), (0.0, 1.0)])
def test_the_interval_holds_whatever_the_videos_share(sd, truths, shared, own, count):
    """In the middle of the grid and at its ends."""
    coverage, width = _coverage(sd * shared, sd * own, count, truths=truths)
    assert coverage >= 0.87
    # Two videos that disagree say little of their scatter; three are worth one at least.
    assert width <= (1.3 if count > 2 else 2.6)


def test_a_half_that_the_grid_cuts_off_is_no_small_error():
    """Where (0, 0.1) holds the truth in nine cases of ten, three such videos say the same."""
    assert combined([0.0] * 3, [(0.0, 0.1)] * 3, ENDS).interval_90 == pytest.approx(
        (0.0, 0.1), abs=1e-3
    )
    assert combined([1.45] * 3, [(1.2, 1.5)] * 3, ENDS).interval_90 == pytest.approx(
        (1.2, 1.5), abs=2e-3
    )
    # The grid ends elsewhere: these are whole halves.
    assert combined([1.45] * 3, [(1.2, 1.5)] * 3, (0.0, 2.0)).interval_90 == pytest.approx(
        (1.2, 1.5), abs=2e-3
    )


def test_a_skew_interval_stays_skew():
    assert combined([0.5] * 3, [(0.48, 0.56)] * 3, ENDS).interval_90 == pytest.approx(
        (0.48, 0.56), abs=1e-3
    )


def test_videos_without_an_error_bar_have_none_together():
    result = combined([0.3, 0.32, 0.9], [ENDS] * 3, ENDS)
    assert result.interval_90 == ENDS
    assert result.outliers == []


def test_what_differs_between_videos_averages_out():
    _, width = _coverage(0.0, 0.02, 10)
    assert width < 0.6


def test_scatter_beyond_the_stated_error_widens_the_interval():
    coverage, width = _coverage(0.005, 0.005, 5, extra=0.05)
    assert coverage >= 0.85
    assert width > 3


def test_one_video_is_told_as_it_is():
    result = combined([0.3], [(0.25, 0.4)], ENDS)
    assert result.interval_90 == (0.25, 0.4)
    assert result.friction_coefficient == 0.3 and np.isnan(result.scatter)


def test_a_stray_video_is_named_and_an_ordinary_one_hardly_ever():
    values = [0.30, 0.31, 0.305, 0.52, 0.298]
    result = combined(values, [(value - 0.03, value + 0.03) for value in values], ENDS)
    assert result.outliers == [3]
    assert result.friction_coefficient == pytest.approx(np.mean(values))
    generator = np.random.default_rng(5)
    named = [
        bool(combined(v, [(x - 0.03, x + 0.03) for x in v], ENDS).outliers)
        for v in 0.5 + 0.018 * generator.normal(size=(200, 5))
    ]
    assert np.mean(named) <= 0.1
