"""The point of the cloth seen by each camera ray: a rasteriser with a depth buffer.

Texture edges and outlines need many rays per pixel, light only few. Blender traces the light; the
rays that only ask what is where are answered here, at a tenth of the cost. On the CPU Warp runs a
kernel's threads one after the other, in order.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from slipstitch.base.start import start_warp
from slipstitch.images.camera import Camera

start_warp()

# A camera's rays come in tiles of 4 or 8 a side, within which no two share a row or a column.
_SHUFFLE = {4: np.array([1, 3, 0, 2]), 8: np.array([1, 4, 7, 2, 5, 0, 3, 6])}


def warp_array(values: np.ndarray, dtype) -> wp.array:
    """The same numbers for Warp; the same memory, where types agree and rows follow each other."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


def ray_places(x: np.ndarray, y: np.ndarray, tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Image coordinates of the rays of the pixels (x, y).

    Each tile of n x n rays is sheared to lie on n^2 different columns and rows: an edge along them
    is then resolved in n^2 steps, not n (Chiu, Shirley & Wang 1994; the shuffle of Kensler 2013).
    """
    shuffle = _SHUFFLE[tile]
    return (x + (shuffle[y % tile] + 0.5) / tile - 0.5, y + (shuffle[x % tile] + 0.5) / tile - 0.5)


@dataclass(frozen=True)
class Visibility:
    """Visibility of a camera's rays, one ray per pixel."""

    seen: np.ndarray  # (N,) int: flat numbers of the pixels whose ray meets the cloth, rising
    uv: np.ndarray  # (N, 2) float64: texture coordinates there
    depth_m: np.ndarray  # (N,) float64: along the optical axis


def visible_cloth(
    positions_m: np.ndarray, faces: np.ndarray, uv: np.ndarray, camera: Camera, tile: int = 4
) -> Visibility:
    """Cast a ray through every pixel, at its place in `ray_places`, at both faces of triangles."""
    side = camera.pixels
    local = positions_m @ camera.rotation.T + camera.translation_m
    nearness = 1 / local[:, 2]
    image = (local @ camera.matrix.T)[:, :2] * nearness[:, None]
    nearest = np.zeros((side, side))
    place = np.empty((side, side, 2))
    shuffle = _SHUFFLE[tile]
    kinds = [wp.vec2d, wp.float64, wp.vec2d, wp.vec3i, wp.int32, wp.float64, wp.vec2d]
    arrays = [image, nearness, uv, faces, shuffle, nearest, place]
    inputs = [*map(warp_array, arrays, kinds)]
    wp.launch(_draw_triangle, dim=len(faces), inputs=inputs, device="cpu")
    seen = np.flatnonzero(nearest)
    return Visibility(seen, place.reshape(-1, 2)[seen], 1 / nearest.ravel()[seen])


@wp.kernel(enable_backward=False)
def _draw_triangle(
    image: wp.array(dtype=wp.vec2d),
    nearness: wp.array(dtype=wp.float64),
    uv: wp.array(dtype=wp.vec2d),
    faces: wp.array(dtype=wp.vec3i),
    shuffle: wp.array(dtype=wp.int32),
    nearest: wp.array(dtype=wp.float64, ndim=2),
    place: wp.array(dtype=wp.vec2d, ndim=2),
):
    """Draw one triangle into the depth buffer; on a CPU one runs after the other."""
    nodes = faces[wp.tid()]
    p = image[nodes[0]]
    a = image[nodes[1]] - p
    b = image[nodes[2]] - p
    area = a[0] * b[1] - a[1] * b[0]
    if wp.abs(area) < wp.float64(1e-12):
        return
    zero, one, half = wp.float64(0.0), wp.float64(1.0), wp.float64(0.5)
    low = p + wp.vec2d(wp.min(zero, wp.min(a[0], b[0])), wp.min(zero, wp.min(a[1], b[1])))
    high = p + wp.vec2d(wp.max(zero, wp.max(a[0], b[0])), wp.max(zero, wp.max(a[1], b[1])))
    side, tile = nearest.shape[0], shuffle.shape[0]
    # A ray lies within half a pixel of its pixel's centre; far places are no integers.
    end = wp.float64(side)
    left = wp.int32(wp.ceil(wp.clamp(low[0] - half, zero, end)))
    right = wp.int32(wp.floor(wp.clamp(high[0] + half, -one, end - one)))
    top = wp.int32(wp.ceil(wp.clamp(low[1] - half, zero, end)))
    bottom = wp.int32(wp.floor(wp.clamp(high[1] + half, -one, end - one)))
    size = wp.float64(tile)
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            # As in `ray_places`.
            dx = wp.float64(x) + (wp.float64(shuffle[y % tile]) + half) / size - half - p[0]
            dy = wp.float64(y) + (wp.float64(shuffle[x % tile]) + half) / size - half - p[1]
            second = (dx * b[1] - dy * b[0]) / area
            third = (dy * a[0] - dx * a[1]) / area
            first = one - second - third
            if first >= zero and second >= zero and third >= zero:
                w0 = first * nearness[nodes[0]]
                w1 = second * nearness[nodes[1]]
                w2 = third * nearness[nodes[2]]
                near = w0 + w1 + w2
                if near > nearest[y, x]:
                    nearest[y, x] = near
                    place[y, x] = (w0 * uv[nodes[0]] + w1 * uv[nodes[1]] + w2 * uv[nodes[2]]) / near


def sees_quad(corners_m: np.ndarray, camera: Camera, tile: int = 4) -> np.ndarray:
    """Whether each pixel's ray meets a convex quadrilateral (4, 3), (pixels, pixels) bool."""
    corners = camera.project(corners_m)
    edges = np.roll(corners, -1, axis=0) - corners
    turn = np.sign(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])

    pixel = np.arange(camera.pixels)
    # By how much a row shifts its rays in x, and a column its rays in y.
    shift, _ = ray_places(np.zeros_like(pixel), pixel, tile)
    result = np.ones((camera.pixels, camera.pixels), bool)
    for (from_x, from_y), (along_x, along_y) in zip(corners, turn * edges, strict=True):
        # How far inside the edge a ray lies is a sum: a part of its row, one of its column.
        of_row = along_x * (pixel - from_y) - along_y * shift
        of_column = along_x * shift - along_y * (pixel - from_x)
        result &= of_row[:, None] >= -of_column
    return result
