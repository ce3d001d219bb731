"""``slipstitch measure``: films of the example, altered, read by the instrument that ships."""

import csv
import json

import numpy as np
import pytest
from support import analytic_stage as stage
from support import example_film

from slipstitch.cli.main import main
from slipstitch.film.measure import EXAMPLE_CAMERA
from slipstitch.film.measure.measurement_files import MeasuredPair
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
