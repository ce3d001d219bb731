"""Blender draws what our cameras and meshes say, the same every time."""

import math

import numpy as np
import pytest
from support import synthetic_cloth

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.images.blender import ClothScene
from slipstitch.images.calibrated_view import cloth_room, crop_to
from slipstitch.images.camera import Camera, pose


def view(pixels, name="calibrated", x=0.1):
    return crop_to(pose(VIEWPOINTS[name]), cloth_room(x, 0.15, 0.2, 0.2), pixels)


def random_camera(seed, pixels, rows=None):
    """Any pose around the cloth, the principal point anywhere near the image.

    With `rows`, a lens's camera: an oblong image whose pixels are not square.
    """
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-math.pi, math.pi), rng.uniform(0.2, 1.2)
    backwards = np.array(
        [
            math.cos(azimuth) * math.cos(elevation),
            math.sin(azimuth) * math.cos(elevation),
            math.sin(elevation),
        ]
    )
    right = np.cross(-backwards, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-backwards, right), -backwards])
    position = np.array([0.1, 0, 0.1]) + rng.uniform(0.6, 2) * backwards
    focal = pixels * np.linalg.norm(position) / 0.35
    centre = (pixels - 1) / 2 + rng.uniform(-0.1, 0.1, 2) * pixels
    stretch = 1.0
    if rows:
        centre = (np.array([pixels, rows]) - 1) / 2 + rng.uniform(-0.2, 0.2, 2) * (pixels, rows)
        stretch = math.exp(rng.uniform(-0.3, 0.3))
    matrix = np.array([[focal, 0, centre[0]], [0, focal * stretch, centre[1]], [0, 0, 1]])
    return Camera(rotation, -rotation @ position, matrix, pixels, rows)


@pytest.fixture(scope="module")
def flat():
    """A flat sheet, so that texture coordinates tell exactly where a ray met it."""
    _, uv, faces = synthetic_cloth.grid(9)
    corner, along, down = np.array([[0.0, -0.1, 0.18], [0.04, 0.2, 0.0], [0.1, -0.02, -0.15]])
    positions = corner + uv[:, :1] * along + uv[:, 1:] * down
    return ClothScene(faces, uv), positions, (corner, along, down)


CAMERAS = [
    view(48),
    *(random_camera(k, 48) for k in range(4)),
    *(random_camera(k, 96, rows) for k in range(4, 14) for rows in (54, 128)),
    random_camera(98, 1920, 1080),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_blender_projects_as_opencv_does(flat, camera):
    scene, positions, (corner, along, down) = flat
    _, uv, _ = scene.render(positions, camera, samples=1)
    y, x = np.nonzero(uv[..., 2])
    assert len(x) > 50
    point = corner + uv[y, x, :1] * along + uv[y, x, 1:2] * down
    # The first sample of a pixel goes through its centre.
    np.testing.assert_allclose(
        camera.project(point.astype(float)), np.column_stack([x, y]), atol=0.01
    )


def test_the_mesh_is_the_frame_s_own(flat):
    scene, positions, _ = flat
    here = scene.render(positions, view(32), samples=1)[1][..., 2]
    gone = scene.render(positions + np.array([0, 0, 5.0]), view(32), samples=1)[1][..., 2]
    back = scene.render(positions, view(32), samples=1)[1][..., 2]
    assert here.any()
    assert not gone.any()
    np.testing.assert_array_equal(here, back)


def test_equal_seeds_give_equal_light_and_others_do_not(flat):
    scene, positions, _ = flat
    first, again, other = (
        scene.render(positions, view(32), samples=1, seed=seed)[0] for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_cloth_without_albedo_is_black_and_more_albedo_is_brighter(flat):
    _, positions, _ = flat
    _, uv, faces = synthetic_cloth.grid(9)
    scene = ClothScene(faces, uv)
    radiance, cover, _ = scene.render(positions, view(32), samples=4)
    on_cloth = radiance.sum(axis=0)[cover[..., 2] == 1]
    red, green, blue = on_cloth.T
    assert np.abs(green).max() < 1e-6
    # Twice the albedo gives twice the light and some more from interreflection.
    assert (red >= 2 * blue - 1e-6).all()
    assert red.mean() < 2.3 * blue.mean()


@pytest.mark.parametrize("name", ["calibrated", "frontal", "side"])
def test_cloth_and_floor_are_well_lit_and_the_background_is_dark(name):
    _, uv, faces = synthetic_cloth.grid(21)
    positions = synthetic_cloth.shape(21, 0.1, 0.15, 1.0, 0.005)
    radiance, cover, _ = ClothScene(faces, uv).render(positions, view(64, name), samples=4)
    total, cover = radiance.sum(axis=0), cover[..., 2]
    white = total[cover == 1][:, 0] / 0.8
    assert 0.25 < np.median(white) < 1.3
    floor = total[-6:][cover[-6:] == 0][:, 1]
    assert 0.08 < np.median(floor) < 0.6
    assert np.median(total[:4, :, 1]) < 0.02


def test_nothing_is_printed_to_standard_output(capfd):
    _, uv, faces = synthetic_cloth.grid(9)
    positions = synthetic_cloth.shape(9, 0.1, 0.15, 1.0, 0.0)
    ClothScene(faces, uv).render(positions, view(16), samples=1)
    assert capfd.readouterr().out == ""
