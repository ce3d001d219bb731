"""Separating and composing light, with numbers instead of images."""

import numpy as np
import pytest

from slipstitch.images.composition import Layers, compose
from slipstitch.images.encoding import encode_srgb
from slipstitch.images.shading import separate
from slipstitch.images.textures import texture


def test_light_separates_by_how_often_it_met_the_cloth():
    rng = np.random.default_rng(0)
    orders = rng.uniform(0, 1, (3, 5, 7))
    albedo = np.array([0.8, 0.0, 0.4])
    radiance = sum(orders[k][..., None] * albedo**k for k in range(3))
    np.testing.assert_allclose(separate(radiance), orders, atol=1e-12)


def test_light_of_higher_orders_is_kept_at_the_two_albedos_that_were_rendered():
    third = 0.3
    albedo = np.array([0.8, 0.0, 0.4])
    scene, first, second = separate(third * albedo**3)
    for a in (0.4, 0.8):
        assert scene + a * first + a**2 * second == pytest.approx(third * a**3)


@pytest.mark.parametrize("level", [0, 1, 40, 128, 254, 255])
def test_encoding_inverts_the_srgb_decoding_of_every_level(level):
    value = level / 255
    linear = value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
    assert encode_srgb(np.array(linear)) == level


def test_encoding_cuts_off_what_is_too_bright():
    np.testing.assert_array_equal(encode_srgb(np.array([-0.1, 1.3])), [0, 255])


def layers(uv, first, second=0.0, scene=0.0, pixels=2):
    """Every pixel sees the cloth at one point."""
    count = pixels**2
    light = np.full((3, count), 1.0) * np.array([scene, first, second])[:, None]
    return Layers(pixels, np.zeros((3, count)), np.arange(count), np.tile(uv, (count, 1)), light)


def test_the_albedo_is_that_of_the_point_seen():
    # The centre of the first white dot, and the ground half way between two.
    for uv in ((0.0625, 0.0625), (0.125, 0.0625)):
        column, row = (int(c * 512) for c in uv)
        (image,) = compose(layers(np.array(uv), first=0.9), ["dots"])
        expected = encode_srgb(0.9 * texture("dots")[row, column].astype(float))
        assert np.abs(image.astype(int) - expected).max() <= 3


def test_light_between_folds_takes_the_colour_of_the_cloth_twice():
    (image,) = compose(layers(np.array([0.5, 0.5]), first=0.0, second=1.0), ["denim"])
    albedo = texture("denim")
    expected = encode_srgb(albedo[254:258, 254:258].mean((0, 1)) * albedo.mean((0, 1)))
    assert np.abs(image[0, 0].astype(int) - expected).max() <= 12


def test_what_never_met_the_cloth_does_not_depend_on_the_texture():
    both = compose(layers(np.array([0.5, 0.5]), first=0.0, scene=0.4), ["dots", "stripes"])
    np.testing.assert_array_equal(*both)


def test_a_frame_without_cloth_composes():
    nothing = Layers(2, np.full((3, 4), 0.2), np.empty(0, int), np.empty((0, 2)), np.empty((3, 0)))
    (image,) = compose(nothing, ["linen"])
    assert image.shape == (2, 2, 3)
