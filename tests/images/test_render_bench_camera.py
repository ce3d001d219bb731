"""Cameras of other benches: their poses, what is told of them, and their images rectified."""

import json

import cv2
import numpy as np
import pytest
from support import synthetic_cloth, synthetic_videos

from slipstitch.base.provenance import read_metadata
from slipstitch.cli.main import main
from slipstitch.config.catalogue import Viewpoint
from slipstitch.config.render import RenderSettings
from slipstitch.images import calibrated_view
from slipstitch.images.calibrated_view import (
    BenchCamera,
    CalibratedView,
    Rectifier,
    cloth_room,
    crop_to,
    draw_bench_camera,
)
from slipstitch.images.camera import pose, relative_pose
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory

BASE = pose(Viewpoint(40.0, 24.0, 1.4))
FAMILY = RenderSettings(viewpoints=["calibrated", "bench_1"])


@pytest.mark.parametrize(("yaw", "pitch", "distance"), [(10, 0, 1), (-15, 0, 1.2), (0, 8, 0.8)])
def test_a_camera_moves_as_a_viewpoint_of_the_catalogue_would(yaw, pitch, distance):
    moved = BenchCamera(yaw_deg=yaw, pitch_deg=pitch, distance=distance).pose(*BASE)
    expected = pose(Viewpoint(40.0 + yaw, 24.0 + pitch, 1.4 * distance))
    for ours, theirs in zip(moved, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_the_pose_is_told_from_rotation_and_translation():
    moved = BenchCamera(yaw_deg=12.0, pitch_deg=-5.0, roll_deg=1.5, distance=0.9).pose(*BASE)
    told = relative_pose(moved, BASE)
    expected = {"yaw_deg": 12.0, "pitch_deg": -5.0, "roll_deg": 1.5, "log_distance": np.log(0.9)}
    assert told == pytest.approx(expected, abs=1e-9)


def test_every_simulation_has_a_camera_of_its_own_so_that_none_tells_a_fabric():
    def drawn(simulation, viewpoint):
        return draw_bench_camera(0, simulation, viewpoint)

    first = drawn("m05_f0300_r00", "bench_1")
    assert first == drawn("m05_f0300_r00", "bench_1")
    others = [
        ("m05_f1500_r00", "bench_1"),
        ("m05_f0300_r01", "bench_1"),
        ("m04_f0300_r00", "bench_1"),
        ("m05_f0300_r00", "bench_2"),
    ]
    assert all(drawn(*other) != first for other in others)


def test_cameras_fill_the_family_and_a_third_stands_as_calibrated():
    cameras = [draw_bench_camera(seed, "m00_f0100_r00", "bench_1") for seed in range(600)]
    yaw = np.array([camera.yaw_deg for camera in cameras])
    pitch = np.array([camera.pitch_deg for camera in cameras])
    assert np.mean(yaw == 0) == pytest.approx(1 / 3, abs=0.06)
    assert 14 < yaw.max() <= 15 and -15 <= yaw.min() < -14
    assert 7.5 < pitch.max() <= 8
    assert np.std([camera.position_error_m for camera in cameras]) == pytest.approx(1e-3, rel=0.1)
    assert np.std([camera.rotation_error_deg for camera in cameras]) == pytest.approx(0.05, rel=0.1)
    assert np.std([camera.focal_error for camera in cameras]) == pytest.approx(1e-3, rel=0.1)
    late_s = [camera.start_error_s for camera in cameras]
    assert -0.02 <= min(late_s) < -0.019 < 0.019 < max(late_s) <= 0.02


ROOM_M = cloth_room(0.1, 0.15, 0.2, 0.2)
SEEN = crop_to(BASE, ROOM_M, 64)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_camera_is_told_turned_by_its_error_of_rotation(axis):
    error_deg = tuple(2.0 * np.eye(3)[axis])
    told = BenchCamera(rotation_error_deg=error_deg).stated(SEEN)
    turn, _ = cv2.Rodrigues(np.radians(error_deg))
    # It is turned where it stands.
    np.testing.assert_allclose(told.rotation, turn @ SEEN.rotation, atol=1e-12)
    np.testing.assert_allclose(
        told.rotation.T @ told.translation_m, SEEN.rotation.T @ SEEN.translation_m, atol=1e-12
    )


def test_a_camera_is_told_with_its_error_of_the_focal_length():
    told = BenchCamera(focal_error=0.03).stated(SEEN)
    middle = SEEN.matrix[:2, 2]
    np.testing.assert_allclose(
        told.project(ROOM_M) - middle, 1.03 * (SEEN.project(ROOM_M) - middle), atol=1e-9
    )


def test_a_start_found_too_late_takes_the_images_for_later_ones():
    trajectory = Trajectory(**synthetic_cloth.motion(60))
    late = BenchCamera(start_error_s=float(np.diff(trajectory.time_s)[0]))

    def pixels(bench, row):
        calibrated = CalibratedView.of_trajectory(trajectory, "calibrated", FAMILY)
        return Rectifier(bench, calibrated).source_pixels(SEEN, trajectory.time_s[row])

    np.testing.assert_allclose(pixels(late, 40), pixels(BenchCamera(), 41), atol=1e-4)
    assert np.nanmax(np.abs(pixels(late, 40) - pixels(BenchCamera(), 40))) > 0.5


EXACT = {"ROTATION_SD_DEG": 0, "POSITION_SD_M": 0, "FOCAL_SD": 0, "START_ERROR_MAX_S": 0}


@pytest.fixture(scope="module")
def shard(tmp_path_factory):
    """Renders one simulation with these settings of the family; metadata and images."""
    folder = tmp_path_factory.mktemp("bench_camera")
    motion = synthetic_cloth.motion(6, n=11, frame_rate_hz=0.1)
    write_trajectory(folder / "m05_f0300_r00.parquet", Trajectory(**motion))

    def render(viewpoint, **constants):
        render = {"pixels": 48, "textures": ["dots"]}
        render["viewpoints"] = ["calibrated", "bench_1"]
        config = {"render": render, "sample": {"frames": 3}, "simulation": {"frames": 6}}
        config["train"] = {"splits": ["by_simulation"]}
        (folder / "config.json").write_text(json.dumps(config))
        out = folder / f"{viewpoint}.parquet"
        files = ["--trajectory", str(folder / "m05_f0300_r00.parquet"), "--out", str(out)]
        words = ["--config", str(folder / "config.json"), "--viewpoint", viewpoint]
        with pytest.MonkeyPatch.context() as patch:
            for name, value in (EXACT | constants).items():
                patch.setattr(calibrated_view, name, value)
            assert main(["render", *words, *files]) == 0
        return read_metadata(out), synthetic_videos.images_of(out)

    return render


def _difference(some, others):
    """Root mean square over all images, in 8-bit levels."""
    assert some.keys() == others.keys()
    squares = [np.mean((some[key].astype(float) - others[key]) ** 2) for key in some]
    return np.sqrt(np.mean(squares))


@pytest.mark.slow
def test_rectified_images_are_those_of_the_calibrated_viewpoint(shard):
    _, calibrated = shard("calibrated")
    metadata, same_pose = shard("bench_1", CALIBRATED_SHARE=1)
    assert metadata["pose"] == pytest.approx(dict.fromkeys(metadata["pose"], 0.0), abs=1e-6)
    assert metadata["camera"]["pixels"] == 72
    assert all(image.shape == (48, 48, 3) for image in same_pose.values())
    metadata, turned = shard("bench_1", CALIBRATED_SHARE=0)
    assert abs(metadata["pose"]["yaw_deg"]) > 1
    # Resampled only; seen from elsewhere, what lies off the stage plane is shifted.
    smoothed = {key: cv2.GaussianBlur(image, (0, 0), 0.4) for key, image in calibrated.items()}
    assert _difference(same_pose, smoothed) < 6
    assert _difference(same_pose, smoothed) < _difference(turned, smoothed) < 45
    assert all(image.min() > 0 for image in turned.values())  # no blind part


@pytest.fixture(scope="module")
def exact(shard):
    return shard("bench_1", CALIBRATED_SHARE=1)[1]


@pytest.mark.parametrize(
    ("error", "constant", "size", "drawn"),
    [
        ("position_error_m", "POSITION_SD_M", 0.02, 0.003),
        ("rotation_error_deg", "ROTATION_SD_DEG", 1.0, 0.1),
        ("focal_error", "FOCAL_SD", 0.05, 0.005),
    ],
)
def test_a_wrong_calibration_shifts_the_image(shard, exact, error, constant, size, drawn):
    metadata, wrong = shard("bench_1", **{constant: size}, CALIBRATED_SHARE=1)
    assert np.linalg.norm(metadata["camera"]["bench"][error]) > drawn
    assert _difference(exact, wrong) > 3
