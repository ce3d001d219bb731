"""The texture of the cloth in its reflection on the floor, without Blender."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from slipstitch.images.blur import blur_weights, blurred
from slipstitch.images.reflection import GGX, MirroredSight
from slipstitch.images.warp_arrays import warp_array


@dataclass(frozen=True)
class MirroredRays:
    """The rays that meet mirrored cloth, pixel by pixel, and the blur of what they see.

    Attributes
    ----------
    uv : ndarray (N, 2)
        Where on the cloth.
    starts : ndarray (pixels^2 + 1,) int
        The first ray of each pixel of the image and its margin.
    weights : ndarray (L, pixels, pixels) float32
        Of the blur.
    squeeze : float
    count : ndarray (pixels, pixels) float32
        Number of rays, blurred.
    margin : int
    """

    uv: np.ndarray
    starts: np.ndarray
    weights: np.ndarray
    squeeze: float
    count: np.ndarray
    margin: int


def mirrored_rays(sight: MirroredSight) -> MirroredRays:
    """Sort the rays by pixel."""
    lit = np.flatnonzero(~sight.lying)
    side = len(sight.width)
    y, x = np.divmod(sight.seen[lit], side * sight.rays)
    pixel = (y // sight.rays) * side + x // sight.rays
    order = np.argsort(pixel, kind="stable")
    starts = np.searchsorted(pixel[order], np.arange(side**2 + 1))
    weights = blur_weights(sight.width, GGX)
    count = np.diff(starts).reshape(side, side, 1).astype(np.float32)
    count = blurred(count, weights, sight.squeeze)
    uv = sight.uv[lit[order]]
    return MirroredRays(uv, starts, weights, sight.squeeze, count, sight.margin)


def mirrored_albedo(rays: MirroredRays, texel: wp.array, texels: np.ndarray) -> np.ndarray:
    """Mean albedo (pixels, pixels, 3) of the cloth reflected in each floor pixel.

    Parameters
    ----------
    rays : MirroredRays
    texel : Warp array (N,) int
        Number of each ray's texel.
    texels : ndarray (M, 3)
    """
    image = np.zeros((*rays.count.shape[:2], 3), np.float32)
    inputs = [warp_array(rays.starts, wp.int32), texel, warp_array(texels, wp.vec3)]
    flat = warp_array(image.reshape(-1, 3), wp.vec3)
    wp.launch(_add_albedos, dim=len(rays.starts) - 1, inputs=[*inputs, flat], device="cpu")
    inside = np.s_[rays.margin : -rays.margin,] * 2
    image, count = blurred(image, rays.weights, rays.squeeze)[inside], rays.count[inside]
    mean = image.sum(axis=(0, 1)) / max(float(count.sum()), 1e-6)
    return np.where(count > 1e-2, image / np.maximum(count, 1e-2), mean)


@wp.kernel(enable_backward=False)
def _add_albedos(
    starts: wp.array(dtype=wp.int32),
    texel: wp.array(dtype=wp.int32),
    texels: wp.array(dtype=wp.vec3),
    image: wp.array(dtype=wp.vec3),
):
    """Sum of the albedos that one pixel's rays see."""
    pixel = wp.tid()
    total = wp.vec3()
    for ray in range(starts[pixel], starts[pixel + 1]):
        total += texels[texel[ray]]
    image[pixel] = total
