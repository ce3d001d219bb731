"""The light reflected by a floor, smoothed inside and outside the reflection of the cloth.

Blender renders the light of each order that the floor reflects towards the camera, with the true
distribution of slopes, from few paths.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.images.blur import GAUSSIAN, blur_weights, blurred, spread
from slipstitch.images.camera import Camera
from slipstitch.images.reflection import GGX, MirroredSight
from slipstitch.images.surroundings import Surroundings

# How much of the texture's blur the mirrored light, which is smoother, may be smoothed.
_LIGHT_SPREAD = 0.15
_LEAST_LIGHT_BLUR = 2.4
# Of the guided filter (He, Sun & Tang 2013): its reach in pixels, and its smallest edge, squared.
_GUIDED_REACH = 6
_GUIDED_EDGE = 1e-3


@dataclass(frozen=True)
class MirrorShares:
    """The reflected scene at each pixel of the shading render.

    Attributes
    ----------
    cloth : ndarray (H, W) float32
        The cloth's share of it.
    lit : ndarray (H, W) float32
        That of cloth that does not lie on the floor.
    width : ndarray (H, W) float32
        Parameter of the blur, upwards in pixels.
    """

    cloth: np.ndarray
    lit: np.ndarray
    width: np.ndarray


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
    """Share of the lamp's light on a floor that is mirrored, not scattered, at every pixel.

    The floor is a GGX mirror (Walter et al. 2007, height-correlated masking) of Schlick's
    reflectance over a Lambertian body, the lamp is taken as a point.

    Returns
    -------
    ndarray (pixels, pixels) float32
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

    Parameters
    ----------
    light : ndarray (C, H, W)
    where : ndarray (H, W) bool
        The pixels that see nothing but floor.
    shares : MirrorShares
    squeeze : float
        Of the mirrored sight.
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
