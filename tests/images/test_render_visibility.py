"""What rays meet, and how it is blurred: areas, depths, perspective, variances in closed form."""

import numpy as np
import pytest

from slipstitch.images.camera import Camera
from slipstitch.images.reflection import GAUSSIAN, GGX, blur_weights, blurred, spread
from slipstitch.images.visibility import ray_places, sees_quad, visible_cloth


def camera(pixels=64):
    """At the origin, looking along z; a unit square at distance 2 fills half the image."""
    matrix = np.array([[pixels, 0, (pixels - 1) / 2], [0, pixels, (pixels - 1) / 2], [0, 0, 1.0]])
    return Camera(np.eye(3), np.zeros(3), matrix, pixels)


def square(depth, side=1.0, centre=(0.0, 0.0)):
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2 + centre
    return np.column_stack([corners, np.broadcast_to(depth, 4)])


FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])


@pytest.mark.parametrize("faces", [FACES, FACES[:, ::-1]], ids=["front", "back"])
def test_a_square_covers_its_area_without_a_gap_seen_from_either_side(faces):
    found = visible_cloth(square(2.0, 0.777), faces, UV, camera())
    # Its image is 0.777 * 64 / 2 = 24.9 pixels wide.
    assert len(found.seen) == pytest.approx((0.777 * 32) ** 2, rel=0.02)
    assert (np.diff(found.seen) > 0).all()
    # No ray falls between two triangles.
    seen = np.zeros(64 * 64, bool)
    seen[visible_cloth(square(2.0), faces, UV, camera()).seen] = True
    assert seen.reshape(64, 64)[17:47, 17:47].all()
    assert not len(visible_cloth(square(2.0, 0.5, (5.0, 0.0)), faces, UV, camera()).seen)  # outside


def test_texture_coordinates_are_those_of_the_point_that_the_ray_meets():
    # Tilted strongly, so that interpolation without perspective would be off by 0.1.
    corners = square(np.array([1.2, 3.0, 3.0, 1.2]))
    view = camera()
    found = visible_cloth(corners, FACES, UV, view)
    point = corners[0] + found.uv[:, :1] * (corners[1] - corners[0])
    point = point + found.uv[:, 1:] * (corners[3] - corners[0])
    y, x = np.divmod(found.seen, 64)
    np.testing.assert_allclose(view.project(point), np.column_stack(ray_places(x, y, 4)), atol=1e-9)


@pytest.mark.parametrize("order", [0, 1])
def test_the_nearer_of_two_layers_is_seen_whichever_comes_first(order):
    near, far = square(2.0, 0.5), square(2.5, 1.2)
    layers = [(near, 0.25), (far, 0.75)] if order else [(far, 0.75), (near, 0.25)]
    positions = np.concatenate([layer for layer, _ in layers])
    uv = np.concatenate([np.full((4, 2), value) for _, value in layers])
    found = visible_cloth(positions, np.concatenate([FACES, FACES + 4]), uv, camera())
    share = np.isclose(found.uv[:, 0], 0.25).sum()
    assert share == pytest.approx((0.5 * 32) ** 2, rel=0.03)


def test_a_quadrilateral_is_met_by_the_same_rays_as_its_two_triangles():
    corners = square(np.array([1.2, 3.0, 3.0, 1.2]))
    inside = np.flatnonzero(sees_quad(corners, camera()))
    np.testing.assert_array_equal(inside, visible_cloth(corners, FACES, UV, camera()).seen)
    np.testing.assert_array_equal(inside, np.flatnonzero(sees_quad(corners[::-1], camera())))


@pytest.mark.parametrize("tile", [4, 8])
@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0, 301.0])
def test_a_turned_quadrilateral_is_met_by_every_ray_inside_its_edges(tile, angle_deg):
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    corners = square(2.0, 1.3, (0.1, -0.2))
    corners[:, :2] = corners[:, :2] @ np.array([[c, s], [-s, c]])
    pixels = np.arange(64)
    x, y = ray_places(*np.meshgrid(pixels, pixels), tile)
    # Where the rays meet the plane of the square, turned back.
    plane = np.stack([x - 31.5, y - 31.5], axis=-1) / 32 @ np.array([[c, -s], [s, c]])
    expected = (np.abs(plane - [0.1, -0.2]) <= 0.65).all(axis=-1)
    np.testing.assert_array_equal(sees_quad(corners, camera(), tile), expected)


@pytest.mark.parametrize("tile", [4, 8])
def test_the_rays_of_a_tile_share_no_row_and_no_column(tile):
    y, x = np.divmod(np.arange(tile**2), tile)
    for places in ray_places(x, y, tile):
        # Evenly spread over the tile, each within its own pixel.
        np.testing.assert_allclose(np.sort(places), -0.5 + (np.arange(tile**2) + 0.5) / tile)


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
