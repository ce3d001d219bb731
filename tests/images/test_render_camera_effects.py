"""Floors, lamps and cameras: drawn by seed and name, and doing what they say."""

import numpy as np
import pytest

from slipstitch.config.catalogue import FLOORS
from slipstitch.config.render import AugmentationSettings, RenderSettings
from slipstitch.images.encoding import CameraEffects, draw_camera_effects, encode_srgb, pixel_noise
from slipstitch.images.surroundings import LAMP_POSITION_M, MATTE, draw_surroundings

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


def test_what_is_drawn_depends_on_seed_and_simulation_only():
    settings = RenderSettings(floors=list(FLOORS), augmentation=AugmentationSettings(lamp_m=0.2))
    one = draw_surroundings(settings, 3, "m00_f0100_r00")
    assert draw_surroundings(settings, 3, "m00_f0100_r00") == one
    assert draw_surroundings(settings, 4, "m00_f0100_r00") != one
    others = [draw_surroundings(settings, 3, f"m{k:02d}_f0100_r00") for k in range(60)]
    assert {other.floor for other in others} == set(FLOORS)
    away = np.array([other.lamp_position_m for other in others]) - LAMP_POSITION_M
    assert 0.15 < np.abs(away).max() <= 0.2


def test_a_video_s_camera_is_the_same_whatever_else_there_is():
    settings = AugmentationSettings(exposure_stops=1, colour_cast=0.2, noise=0.05, jpeg_quality=40)
    one = draw_camera_effects(settings, 3, "m00_f0100_r00", "dots", "side")
    assert draw_camera_effects(settings, 3, "m00_f0100_r00", "dots", "side") == one
    for other in (("m01_f0100_r00", "dots", "side"), ("m00_f0100_r00", "linen", "side")):
        assert draw_camera_effects(settings, 3, *other) != one


def test_a_stop_doubles_the_light_and_a_cast_scales_red_and_blue():
    np.testing.assert_allclose(CameraEffects(exposure_stops=1.0).light(LIGHT), 2 * LIGHT)
    seen = CameraEffects(red=1.1, blue=0.8).light(LIGHT)
    np.testing.assert_allclose(seen / LIGHT, np.broadcast_to([1.1, 1, 0.8], LIGHT.shape))


def test_noise_has_the_variance_of_counted_photons():
    camera = CameraEffects(noise=0.02)
    for level in (0.05, 0.3, 0.6):
        image = camera.photograph(np.full((200, 200, 3), level), rng()) / 255
        linear = np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
        assert linear.std() == pytest.approx(0.02 * np.sqrt(level + 0.01), rel=0.06)
        assert linear.mean() == pytest.approx(level, rel=0.01)


def test_compression_costs_detail_and_little_else():
    image = encode_srgb(LIGHT).astype(int)
    rough = CameraEffects(jpeg_quality=30).photograph(LIGHT, rng()).astype(int)
    fine = CameraEffects(jpeg_quality=95).photograph(LIGHT, rng()).astype(int)
    assert np.abs(rough - image).mean() > np.abs(fine - image).mean() > 0
    assert np.abs(rough.mean((0, 1)) - image.mean((0, 1))).max() < 3


def test_nothing_that_is_drawn_for_an_image_tells_the_friction_coefficient():
    looks = RenderSettings(
        floors=list(FLOORS),
        augmentation={"lamp_m": 0.3, "exposure_stops": 1.0, "colour_cast": 0.2, "noise": 0.1},
    )

    def drawn(name):
        effects = draw_camera_effects(looks.augmentation, 3, name, "dots", "side")
        noise = pixel_noise(3, name, "dots", "side", 7).random()
        return draw_surroundings(looks, 3, name), effects, noise

    first, *others = (f"m03_f{100 * k:04d}_r01" for k in range(16))
    assert all(drawn(other) == drawn(first) for other in others)
    assert drawn("m03_f0100_r02")[0] != drawn(first)[0]


def test_a_camera_of_another_bench_has_a_floor_a_lamp_and_colours_of_its_own_in_every_simulation():
    looks = RenderSettings(
        viewpoints=["calibrated", "side", "bench_1", "bench_2"],
        floors=list(FLOORS),
        augmentation={"lamp_m": 0.3, "exposure_stops": 1.0},
    )
    here, aside, one, two = (
        draw_surroundings(looks, 3, "m03_f0100_r01", view) for view in ("v00", "v01", "v02", "v03")
    )
    assert here == aside
    assert len({here.lamp_position_m, one.lamp_position_m, two.lamp_position_m}) == 3
    for other in ("m03_f1500_r01", "m04_f0100_r01"):
        assert one.lamp_position_m != draw_surroundings(looks, 3, other, "v02").lamp_position_m
        cameras = [
            draw_camera_effects(looks.augmentation, 3, name, "dots", "bench_1")
            for name in ("m03_f0100_r01", other)
        ]
        assert cameras[0] != cameras[1]
    other_place = looks.model_copy(update={"viewpoints": ["bench_1"]})
    assert one == draw_surroundings(other_place, 3, "m03_f0100_r01", "v00")
