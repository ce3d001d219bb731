"""The instrument that ships, films of its example, altered, and repeats of a pair."""

import csv
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from support import analytic_stage as stage
from support import example_film
from support.refusal import refused, run

from slipstitch.base.provenance import file_digest
from slipstitch.config import load_config
from slipstitch.film.measure import EXAMPLE_CAMERA, EXAMPLE_FOLDER, SHIPPED
from slipstitch.film.measure.measurements import MeasuredPair
from slipstitch.film.measure.measuring_bench import MeasuringBench
from slipstitch.film.measure.repeats import combined
from slipstitch.learning.instrument.measuring import HALF_WIDTH, load_instrument


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
    out = f"--json {tmp_path}/x.json --csv {tmp_path}/x.csv --out {tmp_path}/x.html"
    assert run(f"measure {film} --camera {camera} --force {out}") == 3
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
    out = f"--json {tmp_path}/x.json --csv {tmp_path}/x.csv --out {tmp_path}/x.html"
    assert run(f"measure {' '.join(map(str, films))} --camera {EXAMPLE_CAMERA} {out}") == 2
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
    names = ("friction_coefficient", "interval_90_low", "interval_90_high", "scatter")
    numbers = [float(rows["combined"][name]) for name in names]
    wanted = [told["friction_coefficient"], low, high, told["scatter"]]
    assert numbers == pytest.approx(wanted, abs=1e-4)

    page = (tmp_path / "x.html").read_text()
    for words in (
        f"<h1>Friction {told['friction_coefficient']:.3f}</h1>",
        f"90 % interval {low:.3f} … {high:.3f}, from 4 of 5 videos",
        f"Standard deviation between the videos: {told['scatter']:.3f}",
        "<b>thu/film.mp4</b> disagrees with the others",
        "fri/film.mp4: a text file, not a video",
    ):
        assert words in page
    assert "<b>mon/film.mp4</b>" not in page


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


@pytest.mark.parametrize(
    ("values", "interval", "ends", "abs_error"),
    [
        # Cut off by the grid: where such a half holds the truth in nine cases of ten, three such
        # videos say the same.
        ([0.0] * 3, (0.0, 0.1), ENDS, 1e-3),
        ([1.45] * 3, (1.2, 1.5), ENDS, 2e-3),
        ([1.45] * 3, (1.2, 1.5), (0.0, 2.0), 2e-3),  # whole halves: this grid ends elsewhere
        ([0.5] * 3, (0.48, 0.56), ENDS, 1e-3),  # skew
        ([0.3, 0.32, 0.9], ENDS, ENDS, 0),  # without an error bar
        ([0.3], (0.25, 0.4), ENDS, 0),
    ],
)
def test_alike_videos_have_the_interval_of_one(values, interval, ends, abs_error):
    result = combined(values, [interval] * len(values), ends)
    assert result.interval_90 == pytest.approx(interval, abs=abs_error)
    assert result.outliers == []
    assert np.isnan(result.scatter) == (len(values) == 1)
    assert result.friction_coefficient == pytest.approx(np.mean(values))


def test_what_differs_between_videos_averages_out_unless_it_is_beyond_the_stated_error():
    _, width = _coverage(0.0, 0.02, 10)
    assert width < 0.6
    coverage, width = _coverage(0.005, 0.005, 5, extra=0.05)
    assert coverage >= 0.85 and width > 3


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


# The instrument that ships, and the video to try it on

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT / "results/published/instrument"


def test_it_is_the_published_one_small_and_described_by_its_card_and_digests():
    models = PUBLISHED / "models/by_simulation/instrument/ensemble"
    names = ("config.json", "instrument.json", "instrument.safetensors")
    for name, folder in zip(names, (PUBLISHED, models, models), strict=True):
        assert (SHIPPED / name).read_bytes() == (folder / name).read_bytes(), name
    assert sum(path.stat().st_size for path in SHIPPED.iterdir()) < 4e6
    digests = {name: file_digest(SHIPPED / name) for name in names}
    listed = "".join(f"{digest}  {name}\n" for name, digest in digests.items())
    assert (SHIPPED / "SHA256SUMS").read_text() == listed
    card = (SHIPPED / "MODEL_CARD.md").read_text()
    assert digests["instrument.safetensors"] in card
    assert load_instrument(SHIPPED).card["dataset_digest"] in card
    packaged = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "shipped/*" in packaged["tool"]["setuptools"]["package-data"]["slipstitch.film.measure"]


def test_an_audit_of_it_is_sent_to_the_folder_that_holds_its_chain(capsys):
    told = "results/published/instrument of the repository: audit that folder"
    assert told in refused(capsys, f"audit {SHIPPED}")


@pytest.mark.parametrize("name", ["config.json", "instrument.json", "instrument.safetensors"])
def test_an_altered_one_is_refused_in_one_line(name, tmp_path, capsys):
    model = shutil.copytree(SHIPPED, tmp_path / "model")
    content = (model / name).read_bytes()
    (model / name).write_bytes(content.replace(b"0", b"1", 1))
    assert f"{model / name}: altered" in refused(capsys, f"measure --example --model {model}")


def test_it_is_what_its_configuration_trains():
    shipped = load_config(SHIPPED / "config.json")
    now = load_config(
        *(ROOT / name for name in ("config.yaml", "config/paper.yaml", "config/instrument.yaml"))
    )
    for section in ("seed", "grid", "simulation", "sample", "instrument"):
        assert getattr(shipped, section) == getattr(now, section), section
    card = load_instrument(SHIPPED).card
    # The tenth fabric only calibrates the error bars, so that they allow for an unseen one.
    (unseen,) = now.sample.validation_materials
    assert {*card["materials"], unseen} == set(now.grid.materials)
    assert len(now.grid.materials) == 10
    # The largest only trains, so that it is for coefficients up to 1.5.
    assert (min(card["frictions"]), max(card["frictions"])) == (0.0, 1.75)
    assert now.sample.train_only_frictions == [1.75]
    # Its own pairs that do not train, and other benches by what it read of them before.
    assert card["calibration_simulations"] == 100
    read = ROOT / "results/published/camera/drawn_fabrics.json"
    (elsewhere,) = card["calibration_readings"]
    assert elsewhere == {"digest": file_digest(read), "videos": 1200, "simulations": 50}
    assert card["split"] == "by_simulation"
    low, high = card["pose_range"]["yaw_deg"]
    assert low < -10 < 10 < high


def test_the_example_is_measured_without_any_other_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("measure --example --json numbers.json --out page.html") == 0
    said = capsys.readouterr().out
    assert "the example is simulated, not real" in said
    known = json.loads((EXAMPLE_FOLDER / "example.json").read_text())
    told = json.loads((tmp_path / "numbers.json").read_text())
    low, high = told["interval_90"]
    assert low <= known["friction"] <= high
    # ± and interval are stretched alike: of a normal distribution they would be as 1 to 1.64.
    assert 1.2 < (high - low) / 2 / told["uncertainty"] < 2.1
    assert not told["alarm"]
    # The page says what this instrument knows: seven floors that reflect are among its floors.
    page = (tmp_path / "page.html").read_text()
    assert f"True value: <b>{known['friction']:.3f}</b>. This example was simulated" in page
    assert "<td>roll, degrees</td><td>-2.1 … +2.1</td><td>+0.1</td>" in page
    # Of so few pixels the edge cannot be told, and nobody told the clamps' height.
    assert "<td>149 ... 151 mm</td><td>assumed 150 ± 1 mm, ± 0.016 of friction within" in page
    assert told["clamp_height_mm"] is None and told["clamp_height_seen_mm"] is None
    config = load_config(SHIPPED / "config.json")
    assert f"floors other than {', '.join(sorted(config.render.floors))};" in page
    fabrics = load_instrument(SHIPPED).card["materials"]
    assert f"fabrics other than {', '.join(sorted(fabrics))};" in page
    assert "a reflective floor" not in page and "training viewpoint" not in page
