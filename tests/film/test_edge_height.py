"""Height of the clamps, as a film shows it."""

import cv2
import numpy as np
import pytest
from support import analytic_stage as stage

from slipstitch.film.edge_height import EdgeFinder
from slipstitch.images.calibrated_view import BenchCamera
from slipstitch.images.camera import Camera

SCHEDULE = stage.protocol()[1]
TIMES_S = (6.8, 7.1, 20.0, 25.0, 30.0)


def lens(width: int, **moved) -> Camera:
    """A camera without distortion, beside the calibrated viewpoint."""
    place = BenchCamera(**moved).pose(*SCHEDULE.pose)
    return stage.lens_camera(*place, (width, width * 3 // 4), distortion=np.zeros(5))


def seen(camera: Camera, lifted_m: float, noise: float = 3.0):
    """What a finder finds in noisy images whose exposure drifts."""
    finder, bench = EdgeFinder(camera, SCHEDULE), stage.Bench(camera, lifted_m)
    rng = np.random.default_rng(0)
    for number, time_s in enumerate(TIMES_S):
        image = bench.image(time_s)[..., ::-1] * (1 - 0.03 * number)
        finder.add(
            time_s, np.clip(image + noise * rng.normal(size=image.shape), 0, 255).astype(np.uint8)
        )
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
def test_it_is_told_within_its_error(width, lifted_mm, moved):
    found = seen(lens(width, **moved), 1e-3 * lifted_mm)
    off_m = found.height_m - (0.150 + 1e-3 * lifted_mm)
    assert abs(off_m) < 2 * found.error_m < 0.0012


def test_a_cloth_like_the_floor_behind_has_no_edge():
    camera = lens(320)
    finder, bench = EdgeFinder(camera, SCHEDULE), stage.Bench(camera)
    still = bench.image(30.0)
    for time_s in TIMES_S:
        finder.add(time_s, cv2.GaussianBlur(still, (0, 0), 3))
    assert finder.found() is None


def test_an_edge_that_rises_from_holder_to_holder_is_none():
    finder, bench = EdgeFinder(lens(320, roll_deg=2.0), SCHEDULE), stage.Bench(lens(320))
    for time_s in TIMES_S:
        finder.add(time_s, bench.image(time_s))
    assert finder.found() is None


@pytest.mark.parametrize("times_s", [TIMES_S[:2], TIMES_S[2:], (7.1, 10.0)])
def test_it_needs_the_cloth_at_rest_and_what_is_behind(times_s):
    finder = EdgeFinder(lens(320), SCHEDULE)
    for time_s in times_s:
        finder.add(time_s, np.zeros((240, 320, 3), np.uint8))
    assert finder.found() is None
