"""Cloth textures: made by formula, the same every time, with albedos that cloth can have."""

import numpy as np
import pytest

from slipstitch.catalogue import TEXTURES
from slipstitch.errors import BadInput
from slipstitch.render.textures import texture


@pytest.mark.parametrize("name", TEXTURES)
def test_albedos_are_those_of_cloth(name):
    albedo = texture(name)
    assert albedo.shape == (512, 512, 3)
    assert albedo.min() >= np.float32(0.02)
    assert albedo.max() <= np.float32(0.8)
    # There is a pattern to follow, in luminance, not only in hue.
    assert (albedo @ [0.2126, 0.7152, 0.0722]).std() > 0.02


@pytest.mark.parametrize("name", TEXTURES)
def test_a_texture_is_the_same_every_time(name):
    np.testing.assert_array_equal(texture.__wrapped__(name), texture(name))


def test_textures_differ():
    means = np.array([texture(name)[::8, ::8].ravel() for name in TEXTURES])
    apart = np.abs(means[:, None] - means[None]).mean(axis=-1)
    assert apart[~np.eye(len(means), dtype=bool)].min() > 0.03


def test_a_texture_that_is_not_there_is_bad_input():
    with pytest.raises(BadInput, match="unknown texture 'plaid'; known: stripes"):
        texture("plaid")
