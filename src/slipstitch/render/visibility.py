"""Which point of the cloth each ray of a camera meets: a rasteriser with a depth buffer.

Texture edges and outlines need many rays per pixel, light only few. Blender traces the light; the
rays that only ask what is where are answered here, at a tenth of the cost.
"""

from dataclasses import dataclass

import numpy as np

from slipstitch.render.camera import Camera

# A camera's rays come in tiles of 4 or 8 a side, within which no two share a row or a column.
_SHUFFLE = {4: np.array([1, 3, 0, 2]), 8: np.array([1, 4, 7, 2, 5, 0, 3, 6])}


def ray_places(x: np.ndarray, y: np.ndarray, tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Image coordinates of the rays of the pixels (x, y).

    Each tile of n x n rays is sheared so that its rays lie on n^2 different columns and n^2
    different rows: an edge along a row or a column is then resolved in n^2 steps, not n
    (multi-jittered sampling: Chiu, Shirley & Wang 1994, with the correlated shuffle of Kensler
    2013, which keeps slanting edges well resolved too).
    """
    shuffle = _SHUFFLE[tile]
    return (
        x + (shuffle[y % tile] + 0.5) / tile - 0.5,
        y + (shuffle[x % tile] + 0.5) / tile - 0.5,
    )


@dataclass(frozen=True)
class Visibility:
    """What a camera's rays see, one ray a pixel.

    Attributes
    ----------
    seen : ndarray (N,) int
        Flat numbers of the pixels whose ray meets the cloth, rising.
    uv : ndarray (N, 2) float64
        Texture coordinates there.
    depth_m : ndarray (N,) float64
        Along the optical axis.
    """

    seen: np.ndarray
    uv: np.ndarray
    depth_m: np.ndarray


def visible_cloth(
    positions_m: np.ndarray, faces: np.ndarray, uv: np.ndarray, camera: Camera, tile: int = 4
) -> Visibility:
    """Cast one ray through every pixel, at its place in `ray_places`, at the cloth's triangles.

    Parameters
    ----------
    positions_m : ndarray (V, 3)
        World coordinates.
    faces : ndarray (F, 3) int
    uv : ndarray (V, 2)
        Interpolated over each triangle with perspective.
    camera : Camera
    tile : int
        4 or 8, see `ray_places`.

    Returns
    -------
    Visibility
        Both faces of the cloth count; vertices must lie in front of the camera.
    """
    side = camera.pixels
    local = positions_m @ camera.rotation.T + camera.translation_m
    nearness = 1 / local[:, 2]
    image = (local @ camera.matrix.T)[:, :2] * nearness[:, None]
    corners = image[faces]
    # A ray lies within half a pixel of its pixel's centre.
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, side).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) + 0.5), -1, side - 1).astype(np.int64)
    columns, rows = np.maximum(high - low + 1, 0).T
    count = columns * rows
    # One entry for every pixel of every triangle's bounding box.
    triangle = np.repeat(np.arange(len(faces)), count)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    y, x = np.divmod(within, columns[triangle])
    x += low[triangle, 0]
    y += low[triangle, 1]
    # Barycentric coordinates are affine in the pixel.
    origin, a, b = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    scale = np.divide(1, area, out=np.full_like(area, np.nan), where=np.abs(area) > 1e-12)
    place_x, place_y = ray_places(x, y, tile)
    dx, dy = place_x - origin[triangle, 0], place_y - origin[triangle, 1]
    second = dx * (b[:, 1] * scale)[triangle] - dy * (b[:, 0] * scale)[triangle]
    third = dy * (a[:, 0] * scale)[triangle] - dx * (a[:, 1] * scale)[triangle]
    inside = (second >= 0) & (third >= 0) & (second + third <= 1)
    triangle, x, y = triangle[inside], x[inside], y[inside]
    weights = np.stack([1 - second[inside] - third[inside], second[inside], third[inside]], axis=1)
    weights *= nearness[faces[triangle]]
    near = weights.sum(axis=1)
    pixel = y * side + x
    nearest = np.zeros(side * side)
    np.maximum.at(nearest, pixel, near)
    front = np.flatnonzero(near == nearest[pixel])
    seen, first = np.unique(pixel[front], return_index=True)
    front = front[first]
    blend = weights[front] / near[front, None]
    return Visibility(
        seen, np.einsum("nk,nkd->nd", blend, uv[faces[triangle[front]]]), 1 / near[front]
    )


def sees_quad(corners_m: np.ndarray, camera: Camera, tile: int = 4) -> np.ndarray:
    """Whether each pixel's ray meets a convex quadrilateral.

    Parameters
    ----------
    corners_m : ndarray (4, 3)
        In order around the quadrilateral, all in front of the camera.
    camera : Camera
    tile : int
        4 or 8, see `ray_places`.

    Returns
    -------
    ndarray (pixels, pixels) bool
    """
    corners = camera.project(corners_m)
    edges = np.roll(corners, -1, axis=0) - corners
    turn = np.sign(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
    place = np.arange(camera.pixels)
    place_x, place_y = ray_places(place[None, :], place[:, None], tile)
    inside = np.ones((camera.pixels, camera.pixels), dtype=bool)
    for (x, y), (along_x, along_y) in zip(corners, edges, strict=True):
        inside &= turn * (along_x * (place_y - y) - along_y * (place_x - x)) >= 0
    return inside
