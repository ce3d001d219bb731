"""Cloth textures: made by formula, the same every time, with albedos that cloth can have."""

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import TEXTURE_FAMILY, TEXTURES
from slipstitch.images.textures import texture, worn_texture


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_is_the_same_every_time_with_albedos_of_cloth(name):
    albedo = texture(name)
    assert albedo.shape == (512, 512, 3)
    assert albedo.min() >= np.float32(0.02)
    assert albedo.max() <= np.float32(0.8)
    # There is a pattern to follow, in luminance, not only in hue.
    assert (albedo @ [0.2126, 0.7152, 0.0722]).std() > 0.02
    np.testing.assert_array_equal(texture.__wrapped__(name), albedo)


def test_textures_differ():
    means = np.array([texture(name)[::8, ::8].ravel() for name in TEXTURES])
    apart = np.abs(means[:, None] - means[None]).mean(axis=-1)
    assert apart[~np.eye(len(means), dtype=bool)].min() > 0.03


def test_a_texture_that_is_not_there_is_bad_input():
    with pytest.raises(BadInput, match="unknown texture 'plaid'; known: stripes"):
        texture("plaid")


@pytest.mark.parametrize("number", range(12))
def test_drawn_cloths_have_albedos_that_cloth_can_have(number):
    albedo = texture(f"cloth_1:{number}")
    assert albedo.shape == (512, 512, 3) and albedo.dtype == np.float32
    assert np.float32(0.02) <= albedo.min() and albedo.max() <= np.float32(0.8)
    np.testing.assert_array_equal(texture.__wrapped__(f"cloth_1:{number}"), albedo)


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


def test_textures_of_the_catalogue_are_the_same_in_every_film():
    assert worn_texture("denim", 0, "m00_f0100_r00", "bench_1") == "denim"
