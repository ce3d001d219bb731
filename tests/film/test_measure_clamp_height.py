"""The height of the clamps as a film shows it, and readings corrected for it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import analytic_stage as stage
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.film.edge_height import EdgeFinder, EdgeHeight
from slipstitch.film.measure import EXAMPLE_CAMERA, EXAMPLE_VIDEO, SHIPPED, clamp_height
from slipstitch.film.measure.clamp_height import ClampHeight, SeenClamps
from slipstitch.film.measure.measuring_bench import MeasuredVideo, measuring_bench
from slipstitch.images.calibrated_view import BenchCamera
from slipstitch.images.camera_file import HEIGHT
from slipstitch.learning.prediction import Prediction

MEASURED = Path(__file__).parents[2] / "results/published/camera/clamp_height.json"
GRID = np.linspace(0.0, 1.75, 176)


def reading(mu=0.6, interval=(0.5, 0.72)):
    shares = np.exp(-0.5 * ((GRID - mu) / 0.06) ** 2)
    return Prediction(mu, (GRID, shares / shares.sum()), interval)


def clamps(height_mm, error_mm=0.2):
    return ClampHeight(1e-3 * height_mm, 1e-3 * error_mm, 0.15)


def test_its_constants_are_the_published_ones_and_correct_other_simulations():
    published = json.loads(MEASURED.read_text())
    found = published["all"]
    constants = (clamp_height.READING_PER_M, clamp_height.READING_PER_M_SD)
    per_mm = (found["error_per_mm"], found["error_per_mm_sd"])
    assert constants == tuple(round(1e3 * value, 1) for value in per_mm)
    assert found["height_sd_mm"] > 0.4 * 1e3 * clamp_height.FURTHEST_M
    for one, other in (("first", "second"), ("second", "first")):  # half of them each
        left = published[other]["error_per_mm"] - published[one]["error_per_mm"]
        assert abs(left * published[other]["height_sd_mm"]) < 0.015


def test_a_reading_is_corrected_and_its_interval_allows_for_the_height():
    found = clamps(151).corrected(reading())
    assert found.friction_coefficient == pytest.approx(0.6 / (1 - 0.0684))
    assert clamps(149).corrected(reading()).friction_coefficient == pytest.approx(0.6 / 1.0684)
    grid, shares = found.distribution
    assert grid is GRID
    assert shares.sum() == pytest.approx(1)
    assert np.interp(0.5, np.cumsum(shares), grid) == pytest.approx(0.6 / (1 - 0.0684), abs=0.01)
    # At the right height only its error is added.
    found = clamps(150, 0.5).corrected(reading())
    assert found.friction_coefficient == pytest.approx(0.6)
    added = 1.645 * 0.0684 * 0.5 * 0.6
    ends = (0.6 - np.hypot(0.1, added), 0.6 + np.hypot(0.12, added))
    assert found.interval_90 == pytest.approx(ends, abs=1e-4)
    # An interval stays within the grid, and an end that is cut off stays cut off.
    found = clamps(151.5).corrected(reading(1.7, (1.6, 1.75)))
    assert found.friction_coefficient == found.interval_90[1] == 1.75
    assert clamps(149).corrected(reading(0.6, (0.0, 1.75))).interval_90 == (0.0, 1.75)


@pytest.mark.parametrize(
    ("height_mm", "error_mm", "says"),
    [
        (15.02, 0.2, "clamp height 15.02 mm: must be from 148 to 152 mm"),
        (0.15, 0.2, "clamp height 0.15 mm: must be from 148 to 152 mm"),
        (float("nan"), 0.2, "clamp height nan mm"),
        (150.4, 0.0, "error of the clamp height 0 mm: must be above 0 and at most 2 mm"),
        (150.4, float("inf"), "error of the clamp height inf mm"),
    ],
)
def test_another_unit_and_no_error_are_refused(height_mm, error_mm, says):
    with pytest.raises(BadInput, match=says):
        clamps(height_mm, error_mm)


def test_the_command_refuses_what_it_cannot_use(tmp_path, capsys):
    said = refused(capsys, "measure --example --clamp-height-error-mm 0.2")
    assert "error of the clamp height: give the clamp height with it" in said
    other = shutil.copytree(SHIPPED, tmp_path / "other")
    said = refused(capsys, f"measure --example --clamp-height-mm 151 --model {other}")
    assert "its effect was measured for the instrument that comes with Slipstitch" in said


def test_the_result_says_what_was_told_and_what_it_does(tmp_path, capsys):
    files = f"--out {tmp_path}/page.html --json {tmp_path}/numbers.json"
    assert run(f"measure --example --clamp-height-mm 150.5 {files}") == 0
    told = "clamps at 150.5 ± 0.2 mm, told, +0.5 mm from the protocol: the reading"
    assert f"note: {told}" in capsys.readouterr().out
    page = (tmp_path / "page.html").read_text()
    assert f"C{told[1:]}" in page and "<td>149 ... 151 mm</td><td>150.5 ± 0.2 mm, told</td>" in page
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    assert numbers["clamp_height_mm"] == pytest.approx(150.5)
    assert numbers["clamp_height_factor"] == pytest.approx(1 / (1 - 0.0342))


@pytest.fixture
def exact_camera(tmp_path):
    """The example's camera, which tells heights to 0.3 mm."""
    content = json.loads(EXAMPLE_CAMERA.read_text()) | {"uncertainty": {HEIGHT: 0.0003}}
    (tmp_path / "camera.json").write_text(json.dumps(content))
    return tmp_path / "camera.json"


@pytest.mark.parametrize(
    ("height_m", "code", "says"),
    [
        (0.1508, 0, "note: clamps at 150.8 ± 0.5 mm, measured from the film (image ± 0.4, camera"),
        (0.1534, 3, "ALARM: the clamps hang at 153.4 ± 0.5 mm (image ± 0.4, camera ± 0.3 mm) "),
    ],
)
def test_a_height_in_the_film_corrects_or_alarms(
    exact_camera, monkeypatch, capsys, height_m, code, says
):
    seen = EdgeHeight(height_m, 0.0004)
    monkeypatch.setattr(EdgeFinder, "found", lambda self: seen)
    numbers = exact_camera.with_name("numbers.json")
    assert run(f"measure {EXAMPLE_VIDEO} --camera {exact_camera} --json {numbers}") == code
    assert says in capsys.readouterr().out
    told = json.loads(numbers.read_text())
    assert told["clamp_height_seen_mm"] == pytest.approx(1e3 * height_m)
    assert (told["clamp_height_factor"] is None) == bool(code)


@pytest.mark.parametrize(
    ("height_mm", "camera_mm", "told", "corrects", "says"),
    [
        (151.9, 0.3, None, True, "+1.9 mm from the height of the protocol"),
        (150.9, 0.3, None, True, ""),
        (153.0, 1.7, None, False, ""),
        (154.0, 1.7, None, False, "seen at 154.0 ± 1.7 mm (image ± 0.4, camera ± 1.7 mm), +4.0 mm"),
        (151.5, 0.3, clamps(150.2), True, "+1.3 mm from the height told"),
        (150.9, 0.3, clamps(150.2), True, ""),
    ],
)
def test_a_height_in_the_film_is_used_if_exact_and_contradicts(
    height_mm, camera_mm, told, corrects, says
):
    seen = SeenClamps(1e-3 * height_mm, 0.0004, 1e-3 * camera_mm, 0.15)
    assert bool(seen.measured()) == corrects
    found = seen.contradiction(told)
    assert says in found and bool(found) == bool(says)


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (clamps(151.5), "; the clamps hang at 151.5 ± 0.2 mm, told (trained on 149 ... 151 mm)"),
        (clamps(150.5), "; camera and clamps are as in the training: look at light, sharpness"),
        (None, "; the camera is as in the training: look at light, sharpness, scene, fabric"),
    ],
)
def test_an_alarm_of_the_images_says_what_of_the_bench_lies_outside(told, says):
    bench = measuring_bench(EXAMPLE_CAMERA)
    read = replace(reading(), alarm_reason="the images differ")
    result = MeasuredVideo("film.mp4", None, read, 0.1, bench, told)
    assert result.alarm_reason.startswith(f"the images differ{says}")
    assert replace(result, measurement=reading()).alarm_reason == ""


SCHEDULE = stage.protocol()[1]
TIMES_S = (6.8, 7.1, 20.0, 25.0, 30.0)


def lens(width=320, **moved):
    """A camera without distortion, beside the calibrated viewpoint."""
    place = BenchCamera(**moved).pose(*SCHEDULE.pose)
    return stage.lens_camera(*place, (width, width * 3 // 4), distortion=np.zeros(5))


def found_in(camera, image, times_s=TIMES_S):
    """The height that is found in the images of these times."""
    finder = EdgeFinder(camera, SCHEDULE)
    for time_s in times_s:
        finder.add(time_s, np.clip(image(time_s), 0, 255).astype(np.uint8))
    return finder.found()


@pytest.mark.parametrize(
    ("width", "lifted_mm", "moved"),
    [
        (640, -2, {}),
        (640, 0, {"yaw_deg": -12.0}),
        (640, 1, {"pitch_deg": 6.0, "roll_deg": 2.0}),
        (320, 2, {"yaw_deg": 10.0, "distance": 1.15}),
    ],
)
def test_a_height_is_found_within_its_error_in_noise_and_drifting_light(width, lifted_mm, moved):
    camera, rng = lens(width, **moved), np.random.default_rng(0)
    bench = stage.Bench(camera, 1e-3 * lifted_mm)

    def noisy(time_s):
        image = bench.image(time_s)[..., ::-1] * (1 - 0.03 * TIMES_S.index(time_s))
        return image + 3 * rng.normal(size=image.shape)

    found = found_in(camera, noisy)
    off_m = found.height_m - (0.150 + 1e-3 * lifted_mm)
    assert abs(off_m) < 2 * found.error_m < 0.0012


def test_what_is_no_edge_gives_no_height():
    bench = stage.Bench(lens())
    # A cloth like the floor behind, and an edge that rises from holder to holder.
    still = cv2.GaussianBlur(bench.image(30.0), (0, 0), 3)
    assert found_in(lens(), lambda time_s: still) is None
    assert found_in(lens(roll_deg=2.0), bench.image) is None
    # The cloth at rest is needed, and what is behind.
    for times_s in (TIMES_S[:2], TIMES_S[2:], (7.1, 10.0)):
        assert found_in(lens(), bench.image, times_s) is None
