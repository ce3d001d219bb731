"""Textures made by formula, and settings with only those (and the viewpoints) that exist."""

import numpy as np
import pytest
from pydantic import ValidationError

from slipstitch.config.catalogue import TEST_ONLY_TEXTURES, TEXTURE_FAMILY, TEXTURES
from slipstitch.config.render import RenderSettings
from slipstitch.images.textures import texture, worn_texture


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
