"""Cameras: OpenCV's convention, and a crop that follows the stage."""

import numpy as np
import pytest

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.images.calibrated_view import cloth_room, crop_to
from slipstitch.images.camera import AIM_M, pose, turned


@pytest.mark.parametrize("name", VIEWPOINTS)
def test_a_viewpoint_looks_at_the_middle_of_the_track(name):
    rotation, translation = pose(VIEWPOINTS[name])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    aim = rotation @ AIM_M + translation
    np.testing.assert_allclose(aim, [0, 0, VIEWPOINTS[name].distance_m], atol=1e-12)
    # Up in the world is up in the image: y points down.
    assert rotation[1, 2] < -0.85


def test_the_frontal_camera_stands_ahead_of_the_stage_and_the_side_camera_beside_it():
    for name, axis, sign in (("frontal", 0, 1), ("side", 1, -1)):
        rotation, translation = pose(VIEWPOINTS[name])
        position = -rotation.T @ translation
        assert sign * (position - AIM_M)[axis] > 1
        assert abs((position - AIM_M)[1 - axis]) < 1e-9


@pytest.mark.parametrize("name", VIEWPOINTS)
@pytest.mark.parametrize(("x", "z"), [(0.0, 0.21), (0.0, 0.15), (0.3, 0.15)])
def test_the_crop_holds_the_room_of_the_cloth_and_little_else(name, x, z):
    camera = crop_to(pose(VIEWPOINTS[name]), cloth_room(x, z, 0.2, 0.2), 112)
    place = camera.project(cloth_room(x, z, 0.2, 0.2))
    assert place.min() > -0.5
    assert place.max() < 111.5
    assert np.ptp(place, axis=0).max() > 0.95 * 112


def test_the_crop_follows_the_stage():
    cameras = [
        crop_to(pose(VIEWPOINTS["side"]), cloth_room(x, 0.15, 0.2, 0.2), 64) for x in (0, 0.3)
    ]
    stage = [
        camera.project(np.array([[x, 0.0, 0.15]]))[0]
        for camera, x in zip(cameras, (0, 0.3), strict=True)
    ]
    # Not exactly: the camera stands still and sees the stage at another angle.
    np.testing.assert_allclose(stage[0], stage[1], atol=6)
    # It is one and the same camera, and only the crop differs.
    np.testing.assert_array_equal(cameras[0].rotation, cameras[1].rotation)
    np.testing.assert_array_equal(cameras[0].translation_m, cameras[1].translation_m)


def test_more_pixels_show_the_same_view():
    camera = crop_to(pose(VIEWPOINTS["calibrated"]), cloth_room(0.1, 0.15, 0.2, 0.2), 64)
    point = np.array([[0.12, 0.03, 0.05]])
    fine = camera.at_resolution(256)
    # The centre of pixel 0 lies half a pixel from the image's edge at every resolution.
    np.testing.assert_allclose((fine.project(point) + 0.5) / 4, camera.project(point) + 0.5)


@pytest.mark.parametrize("turn", [-15, -10, -5, 5, 10, 15])
def test_a_turned_camera_is_the_viewpoint_turned(turn):
    around = turned(*pose(VIEWPOINTS["calibrated"]), turn)
    for ours, expected in zip(around, pose(VIEWPOINTS[f"calibrated_{turn:+d}"]), strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-12)
