"""The part of the lamp's light that a floor mirrors, against Blender."""

import numpy as np
import pytest

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.images.blender import ClothScene
from slipstitch.images.calibrated_view import crop_to
from slipstitch.images.camera import pose
from slipstitch.images.reflection import glint_share
from slipstitch.images.surroundings import FLOOR_M, Surroundings

PIXELS = 24


@pytest.mark.parametrize(("viewpoint", "roughness"), [("side", 0.5), ("calibrated", 0.4)])
def test_the_glint_s_share_is_blender_s(viewpoint, roughness):
    # With a floor that only mirrors and one that only scatters, under the lamp alone: what the
    # mirror adds to the lamp's light, over all of it.
    camera = crop_to(pose(VIEWPOINTS[viewpoint]), FLOOR_M * 0.3 + [0.1, 0, 0], PIXELS)
    aside = np.array([[5.0, 5.0, 5.0], [5.1, 5.0, 5.0], [5.0, 5.1, 5.0]])
    uv = np.array([[0, 0], [1, 0], [0, 1.0]])

    def lamp(albedo, reflectance):
        look = Surroundings("reflective", albedo, reflectance, roughness)
        scene = ClothScene(np.array([[0, 1, 2]]), uv, look)
        return scene.render(aside, camera, samples=64).radiance[0, ..., 0], look

    whole, look = lamp(0.2, 0.3)
    mirrored, _ = lamp(0.0, 0.3)
    share = glint_share(look, FLOOR_M[0, 2], camera)
    floor = whole > 0
    assert floor.mean() > 0.5
    np.testing.assert_allclose(share[floor], (mirrored / np.maximum(whole, 1e-9))[floor], atol=0.02)
    assert share[floor].max() > 0.1
