"""Cameras of the calibrated bench and of others: poses, crops, rectified images."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import synthetic_cloth, synthetic_videos
from support.refusal import run

from slipstitch.base.provenance import read_metadata
from slipstitch.config.catalogue import VIEWPOINTS, Viewpoint
from slipstitch.config.render import RenderSettings
from slipstitch.design.stage_path import SIDE_M
from slipstitch.images import calibrated_view
from slipstitch.images.calibrated_view import BenchCamera, cloth_room, crop_to, draw_bench_camera
from slipstitch.images.camera import AIM_M, pose, relative_pose, turned
from slipstitch.images.rectification import LAG, MeanCloth, cloth_surface, lags_m, stage_plane
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory


@pytest.mark.parametrize("name", VIEWPOINTS)
def test_a_viewpoint_looks_at_the_middle_of_the_track_and_its_crop_follows_the_cloth(name):
    rotation, translation = pose(VIEWPOINTS[name])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    aim = rotation @ AIM_M + translation
    np.testing.assert_allclose(aim, [0, 0, VIEWPOINTS[name].distance_m], atol=1e-12)
    # Up in the world is up in the image: y points down.
    assert rotation[1, 2] < -0.85
    if name in ("frontal", "side"):  # ahead of the stage, and beside it
        axis, sign = (0, 1) if name == "frontal" else (1, -1)
        away_m = -rotation.T @ translation - AIM_M
        assert sign * away_m[axis] > 1 and abs(away_m[1 - axis]) < 1e-9
    for x, z in ((0.0, 0.21), (0.0, 0.15), (0.3, 0.15)):
        camera = crop_to((rotation, translation), cloth_room(x, z, 0.2, 0.2), 112)
        place = camera.project(cloth_room(x, z, 0.2, 0.2))
        assert place.min() > -0.5 and place.max() < 111.5
        assert np.ptp(place, axis=0).max() > 0.95 * 112
        # It is one and the same camera, and only the crop differs.
        assert np.array_equal(camera.rotation, rotation)
        assert np.array_equal(camera.translation_m, translation)


def test_more_pixels_show_the_same_view():
    camera = crop_to(pose(VIEWPOINTS["calibrated"]), cloth_room(0.1, 0.15, 0.2, 0.2), 64)
    point = np.array([[0.12, 0.03, 0.05]])
    # The centre of pixel 0 lies half a pixel from the image's edge at every resolution.
    fine = camera.at_resolution(256).project(point)
    np.testing.assert_allclose((fine + 0.5) / 4, camera.project(point) + 0.5)


# The mean cloth: where it lags, and what of a displaced camera's view it puts right

CALIBRATED = VIEWPOINTS["calibrated"]
HEIGHT_M = 0.15
REACH_M = np.sqrt(SIDE_M**2 - HEIGHT_M**2)


def test_the_edge_stays_until_it_is_pulled_along_and_again_after_the_stage_has_turned():
    there = np.linspace(0, 0.3, 301)
    stage_x_m = np.concatenate([there, there[-2::-1]])
    lag = lags_m(stage_x_m, np.full(len(stage_x_m), HEIGHT_M), SIDE_M)
    assert lag[50] == pytest.approx(-0.05)
    assert lag[300] == pytest.approx(-LAG * REACH_M)
    assert lag[350] == pytest.approx(-LAG * REACH_M + 0.05)
    assert lag[-1] == pytest.approx(LAG * REACH_M)
    hanging_m = np.full(9, SIDE_M + 1e-3)  # where it hangs free it lags nowhere
    assert not lags_m(np.linspace(0, 0.1, 9), hanging_m, SIDE_M).any()


def views(turn_deg):
    """A crop of the calibrated viewpoint, and the eye of a camera so far aside."""
    crop = crop_to(pose(CALIBRATED), cloth_room(0.2, HEIGHT_M, SIDE_M, SIDE_M), 64)
    aside = replace(CALIBRATED, azimuth_deg=CALIBRATED.azimuth_deg + turn_deg)
    rotation, translation_m = pose(aside)
    return crop, -rotation.T @ translation_m


def off_px(surface, crop, eye, points):
    """How far points, seen from the eye through a surface, are from where the crop has them."""
    taken_for = surface.seen(eye, points - eye)
    return np.linalg.norm(crop.project(taken_for) - crop.project(points), axis=1)


@pytest.mark.parametrize("turn_deg", [-15.0, 5.0, 15.0])
def test_an_edge_on_the_floor_before_the_stage_is_where_the_viewpoint_has_it(turn_deg):
    crop, eye = views(turn_deg)
    lag = LAG * REACH_M
    cloth = MeanCloth(0.2, HEIGHT_M, lag)
    edge = np.column_stack([np.full(5, 0.2 + lag), np.linspace(-0.1, 0.1, 5), np.zeros(5)])
    assert off_px(cloth, crop, eye, edge).max() < 1e-9
    assert off_px(stage_plane(crop, 0.2), crop, eye, edge).min() > 0.3 * abs(turn_deg)


@pytest.mark.parametrize("lag_m", [-0.09, 0.0, 0.09])
def test_the_surface_is_met_first_and_has_no_gap(lag_m):
    """From the clamps' height down to the floor in front, rays meet it ever nearer."""
    crop, eye = views(0.0)
    cloth = MeanCloth(0.2, HEIGHT_M, lag_m)
    points = np.random.default_rng(1).uniform([0.1, -0.1, 0.0], [0.3, 0.1, 0.2], (200, 3))
    assert off_px(cloth, crop, eye, points).max() < 1e-9  # seen from the viewpoint itself
    rows = np.linspace(10, 63, 500)
    rays = np.column_stack([np.full(500, 32.0), rows, np.ones(500)])
    met = cloth.seen(eye, rays @ np.linalg.inv(crop.matrix).T @ crop.rotation)
    assert np.isfinite(met).all()
    assert (met[:, 2] > -1e-12).all()
    assert np.linalg.norm(np.diff(met, axis=0), axis=1).max() < 0.02


def test_a_camera_that_looks_across_the_track_has_the_plane_along_it():
    side = crop_to(pose(VIEWPOINTS["side"]), cloth_room(0.2, HEIGHT_M, SIDE_M, SIDE_M), 64)
    assert cloth_surface(side, MeanCloth(0.2, HEIGHT_M, 0.05)) == stage_plane(side, 0.2)
    assert stage_plane(side, 0.2).normal == (0.0, 1.0, 0.0)


BASE = pose(Viewpoint(40.0, 24.0, 1.4))
FAMILY = RenderSettings(viewpoints=["calibrated", "bench_1"])


@pytest.mark.parametrize(("yaw", "pitch", "distance"), [(10, 0, 1), (-15, 0, 1.2), (0, 8, 0.8)])
def test_a_camera_moves_as_a_viewpoint_of_the_catalogue_would_and_its_pose_is_told(
    yaw, pitch, distance
):
    moved = BenchCamera(yaw_deg=yaw, pitch_deg=pitch, distance=distance).pose(*BASE)
    expected = pose(Viewpoint(40.0 + yaw, 24.0 + pitch, 1.4 * distance))
    for ours, theirs in zip(moved, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
    rolled = BenchCamera(yaw_deg=yaw, pitch_deg=pitch, roll_deg=1.5, distance=distance)
    told = {"yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": 1.5, "log_distance": np.log(distance)}
    assert relative_pose(rolled.pose(*BASE), BASE) == pytest.approx(told, abs=1e-9)


@pytest.mark.parametrize("turn", [-15, -10, -5, 5, 10, 15])
def test_a_turned_camera_is_the_viewpoint_turned(turn):
    around = turned(*pose(VIEWPOINTS["calibrated"]), turn)
    for ours, expected in zip(around, pose(VIEWPOINTS[f"calibrated_{turn:+d}"]), strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_cameras_fill_the_family_and_a_third_stands_as_calibrated_each_for_one_simulation():
    cameras = [draw_bench_camera(seed, "m00_f0100_r00", "bench_1") for seed in range(600)]
    assert cameras[0] == draw_bench_camera(0, "m00_f0100_r00", "bench_1")
    for other in ("m00_f1500_r00", "m00_f0100_r01", "m04_f0100_r00"):
        assert draw_bench_camera(0, other, "bench_1") != cameras[0]
    assert draw_bench_camera(0, "m00_f0100_r00", "bench_2") != cameras[0]
    yaw = np.array([camera.yaw_deg for camera in cameras])
    pitch = np.array([camera.pitch_deg for camera in cameras])
    assert np.mean(yaw == 0) == pytest.approx(1 / 3, abs=0.06)
    assert 14 < yaw.max() <= 15 and -15 <= yaw.min() < -14 and 7.5 < pitch.max() <= 8
    sds = {"position_error_m": 1e-3, "rotation_error_deg": 0.05, "focal_error": 1e-3}
    for error, sd in sds.items():
        assert np.std([getattr(camera, error) for camera in cameras]) == pytest.approx(sd, rel=0.1)
    late_s = [camera.start_error_s for camera in cameras]
    assert -0.02 <= min(late_s) < -0.019 < 0.019 < max(late_s) <= 0.02


ROOM_M = cloth_room(0.1, 0.15, 0.2, 0.2)
SEEN = crop_to(BASE, ROOM_M, 64)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_camera_is_told_with_the_errors_of_its_calibration(axis):
    off = tuple(2.0 * np.eye(3)[axis])
    told = BenchCamera(rotation_error_deg=off).stated(SEEN)
    turn, _ = cv2.Rodrigues(np.radians(off))
    # It is turned where it stands.
    np.testing.assert_allclose(told.rotation, turn @ SEEN.rotation, atol=1e-12)
    eye = SEEN.rotation.T @ SEEN.translation_m
    np.testing.assert_allclose(told.rotation.T @ told.translation_m, eye, atol=1e-12)
    moved = BenchCamera(position_error_m=off, focal_error=0.03).stated(SEEN)
    np.testing.assert_allclose(moved.translation_m - SEEN.translation_m, off, atol=1e-12)
    focal = np.diag(moved.matrix)[:2] / np.diag(SEEN.matrix)[:2]
    np.testing.assert_allclose(focal, 1.03)
    assert np.array_equal(moved.matrix[:2, 2], SEEN.matrix[:2, 2])


def test_a_start_found_too_late_takes_the_images_for_later_ones():
    trajectory = Trajectory(**synthetic_cloth.motion(60))
    late = BenchCamera(start_error_s=float(np.diff(trajectory.time_s)[0]))

    def pixels(bench, row):
        view = calibrated_view.CalibratedView.of_trajectory(trajectory, "calibrated", FAMILY)
        rectifier = calibrated_view.Rectifier(bench, view)
        return rectifier.source_pixels(SEEN, trajectory.time_s[row])

    np.testing.assert_allclose(pixels(late, 40), pixels(BenchCamera(), 41), atol=1e-4)
    assert np.nanmax(np.abs(pixels(late, 40) - pixels(BenchCamera(), 40))) > 0.5


EXACT = {"ROTATION_SD_DEG": 0, "POSITION_SD_M": 0, "FOCAL_SD": 0, "START_ERROR_MAX_S": 0}


@pytest.fixture(scope="module")
def shard(tmp_path_factory):
    """Renders one simulation with these settings of the family; metadata and images."""
    folder = tmp_path_factory.mktemp("bench_camera")
    motion = synthetic_cloth.motion(6, n=11, frame_rate_hz=0.1)
    write_trajectory(folder / "m05_f0300_r00.parquet", Trajectory(**motion))

    looks = {"pixels": 48, "textures": ["dots"], "viewpoints": ["calibrated", "bench_1"]}
    config = {"render": looks, "sample": {"frames": 3}, "simulation": {"frames": 6}}
    config["train"] = {"splits": ["by_simulation"]}
    (folder / "config.json").write_text(json.dumps(config))
    command = f"render --config {folder}/config.json --trajectory {folder}/m05_f0300_r00.parquet"

    def render(viewpoint, **constants):
        out = folder / f"{viewpoint}.parquet"
        with pytest.MonkeyPatch.context() as patch:
            for name, value in (EXACT | constants).items():
                patch.setattr(calibrated_view, name, value)
            assert run(f"{command} --viewpoint {viewpoint} --out {out}") == 0
        return read_metadata(out), synthetic_videos.images_of(out)

    return render


def _difference(some, others):
    """Root mean square over all images, in 8-bit levels."""
    assert some.keys() == others.keys()
    squares = [np.mean((some[key].astype(float) - others[key]) ** 2) for key in some]
    return np.sqrt(np.mean(squares))


def test_rectified_images_are_those_of_the_calibrated_viewpoint(shard):
    _, calibrated = shard("calibrated")
    metadata, same_pose = shard("bench_1", CALIBRATED_SHARE=1)
    assert metadata["pose"] == pytest.approx(dict.fromkeys(metadata["pose"], 0.0), abs=1e-6)
    assert metadata["camera"]["pixels"] == 72
    assert all(image.shape == (48, 48, 3) for image in same_pose.values())
    metadata, wrong = shard("bench_1", FOCAL_SD=0.05, CALIBRATED_SHARE=1)
    assert abs(metadata["camera"]["bench"]["focal_error"]) > 0.005
    assert _difference(same_pose, wrong) > 3
    metadata, turned = shard("bench_1", CALIBRATED_SHARE=0)
    assert abs(metadata["pose"]["yaw_deg"]) > 1
    # Resampled only; seen from elsewhere, what lies off the stage plane is shifted.
    smoothed = {key: cv2.GaussianBlur(image, (0, 0), 0.4) for key, image in calibrated.items()}
    assert _difference(same_pose, smoothed) < 6
    assert _difference(same_pose, smoothed) < _difference(turned, smoothed) < 45
    assert all(image.min() > 0 for image in turned.values())  # no blind part
