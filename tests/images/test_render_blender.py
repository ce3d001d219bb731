"""Blender draws what our cameras and meshes say, the same every time; its images are read."""

import math
import struct

import numpy as np
import pytest
from support import synthetic_cloth

from slipstitch.config.catalogue import VIEWPOINTS, Viewpoint
from slipstitch.images.blender import ClothScene, read_exr
from slipstitch.images.calibrated_view import cloth_room, crop_to
from slipstitch.images.camera import Camera, pose
from slipstitch.images.reflection import glint_share
from slipstitch.images.surroundings import FLOOR_M, Surroundings


def view(pixels, name="calibrated", x=0.1):
    return crop_to(pose(VIEWPOINTS[name]), cloth_room(x, 0.15, 0.2, 0.2), pixels)


def random_camera(seed, pixels, rows=None):
    """Any pose around the cloth, the principal point anywhere near the image.

    With `rows`, a lens's camera: an oblong image whose pixels are not square.
    """
    rng = np.random.default_rng(seed)
    seen_from = Viewpoint(rng.uniform(-180, 180), rng.uniform(12, 68), rng.uniform(0.6, 2))
    focal = pixels * seen_from.distance_m / 0.35
    centre = (pixels - 1) / 2 + rng.uniform(-0.1, 0.1, 2) * pixels
    stretch = 1.0
    if rows:
        centre = (np.array([pixels, rows]) - 1) / 2 + rng.uniform(-0.2, 0.2, 2) * (pixels, rows)
        stretch = math.exp(rng.uniform(-0.3, 0.3))
    matrix = np.array([[focal, 0, centre[0]], [0, focal * stretch, centre[1]], [0, 0, 1]])
    return Camera(*pose(seen_from), matrix, pixels, rows)


@pytest.fixture(scope="module")
def flat():
    """A flat sheet, so that texture coordinates tell exactly where a ray met it."""
    _, uv, faces = synthetic_cloth.grid(9)
    corner, along, down = np.array([[0.0, -0.1, 0.18], [0.04, 0.2, 0.0], [0.1, -0.02, -0.15]])
    positions = corner + uv[:, :1] * along + uv[:, 1:] * down
    return ClothScene(faces, uv), positions, (corner, along, down)


UP = np.array([0, 0, 1.0])
CAMERAS = [
    view(48),
    *(random_camera(k, 48) for k in range(4)),
    *(random_camera(k, 96, rows) for k in range(4, 14) for rows in (54, 128)),
    random_camera(98, 480, 270),
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


def test_the_mesh_is_the_frame_s_own_and_the_light_the_seed_s(flat):
    scene, positions, _ = flat
    here, gone, back = (
        scene.render(positions + up_m * UP, view(32), samples=1, seed=3) for up_m in (0.0, 5.0, 0.0)
    )
    assert here.uv[..., 2].any() and not gone.uv[..., 2].any()
    np.testing.assert_array_equal(here.uv, back.uv)
    np.testing.assert_array_equal(here.radiance, back.radiance)
    assert (scene.render(positions, view(32), samples=1, seed=4).radiance != here.radiance).any()


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


@pytest.mark.parametrize(("viewpoint", "roughness"), [("side", 0.5), ("calibrated", 0.4)])
def test_the_glint_s_share_is_blender_s(viewpoint, roughness):
    # With a floor that only mirrors and one that only scatters, under the lamp alone: what the
    # mirror adds to the lamp's light, over all of it.
    camera = crop_to(pose(VIEWPOINTS[viewpoint]), FLOOR_M * 0.3 + [0.1, 0, 0], 24)
    aside = np.array([[5.0, 5.0, 5.0], [5.1, 5.0, 5.0], [5.0, 5.1, 5.0]])
    uv = np.array([[0, 0], [1, 0], [0, 1.0]])

    def lamp(albedo, reflectance):
        look = Surroundings("reflective", albedo, reflectance, roughness)
        scene = ClothScene(np.array([[0, 1, 2]]), uv, look)
        return scene.render(aside, camera, samples=64).radiance[0, ..., 0], look

    whole, look = lamp(0.2, 0.3)
    mirrored, _ = lamp(0.0, 0.3)
    share = glint_share(look, camera)
    floor = whole > 0
    assert floor.mean() > 0.5
    np.testing.assert_allclose(share[floor], (mirrored / np.maximum(whole, 1e-9))[floor], atol=0.02)
    assert share[floor].max() > 0.1


def exr(compression=0, kind=2, version=2):
    """The beginning of a file of one channel, up to its pixels."""
    parts = (
        (b"channels", b"chlist", b"R\0" + struct.pack("<iIii", kind, 0, 1, 1) + b"\0"),
        (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", struct.pack("<4i", 0, 0, 1, 1)),
    )
    header = b"".join(
        name + b"\0" + form + b"\0" + struct.pack("<I", len(value)) + value
        for name, form, value in parts
    )
    return struct.pack("<II", 20000630, version) + header + b"\0"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"compression": 3}, "compressed"),
        ({"kind": 1}, "channel R is not 32-bit float"),
        ({"version": 2 | 0x1000}, "not a single-part scan-line OpenEXR file"),
    ],
)
def test_other_layouts_are_refused(tmp_path, change, said):
    path = tmp_path / "a.exr"
    path.write_bytes(exr(**change))
    with pytest.raises(ValueError, match=rf"a\.exr: {said}"):
        read_exr(path)
