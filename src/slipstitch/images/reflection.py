"""The reflection of the cloth in the floor: the point seen by each ray, and its blur.

A mirror at z = 0 shows points at -z, so the mirrored cloth is seen by the same rasteriser. A
floor of roughness r has slopes t about either axis of the GGX distribution (Walter et al. 2007),
with the parameter r^2. A point that lies d behind the floor along the mirrored ray is moved by
2 t d along the plane of incidence and 2 t d cos(angle of incidence) across it. GGX has long tails:
a tenth of the light comes from beyond three times its parameter, which makes dark cloth look hazy
even in a good mirror.
"""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.images.camera import Camera
from slipstitch.images.surroundings import Surroundings
from slipstitch.images.visibility import Visibility, sees_quad, visible_cloth

#: GGX, p(t1, t2) = a^2 / pi (a^2 + t1^2 + t2^2)^2, is a mixture of Gaussians whose inverse
#: variances are exponentially distributed. Five of them: their shares, and widths over a.
GGX = tuple(
    (last - first, 1 / math.sqrt(-2 * math.log(1 - (first + last) / 2)))
    for first, last in itertools.pairwise((0.0, 0.02, 0.07, 0.25, 0.6, 1.0))
)
# Mirrored cloth is looked for this many pixels beyond the image too: it blurs into it.
_MARGIN = 8
# Cloth lies on the floor if it is no further away.
_LYING_M = 1e-3


@dataclass(frozen=True)
class MirroredSight:
    """The reflection in the floor, in the image and a margin around it.

    Attributes
    ----------
    camera : Camera
        Of the image without margin.
    margin : int
        Pixels on every side.
    rays : int
        Along each side of a pixel.
    seen : ndarray (N,) int
        Flat numbers of the rays that meet mirrored cloth on floor that they see, rising.
    uv : ndarray (N, 2)
        Where on the cloth.
    lying : ndarray (N,) bool
        Whether the cloth lies on the floor there; its underside is dark.
    bare : ndarray (rays pixels, rays pixels) bool
        The rays that see the floor.
    width : ndarray (pixels, pixels) float32
        The parameter of the blur, upwards in pixels, carried on where nothing is mirrored.
    squeeze : float
        The blur's sideward width over its upward one.
    surroundings : Surroundings
        The floor's look and the lamp's place.
    floor_z_m : float
    """

    camera: Camera
    margin: int
    rays: int
    seen: np.ndarray
    uv: np.ndarray
    lying: np.ndarray
    bare: np.ndarray
    width: np.ndarray
    squeeze: float
    surroundings: Surroundings
    floor_z_m: float


def mirrored_sight(
    positions_m: np.ndarray,
    faces: np.ndarray,
    vertex_uv: np.ndarray,
    floor_m: np.ndarray,
    surroundings: Surroundings,
    cloth: Visibility,
    camera: Camera,
    rays: int,
) -> MirroredSight:
    """Find the mirrored cloth.

    Parameters
    ----------
    positions_m, faces, vertex_uv : ndarray
        The cloth's mesh.
    floor_m : ndarray (4, 3)
        Corners of the mirror, all at the same height.
    surroundings : Surroundings
    cloth : Visibility
        What the image's rays see of the cloth itself.
    camera : Camera
        Of the image.
    rays : int
        Along each side of a pixel.
    """
    wide, floor_z_m = camera.with_margin(_MARGIN), float(floor_m[0, 2])
    fine = wide.at_resolution(wide.pixels * rays)
    bare = sees_quad(floor_m, fine, rays)
    y, x = np.divmod(cloth.seen, camera.pixels * rays)
    bare[y + _MARGIN * rays, x + _MARGIN * rays] = False
    below = positions_m.copy()
    below[:, 2] = 2 * floor_z_m - below[:, 2]
    found = visible_cloth(below, faces, vertex_uv, fine, rays)
    keep = bare.ravel()[found.seen]
    seen, depth = found.seen[keep], found.depth_m[keep]
    y, x = np.divmod(seen, fine.pixels)
    # The ray's direction per metre of depth, upwards: where it meets the floor, and how steeply.
    right = (x - fine.matrix[0, 2]) / fine.matrix[0, 0]
    down = (y - fine.matrix[1, 2]) / fine.matrix[1, 1]
    up = camera.rotation[:, 2] @ np.stack([right, down, np.ones_like(right)])
    floor_depth = (floor_z_m + camera.rotation[:, 2] @ camera.translation_m) / up
    behind = np.clip(1 - floor_depth / depth, 0, 1)
    steepness = np.abs(up) / np.sqrt(1 + right**2 + down**2)
    width = 2 * surroundings.roughness**2 * camera.matrix[1, 1] * behind
    pixel = (y // rays) * wide.pixels + x // rays
    return MirroredSight(
        camera,
        _MARGIN,
        rays,
        seen,
        found.uv[keep],
        np.abs(up) * (depth - floor_depth) < _LYING_M,
        bare,
        _carried_on(pixel, width, wide.pixels),
        float(steepness.mean()) if len(seen) else 1.0,
        surroundings,
        floor_z_m,
    )


def _carried_on(pixel: np.ndarray, values: np.ndarray, side: int) -> np.ndarray:
    """Means over the pixels' rays, smoothed a little and carried on to where there are none."""
    share = np.bincount(pixel, minlength=side**2).reshape(side, side).astype(np.float32)
    total = np.bincount(pixel, values, side**2).reshape(side, side).astype(np.float32)
    result = np.full_like(total, total.sum() / max(share.sum(), 1e-6))
    for width in (16.0, 5.0, 1.0):
        weight = cv2.GaussianBlur(share, (0, 0), width)
        np.divide(cv2.GaussianBlur(total, (0, 0), width), weight, out=result, where=weight > 1e-2)
    return result
