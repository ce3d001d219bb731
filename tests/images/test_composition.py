"""Composed images against direct renders of the same textures, at the resolution of training.

The renderer was tuned on other frames, and never on the turned viewpoints. The reference is Cycles
with the texture itself on the cloth, of as many paths a pixel as the workflow's own verification.
"""

from itertools import cycle

import numpy as np
import pytest
from support import synthetic_cloth

from slipstitch.config.render import RenderSettings
from slipstitch.images.blender import ClothScene
from slipstitch.images.composition import Layers, compose_light, join
from slipstitch.images.encoding import encode_srgb
from slipstitch.images.packing import render_shadings
from slipstitch.images.shading import separate
from slipstitch.images.surroundings import MATTE, Surroundings
from slipstitch.images.textures import texture
from slipstitch.images.verification import LEAST_PSNR_DB, LEAST_SSIM, SAMPLES, psnr_db, ssim
from slipstitch.images.view import View
from slipstitch.physics.simulation.trajectory import Trajectory

# Between the floors that the reflection was tuned on, and at the ends.
REFLECTIVE = {
    "polished": Surroundings("reflective", 0.15, 0.45, 0.12),
    "dull": Surroundings("reflective", 0.1, 0.25, 0.38),
    "ceramic": Surroundings("ceramic", 0.55, 0.045, 0.17),
    "rough-glass": Surroundings("rough-glass", 0.22, 0.04, 0.5),
    "polyester-mirror": Surroundings("polyester-mirror", 0.02, 0.8, 0.07),
    "stainless-steel": Surroundings("stainless-steel", 0.04, 0.55, 0.25),
    "aluminium": Surroundings("aluminium", 0.04, 0.75, 0.4),
    "aluminium-pet": Surroundings("aluminium-pet", 0.04, 0.7, 0.28),
    "smooth-glass": Surroundings("smooth-glass", 0.15, 0.045, 0.06),
}
VIEWPOINTS = ["calibrated_+10", "calibrated_-15", "frontal", "side"]


def shots(trajectory, viewpoint, settings, sampled):
    return View("one.parquet", "v00", viewpoint, settings, sampled, 0).shots(trajectory)


def compose(layers, names):
    return [encode_srgb(light) for light in compose_light(layers, names)]


def compare(pixels, viewpoint, frames, textures, surroundings):
    """PSNR (dB) and SSIM of every (texture, frame)."""
    trajectory = Trajectory(**synthetic_cloth.motion(300, n=41))
    settings = RenderSettings(pixels=pixels, frames="all")
    wanted = [shot for shot in shots(trajectory, viewpoint, settings, 30) if shot.frame in frames]
    composed = {
        shot.frame: compose(join(shading, sight), textures)
        for shot, shading, sight in render_shadings(trajectory, wanted, settings, surroundings)
    }
    scene = ClothScene(trajectory.faces, trajectory.uv, surroundings)
    result = {}
    for k, name in enumerate(textures):
        scene.wear(texture(name))
        for shot in wanted:
            samples = SAMPLES[surroundings is not MATTE]
            direct = scene.render(
                trajectory.positions_m[shot.row], shot.camera, samples=samples, seed=12345
            )
            images = composed[shot.frame][k], encode_srgb(direct.radiance.sum(axis=0))
            result[name, shot.frame] = psnr_db(*images), ssim(*images)
    return result


BOTH = (["houndstooth"], ["chevron"])  # in turn: a direct render takes seconds


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    ("pixels", "viewpoint", "frames", "textures", "floor"),
    [
        (64, "frontal", {40}, ["houndstooth"], None),
        (64, "calibrated_-10", {60}, ["tartan"], "polished"),
        *((64, v, {17, 97, 233}, cloth, None) for v, cloth in zip(VIEWPOINTS, cycle(BOTH))),
        *((112, v, {17, 97, 233}, one, None) for v, one in zip(VIEWPOINTS[::-1], cycle(BOTH))),
        *(
            (112, view, {61}, cloth, floor)
            for floor, view, cloth in zip(REFLECTIVE, cycle(VIEWPOINTS), cycle(BOTH))
        ),
    ],
)
def test_composed_images_are_the_direct_ones(pixels, viewpoint, frames, textures, floor):
    measured = compare(pixels, viewpoint, frames, textures, REFLECTIVE.get(floor, MATTE))
    assert min(psnr for psnr, _ in measured.values()) >= LEAST_PSNR_DB[bool(floor)], measured
    assert min(similar for _, similar in measured.values()) >= LEAST_SSIM, measured


def test_a_uniform_cloth_is_composed_at_every_albedo():
    """The power series in the albedo, cut off after its second order, against direct renders."""
    trajectory = Trajectory(**synthetic_cloth.motion(300, n=21))
    row = 150
    settings = RenderSettings(pixels=32, frames="all")
    camera = shots(trajectory, "calibrated", settings, 30)[row].camera
    scene = ClothScene(trajectory.faces, trajectory.uv)
    positions = trajectory.positions_m[row]
    radiance, _, _ = scene.render(positions, camera, samples=64, seed=1)
    still, first, second = separate(radiance.sum(axis=0))
    # The same paths, so no noise between them: only orders above the second, of which there are
    # none at the two albedos that were rendered.
    for albedo, tolerance in ((0.1, 5e-3), (0.4, 1e-5), (0.6, 5e-3), (0.8, 1e-5)):
        scene.wear(np.full((4, 4, 3), albedo, dtype=np.float32))
        direct = scene.render(positions, camera, samples=64, seed=1).radiance
        series = still + albedo * first + albedo**2 * second
        np.testing.assert_allclose(series, direct.sum(axis=0)[..., 0], atol=tolerance)


# Separating and composing light, with numbers instead of images


def test_light_separates_by_how_often_it_met_the_cloth():
    orders = np.random.default_rng(0).uniform(0, 1, (3, 5, 7))
    albedo = np.array([0.8, 0.0, 0.4])
    radiance = sum(orders[k][..., None] * albedo**k for k in range(3))
    np.testing.assert_allclose(separate(radiance), orders, atol=1e-12)
    # Light of higher orders is kept at the two albedos that were rendered.
    third = 0.3
    scene, first, second = separate(third * albedo**3)
    for a in (0.4, 0.8):
        assert scene + a * first + a**2 * second == pytest.approx(third * a**3)


def test_encoding_inverts_the_srgb_decoding_of_every_level_and_cuts_off_the_rest():
    level = np.arange(256)
    value = level / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    np.testing.assert_array_equal(encode_srgb(linear), level)
    np.testing.assert_array_equal(encode_srgb(np.array([-0.1, 1.3])), [0, 255])


def layers(uv, first, second=0.0, scene=0.0, pixels=2):
    """Every pixel sees the cloth at one point."""
    count = pixels**2
    light = np.full((3, count), 1.0) * np.array([scene, first, second])[:, None]
    return Layers(pixels, np.zeros((3, count)), np.arange(count), np.tile(uv, (count, 1)), light)


def test_light_between_folds_takes_the_colour_of_the_cloth_twice_and_other_light_none():
    (image,) = compose(layers(np.array([0.5, 0.5]), first=0.0, second=1.0), ["denim"])
    albedo = texture("denim")
    expected = encode_srgb(albedo[254:258, 254:258].mean((0, 1)) * albedo.mean((0, 1)))
    assert np.abs(image[0, 0].astype(int) - expected).max() <= 12
    both = compose(layers(np.array([0.5, 0.5]), first=0.0, scene=0.4), ["dots", "stripes"])
    np.testing.assert_array_equal(*both)
    nothing = Layers(2, np.full((3, 4), 0.2), np.empty(0, int), np.empty((0, 2)), np.empty((3, 0)))
    (image,) = compose(nothing, ["linen"])
    assert image.shape == (2, 2, 3)
