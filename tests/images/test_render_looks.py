"""Floors, lamps, cameras and textures: drawn by seed and name, and doing what they say."""

from operator import eq

import numpy as np
import pytest
from pydantic import ValidationError

from slipstitch.config.catalogue import FLOORS, TEST_ONLY_TEXTURES, TEXTURE_FAMILY, TEXTURES
from slipstitch.config.render import AugmentationSettings, RenderSettings
from slipstitch.images.encoding import CameraEffects, draw_camera_effects, encode_srgb
from slipstitch.images.surroundings import LAMP_POSITION_M, MATTE, draw_surroundings
from slipstitch.images.textures import texture, worn_texture
from slipstitch.images.view import View

LIGHT = np.random.default_rng(0).uniform(0.1, 0.6, (24, 24, 3))


def rng():
    return np.random.default_rng(1)


def test_without_variation_everything_is_as_it_was():
    assert draw_surroundings(RenderSettings(), 7, "m00_f0100_r00") == MATTE
    camera = draw_camera_effects(AugmentationSettings(), 7, "m00_f0100_r00", "dots", "side")
    assert camera == CameraEffects()
    np.testing.assert_array_equal(camera.photograph(LIGHT, rng()), encode_srgb(LIGHT))


@pytest.mark.parametrize("name", FLOORS)
def test_a_floor_is_drawn_within_its_ranges_and_gives_back_no_more_than_it_gets(name):
    settings = RenderSettings(floors=[name])
    for simulation in range(20):
        drawn = draw_surroundings(settings, 3, f"m{simulation:02d}_f0100_r00")
        floor = FLOORS[name]
        assert floor.albedo[0] <= drawn.albedo <= floor.albedo[1]
        assert floor.reflectance[0] <= drawn.reflectance <= floor.reflectance[1]
        assert floor.roughness[0] <= drawn.roughness <= floor.roughness[1]
        assert drawn.albedo * (1 - drawn.reflectance) + drawn.reflectance < 0.95
        assert drawn.lamp_position_m == LAMP_POSITION_M


LOOKS = RenderSettings(
    viewpoints=["calibrated", "side", "bench_1", "bench_2"],
    floors=list(FLOORS),
    augmentation={"lamp_m": 0.2, "exposure_stops": 1, "colour_cast": 0.2, "noise": 0.05,
                  "jpeg_quality": 40},
)  # fmt: skip


def drawn(name="m00_f0100_r00", seed=3, texture="dots", view="side"):
    """Surroundings, camera and a number of the noise of a simulation's video."""
    place = {"side": "v01", "bench_1": "v02"}[view]
    effects = draw_camera_effects(LOOKS.augmentation, seed, name, texture, view)
    noise = View(f"{name}.parquet", place, view, LOOKS, 1, seed).noise(texture, 7).random()
    return draw_surroundings(LOOKS, seed, name, place), effects, noise


def test_what_is_drawn_depends_on_seed_bench_and_video_and_tells_no_friction_coefficient():
    one = drawn()
    assert all(drawn(f"m00_f{100 * k:04d}_r00") == one for k in range(16))
    for other in ({"seed": 4}, {"name": "m01_f0100_r00"}, {"name": "m00_f0100_r01"}):
        assert not any(map(eq, drawn(**other), one)), other
    surroundings, *of_video = drawn(texture="linen")
    assert surroundings == one[0] and not any(map(eq, of_video, one[1:]))
    others = [draw_surroundings(LOOKS, 3, f"m{k:02d}_f0100_r00") for k in range(60)]
    assert {other.floor for other in others} == set(FLOORS)
    away = np.array([other.lamp_position_m for other in others]) - LAMP_POSITION_M
    assert 0.15 < np.abs(away).max() <= 0.2


def test_a_camera_of_another_bench_has_looks_of_its_own_in_every_simulation():
    here, one = drawn(), drawn(view="bench_1")
    two = draw_surroundings(LOOKS, 3, "m00_f0100_r00", "v03")
    assert len({here[0].lamp_position_m, one[0].lamp_position_m, two.lamp_position_m}) == 3
    assert draw_surroundings(LOOKS, 3, "m00_f0100_r00", "v00") == here[0]
    for other in ("m00_f1500_r00", "m01_f0100_r00"):
        assert not any(map(eq, drawn(other, view="bench_1"), one))
    other_place = LOOKS.model_copy(update={"viewpoints": ["bench_1"]})
    assert one[0] == draw_surroundings(other_place, 3, "m00_f0100_r00", "v00")


def test_a_camera_scales_the_light_adds_the_noise_of_counted_photons_and_compresses():
    np.testing.assert_allclose(CameraEffects(exposure_stops=1.0).light(LIGHT), 2 * LIGHT)
    seen = CameraEffects(red=1.1, blue=0.8).light(LIGHT)
    np.testing.assert_allclose(seen / LIGHT, np.broadcast_to([1.1, 1, 0.8], LIGHT.shape))
    for level in (0.05, 0.3, 0.6):
        even = np.full((200, 200, 3), level)
        image = CameraEffects(noise=0.02).photograph(even, rng()) / 255
        linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
        assert linear.std() == pytest.approx(0.02 * np.sqrt(level + 0.01), rel=0.06)
        assert linear.mean() == pytest.approx(level, rel=0.01)
    image = encode_srgb(LIGHT).astype(int)
    rough, fine = (
        CameraEffects(jpeg_quality=quality).photograph(LIGHT, rng()).astype(int)
        for quality in (30, 95)
    )
    assert np.abs(rough - image).mean() > np.abs(fine - image).mean() > 0
    assert np.abs(rough.mean((0, 1)) - image.mean((0, 1))).max() < 3


@pytest.mark.parametrize("name", [*TEXTURES, *(f"cloth_1:{number}" for number in range(12))])
def test_a_texture_is_the_same_every_time_with_albedos_of_cloth(name):
    albedo = texture(name)
    assert albedo.shape == (512, 512, 3) and albedo.dtype == np.float32
    assert np.float32(0.02) <= albedo.min() and albedo.max() <= np.float32(0.8)
    # There is a pattern to follow, in luminance, not only in hue.
    assert name not in TEXTURES or (albedo @ [0.2126, 0.7152, 0.0722]).std() > 0.02
    np.testing.assert_array_equal(texture.__wrapped__(name), albedo)


def test_textures_differ():
    assert (len(TEXTURES), len(TEST_ONLY_TEXTURES)) == (9, 1)
    means = np.array([texture(name)[::8, ::8].ravel() for name in TEXTURES])
    apart = np.abs(means[:, None] - means[None]).mean(axis=-1)
    assert apart[~np.eye(len(means), dtype=bool)].min() > 0.03


@pytest.mark.slow
def test_every_film_wears_a_cloth_of_its_own():
    """No two films share one, so that none is known by heart; a film's frames do."""
    names = {
        worn_texture(name, 0, simulation, viewpoint)
        for name in TEXTURE_FAMILY
        for simulation in ("m00_f0100_r00", "m00_f0150_r00", "m01_f0100_r00")
        for viewpoint in ("bench_1", "bench_2")
    }
    assert len(names) == 8 * 3 * 2
    first = worn_texture("cloth_3", 0, "m00_f0100_r00", "bench_1")
    assert first == worn_texture("cloth_3", 0, "m00_f0100_r00", "bench_1")
    assert first != worn_texture("cloth_3", 1, "m00_f0100_r00", "bench_1")
    pictures = np.array([texture(name)[::16, ::16].ravel() for name in sorted(names)])
    apart = np.abs(pictures[:, None] - pictures[None]).mean(axis=-1)
    assert apart[~np.eye(len(pictures), dtype=bool)].min() > 0.005
    assert worn_texture("denim", 0, "m00_f0100_r00", "bench_1") == "denim"  # of the catalogue


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"textures": ["dots", "dots"]}, "duplicate"),
        ({"textures": ["dots"], "test_textures": ["dots"]}, "share dots"),
        ({"textures": ["chevron"]}, "chevron: for testing only"),
        ({"viewpoints": ["calibrated_-10"]}, "calibrated_-10: for testing only"),
        ({"pixels": 8}, "greater than or equal to 16"),
        ({"frames": "some"}, "'sampled' or 'all'"),
    ],
)
def test_impossible_settings_are_refused(keys, message):
    with pytest.raises(ValidationError, match=message.replace("+", r"\+")):
        RenderSettings(**keys)
