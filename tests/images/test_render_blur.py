"""Blurs against closed forms: variances, the distribution of slopes, planes up to an edge."""

import numpy as np
import pytest

from slipstitch.images.reflection import GAUSSIAN, GGX, blur_weights, blurred, spread

SIDE = 160


@pytest.mark.parametrize("width", [0.2, 0.5, 1.0, 1.7, 3.1, 7.0, 12.0])
def test_a_point_is_smeared_by_the_width_that_is_asked_for(width):
    # Eight points, each in a column and a row of its own.
    rows = SIDE // 2 + np.arange(8)
    columns = np.arange(8) * SIDE // 8 + 10
    image = np.zeros((SIDE, SIDE, 1), np.float32)
    image[rows, columns] = 1
    weights = blur_weights(np.full((SIDE, SIDE), width), GAUSSIAN)
    smeared = blurred(image, weights, squeeze=0.1)[..., 0]
    assert smeared.sum() == pytest.approx(8, rel=1e-3)
    upwards = (smeared * (np.arange(SIDE)[:, None] - np.repeat(rows, SIDE // 8)) ** 2).sum() / 8
    sideways = (smeared * (np.arange(SIDE) - np.repeat(columns, SIDE // 8)) ** 2).sum() / 8
    assert upwards == pytest.approx(width**2, rel=0.03)
    assert sideways == pytest.approx((0.1 * width) ** 2, rel=0.03)


def test_each_pixel_has_its_own_width():
    width = np.zeros((SIDE, SIDE))
    width[:, SIDE // 2 :] = 4.0
    stripes = np.zeros((SIDE, SIDE, 1), np.float32)
    stripes[::2] = 1
    image = blurred(stripes, blur_weights(width, GAUSSIAN), squeeze=0.0)
    np.testing.assert_array_equal(image[:, : SIDE // 2], stripes[:, : SIDE // 2])
    np.testing.assert_allclose(image[20:-20, SIDE // 2 :], 0.5, atol=0.01)


@pytest.mark.parametrize("times", [0.5, 1.0, 2.0, 3.0, 5.0])
def test_the_mixture_of_gaussians_is_the_distribution_of_slopes(times):
    # GGX: slopes beyond k times its parameter have the share 1 / (1 + k^2).
    beyond = sum(share * np.exp(-((times / width) ** 2) / 2) for share, width in GGX)
    assert sum(share for share, _ in GGX) == pytest.approx(1)
    assert beyond == pytest.approx(1 / (1 + times**2), abs=0.03)


def test_a_plane_of_light_is_kept_up_to_the_region_s_edge_and_beyond():
    y, x = np.mgrid[:40, :50].astype(float)
    plane = 3 + 0.1 * x - 0.05 * y
    inside = (x > 12) & (y < 30)
    light = np.where(inside, plane, 99.0)
    found = spread(light[None], inside, 1.0)[0]
    np.testing.assert_allclose(found[3:26, 16:46], plane[3:26, 16:46], rtol=1e-4)
    # A mean would be off by 0.08 in the region's last pixel and by 0.18 in the next, outside.
    off = np.abs(found[3:26] - plane[3:26])
    assert off[:, 13].max() < 0.03
    assert off[:, 12].max() < 0.08
    # Far outside the light is that of the region nearby.
    assert found[10, 8] == pytest.approx(plane[10, 14], abs=0.3)


def test_light_is_what_it_would_be_if_the_region_filled_the_pixel():
    share = np.full((20, 20), 0.25)
    np.testing.assert_allclose(spread(share[None] * 8.0, share, 1.5), 8.0, rtol=1e-3)
