"""Cameras, a crop that follows the stage, and the mean cloth that displaced ones look at."""

from dataclasses import replace

import numpy as np
import pytest

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.images.calibrated_view import cloth_room, crop_to
from slipstitch.images.camera import AIM_M, pose, turned
from slipstitch.images.rectification import LAG, MeanCloth, cloth_surface, lags_m, stage_plane


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


def test_a_cloth_that_hangs_free_lags_nowhere():
    path = StagePath()
    times_s = np.arange(0, path.drop_duration_s, 0.04)
    x_m, z_m = path.position_m(times_s)
    hanging = z_m > SIDE_M
    assert hanging[0]
    assert not lags_m(x_m, z_m, SIDE_M)[hanging].any()


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


def test_from_the_viewpoint_itself_every_point_is_where_it_was():
    crop, eye = views(0.0)
    points = np.random.default_rng(1).uniform([0.1, -0.1, 0.0], [0.3, 0.1, 0.2], (200, 3))
    assert off_px(MeanCloth(0.2, HEIGHT_M, -0.06), crop, eye, points).max() < 1e-9


@pytest.mark.parametrize("lag_m", [-0.09, 0.0, 0.09])
def test_the_surface_is_met_first_and_has_no_gap(lag_m):
    """From the clamps' height down to the floor in front, rays meet it ever nearer."""
    crop, eye = views(0.0)
    cloth = MeanCloth(0.2, HEIGHT_M, lag_m)
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
