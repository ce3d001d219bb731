"""Apply any texture to the cloth of one shading render (`slipstitch.images.shading`).

The albedo of the point that a ray sees is the texture's; that of other points that light came by is
taken as the texture's mean nearby (on the cloth) or all over (on the floor). A reflective floor
adds a third kind of point: cloth that is seen in it, whose light of each order comes from the
shading render. No Blender is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import warp as wp

from slipstitch.images.reflection import GGX, MARGIN, MirroredSight, blur_weights, blurred
from slipstitch.images.shading import LIGHT_OVERSAMPLING, Shading, Sight
from slipstitch.images.textures import KEPT, TEXELS, texture
from slipstitch.images.visibility import warp_array

# What lit a fold lies about this far away on the cloth.
_NEIGHBOURHOOD = 0.12
_COARSE_TEXELS = 64
_BLUR_PER_RAY = 0.34
_TEXTURE_BLURS = (0.35, 0.5, 0.7, 1.0)


@dataclass(frozen=True)
class MirroredRays:
    """The rays that meet mirrored cloth, pixel by pixel, and the blur of what they see."""

    uv: np.ndarray  # (N, 2): where on the cloth
    # (pixels^2 + 1,) int: the first ray of each pixel of the image and its margin
    starts: np.ndarray
    weights: np.ndarray  # (L, pixels, pixels) float32: of the blur
    squeeze: float
    count: np.ndarray  # (pixels, pixels) float32: number of rays, blurred


@dataclass(frozen=True)
class Layers:
    """One frame, ready to be composed with any texture."""

    pixels: int  # side of the image
    still: np.ndarray  # (3, pixels^2): `Shading.still`
    pixel: np.ndarray  # (N,) int: pixel of each ray that meets the cloth, rising
    uv: np.ndarray  # (N, 2): where on the cloth
    # (3, N): scene, first- and second-order light there, divided by the rays per pixel
    light: np.ndarray
    # (2, pixels^2): first- and second-order light reflected by the floor
    mirrored: np.ndarray | None = None
    rays: MirroredRays | None = None  # the cloth in its reflection


def join(shading: Shading, sight: Sight) -> Layers:
    """A frame's light at what its rays see."""
    pixels = shading.still.shape[-1]
    rays = sight.rays
    step = rays // LIGHT_OVERSAMPLING
    y, x = np.divmod(sight.cloth.seen, pixels * rays)
    light = shading.cloth[:, y // step, x // step] / np.float32(rays**2)
    pixel = (y // rays) * pixels + x // rays
    order = np.argsort(pixel, kind="stable")
    mirrored = None if shading.mirrored is None else shading.mirrored.reshape(2, -1)
    reflected = None if sight.mirrored is None else _mirrored_rays(sight.mirrored)
    rays_seen = pixel[order], sight.cloth.uv[order], light[:, order]
    return Layers(pixels, shading.still.reshape(3, -1), *rays_seen, mirrored, reflected)


def _texture_blur(rays: int) -> float:
    """Blur (texels) that spreads a texture over a ray's area; fitted to direct renders."""
    wanted = _BLUR_PER_RAY * TEXELS / np.sqrt(max(rays, 1))
    return min(_TEXTURE_BLURS, key=lambda blur: abs(blur - wanted))


@lru_cache(2 * KEPT)
def _prepared(name: str, blur: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A texture's texels (M, 3), its neighbourhood means (64^2, 3) and its mean (3,)."""
    full = texture(name)
    coarse = cv2.resize(full, (_COARSE_TEXELS,) * 2, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(
        coarse, (0, 0), _NEIGHBOURHOOD * _COARSE_TEXELS, borderType=cv2.BORDER_REFLECT
    )
    fine = cv2.GaussianBlur(full, (0, 0), blur, borderType=cv2.BORDER_REFLECT)
    return fine.reshape(-1, 3), coarse.reshape(-1, 3), full.mean(axis=(0, 1))


def _texel(uv: np.ndarray, texels: int) -> np.ndarray:
    column, row = np.clip((uv * texels).astype(np.int64), 0, texels - 1).T
    return row * texels + column


def compose_light(layers: Layers, names: list[str]) -> Iterator[np.ndarray]:
    """The frame with each of these textures, as linear light (pixels, pixels, 3)."""
    texel = [_texel(layers.uv, texels) for texels in (TEXELS, _COARSE_TEXELS)]
    texel = warp_array(np.column_stack(texel), wp.vec2i)
    light = warp_array(layers.light.T, wp.vec3)
    still = warp_array(layers.still.T, wp.vec3)
    starts = warp_array(np.searchsorted(layers.pixel, np.arange(layers.pixels**2 + 1)), wp.int32)
    if layers.mirrored is not None:
        mirrored_texel = warp_array(_texel(layers.rays.uv, TEXELS), wp.int32)
    blur = _texture_blur(len(layers.pixel))
    for name in names:
        fine, coarse, mean = _prepared(name, blur)
        linear = np.empty((layers.pixels**2, 3), np.float32)
        lights = [still, wp.vec3(*mean), starts, texel, light]
        albedos = [warp_array(albedo, wp.vec3) for albedo in (fine, coarse, linear)]
        wp.launch(_light_pixel, dim=len(linear), inputs=[*lights, *albedos], device="cpu")
        if layers.mirrored is not None:
            seen = _mirrored_albedo(layers.rays, mirrored_texel, fine).reshape(-1, 3)
            linear += (layers.mirrored[0][:, None] + layers.mirrored[1][:, None] * mean) * seen
        yield linear.reshape(layers.pixels, layers.pixels, 3)


@wp.kernel(enable_backward=False)
def _light_pixel(
    still: wp.array(dtype=wp.vec3),
    mean: wp.vec3,
    starts: wp.array(dtype=wp.int32),
    texel: wp.array(dtype=wp.vec2i),
    light: wp.array(dtype=wp.vec3),
    fine: wp.array(dtype=wp.vec3),
    coarse: wp.array(dtype=wp.vec3),
    linear: wp.array(dtype=wp.vec3),
):
    """Light of one pixel: of what is not cloth, and of the cloth that its rays see."""
    pixel = wp.tid()
    total = _series(still[pixel], mean, mean)
    for ray in range(starts[pixel], starts[pixel + 1]):
        total += _series(light[ray], fine[texel[ray][0]], coarse[texel[ray][1]])
    linear[pixel] = total


@wp.func
def _series(orders: wp.vec3, albedo: wp.vec3, nearby: wp.vec3) -> wp.vec3:
    """Light that met the cloth never, once and twice, the second time at points nearby."""
    ones = wp.vec3(1.0, 1.0, 1.0)
    return ones * orders[0] + wp.cw_mul(albedo, ones * orders[1] + nearby * orders[2])


def _mirrored_rays(sight: MirroredSight) -> MirroredRays:
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
    return MirroredRays(uv, starts, weights, sight.squeeze, count)


def _mirrored_albedo(rays: MirroredRays, texel: wp.array, texels: np.ndarray) -> np.ndarray:
    """Mean albedo (pixels, pixels, 3) of the cloth reflected in each floor pixel."""
    image = np.zeros((*rays.count.shape[:2], 3), np.float32)
    inputs = [warp_array(rays.starts, wp.int32), texel, warp_array(texels, wp.vec3)]
    flat = warp_array(image.reshape(-1, 3), wp.vec3)
    wp.launch(_add_albedos, dim=len(rays.starts) - 1, inputs=[*inputs, flat], device="cpu")
    inside = np.s_[MARGIN:-MARGIN,] * 2
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
