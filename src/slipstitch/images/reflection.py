"""The reflection of the cloth in the floor: the point seen by each ray, its blur and its light.

A mirror at z = 0 shows points at -z, so the mirrored cloth is seen by the same rasteriser. A
floor of roughness r has slopes t about either axis of the GGX distribution (Walter et al. 2007),
with the parameter r^2. A point that lies d behind the floor along the mirrored ray is moved by
2 t d along the plane of incidence and 2 t d cos(angle of incidence) across it. GGX has long tails:
a tenth of the light comes from beyond three times its parameter, which makes dark cloth look hazy
even in a good mirror.

Blender renders the light of each order that the floor reflects towards the camera, with the true
distribution of slopes, from few paths; it is smoothed inside and outside the reflected cloth.
"""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.images.blur import GAUSSIAN, blur_weights, blurred, spread
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
# How much of the texture's blur the mirrored light, which is smoother, may be smoothed.
_LIGHT_SPREAD = 0.15
_LEAST_LIGHT_BLUR = 2.4
# Of the guided filter (He, Sun & Tang 2013): its reach in pixels, and its smallest edge, squared.
_GUIDED_REACH = 6
_GUIDED_EDGE = 1e-3


@dataclass(frozen=True)
class MirroredSight:
    """The reflection in the floor, in the image and a margin around it."""

    camera: Camera  # of the image without margin
    margin: int  # pixels on every side
    rays: int  # along each side of a pixel
    # (N,) int: flat numbers of the rays that meet mirrored cloth on floor that they see, rising
    seen: np.ndarray
    uv: np.ndarray  # (N, 2): where on the cloth
    lying: np.ndarray  # (N,) bool: whether the cloth lies on the floor there; its underside is dark
    bare: np.ndarray  # (rays pixels, rays pixels) bool: the rays that see the floor
    # (pixels, pixels) float32: the parameter of the blur, upwards in pixels, carried on where
    # nothing is mirrored
    width: np.ndarray
    squeeze: float  # the blur's sideward width over its upward one
    surroundings: Surroundings  # the floor's look and the lamp's place
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
    cloth : Visibility
        What the image's rays see of the cloth itself, `rays` along each side of a pixel.
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


@dataclass(frozen=True)
class MirrorShares:
    """The reflected scene at each pixel of the shading render."""

    cloth: np.ndarray  # (H, W) float32: the cloth's share of it
    lit: np.ndarray  # (H, W) float32: that of cloth that does not lie on the floor
    width: np.ndarray  # (H, W) float32: parameter of the blur, upwards in pixels


def mirror_shares(sight: MirroredSight, cells: int) -> MirrorShares:
    """The reflected scene, in this many cells along each side of an image pixel."""
    step, side = sight.rays // cells, (sight.camera.pixels + 2 * sight.margin) * cells
    y, x = np.divmod(sight.seen, side * step)
    cell = (y // step) * side + x // step
    hits = [np.bincount(hit, minlength=side**2) for hit in (cell, cell[~sight.lying])]
    of_floor = cv2.resize(sight.bare.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    width = cv2.resize(sight.width, (side, side), interpolation=cv2.INTER_LINEAR) * cells
    shares = np.stack([*np.reshape(hits, (2, side, side)) / step**2, of_floor], axis=-1)
    shares = shares.astype(np.float32)
    shares = blurred(shares, blur_weights(width, GGX), sight.squeeze)
    inside = np.s_[sight.margin * cells : -sight.margin * cells,] * 2
    shares = shares[inside]
    cloth, lit = np.moveaxis(shares[..., :2] / np.maximum(shares[..., 2:], 1e-3), -1, 0)
    return MirrorShares(cloth, lit, width[inside])


def glint_share(surroundings: Surroundings, floor_z_m: float, camera: Camera) -> np.ndarray:
    """Share (pixels, pixels) of the lamp's light on a floor that is mirrored, not scattered.

    The floor is a GGX mirror (Walter et al. 2007, height-correlated masking) of Schlick's
    reflectance over a Lambertian body, the lamp is taken as a point.
    """
    place = np.arange(camera.pixels)
    x = (place[None, :] - camera.matrix[0, 2]) / camera.matrix[0, 0]
    y = (place[:, None] - camera.matrix[1, 2]) / camera.matrix[1, 1]
    ray = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1) @ camera.rotation
    eye = -camera.translation_m @ camera.rotation
    # Pixels that look over the horizon see no floor.
    depth = (floor_z_m - eye[2]) / np.minimum(ray[..., 2], -1e-6)
    to_lamp = np.array(surroundings.lamp_position_m) - (eye + depth[..., None] * ray)
    view, lamp = (
        vector / np.linalg.norm(vector, axis=-1, keepdims=True) for vector in (-ray, to_lamp)
    )
    half = view + lamp
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    width2 = surroundings.roughness**4
    steep, seen, lit = (np.clip(vector[..., 2], 1e-6, 1) ** 2 for vector in (half, view, lamp))
    distribution = width2 / (math.pi * (steep * (width2 - 1) + 1) ** 2)
    hidden = sum((np.sqrt(1 + width2 * (1 - cosine) / cosine) - 1) / 2 for cosine in (seen, lit))
    mirrored = distribution / (1 + hidden) / (4 * np.sqrt(seen * lit))
    normal = surroundings.reflectance
    fresnel = normal + (1 - normal) * (1 - np.sqrt(seen)) ** 5
    mirrored = fresnel * mirrored
    scattered = (1 - fresnel) * surroundings.albedo / math.pi
    return (mirrored / (mirrored + scattered)).astype(np.float32)


def smooth_mirrored_light(
    light: np.ndarray, where: np.ndarray, shares: MirrorShares, squeeze: float
) -> np.ndarray:
    """Light (C, H, W) of the mirrored cloth, smoothed within its reflection.

    `where` (H, W) are the pixels that see nothing but floor.
    """
    lit = shares.lit * where
    near = np.moveaxis(spread(light, lit, _LEAST_LIGHT_BLUR), 0, -1)
    more = (_LIGHT_SPREAD * shares.width) ** 2 - _LEAST_LIGHT_BLUR**2
    weights = blur_weights(np.sqrt(np.maximum(more, 0)), GAUSSIAN)
    if len(weights) > 1:
        both = np.concatenate([near * lit[..., None], lit[..., None]], axis=-1)
        both = blurred(both.astype(np.float32), weights, squeeze)
        share = both[..., -1:]
        near = np.where(share > 1e-2, both[..., :-1] / np.maximum(share, 1e-2), near)
    return np.moveaxis(near * shares.lit[..., None], -1, 0)


def smooth_beside(light: np.ndarray, where: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Light (1, H, W) of a region (H, W), smoothed but for the edges that `coverage` has.

    A guided filter: around each pixel the light is fitted by a linear function of the coverage.
    """
    share = where.astype(np.float32)
    light = light.astype(np.float32) * share
    guide = np.clip(coverage, 0, 1).astype(np.float32)
    parts = np.stack([share, light, guide * share, guide * light, guide**2 * share], axis=-1)
    box = (2 * _GUIDED_REACH + 1,) * 2
    means = cv2.blur(parts, box)
    count = np.maximum(means[..., 0], 1e-3)
    mean, middle, product, square = np.moveaxis(means[..., 1:], -1, 0) / count
    slope = (product - middle * mean) / (square - middle**2 + _GUIDED_EDGE)
    fit = cv2.blur(np.stack([slope, mean - slope * middle], axis=-1) * share[..., None], box)
    slope, offset = np.moveaxis(fit, -1, 0) / count
    return (slope * guide + offset)[None]
