"""Put any texture on the cloth of one shading render.

Lamps, floor and background are grey and every surface is Lambertian, so the light that reaches a
pixel is a power series in the cloth's albedo a: with a uniform cloth,

    L(a) = scene + a first + a^2 second + ...

where `scene` never touched the cloth, `first` touched it once (the lit cloth, or its light on the
floor), `second` twice (light between folds, or from cloth to floor to cloth). One render with the
albedos 0.8, 0 and 0.4 in its three channels gives three equations a pixel:

    scene = G,   first = (4 (B - G) - (R - G)) / 0.8,   second = ((R - G) - 2 (B - G)) / 0.32

with orders above the second folded into these two so that L is exact at a = 0.4 and a = 0.8. All
three channels follow the same paths, so the solution holds path by path and adds no noise.

With a texture, the albedo of the point that the pixel sees is the texture's; that of other points
that light came by is taken as the texture's mean nearby (on the cloth) or all over (on the floor).

Light varies slowly over a surface, textures and outlines do not. So light comes from a few paths
a pixel, at twice the resolution and smoothed along the surface; what is seen where comes from 16
rays a pixel, 64 in small images (`slipstitch.render.visibility`).
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from slipstitch.render.camera import Camera
from slipstitch.render.textures import TEXELS, texture
from slipstitch.render.visibility import sees_quad, visible_cloth

#: The shading render has this many times the pixels of the image along each side.
LIGHT_OVERSAMPLING = 2

# Smoothing of the lamp's light and of the dome's, in pixels of the shading render. The lamp's has
# the edges of shadows in it, the dome's is smooth but noisier.
_FLOOR_BLUR = (0.7, 2.0)
_CLOTH_BLUR = (1.2, 2.0)
# On the cloth: this many pixels around, and weighted by nearness in texture coordinates.
_CLOTH_RADIUS = 3
_CLOTH_NEARBY = 0.06
# What lit a fold lies about this far away on the cloth.
_NEIGHBOURHOOD = 0.12
_COARSE_TEXELS = 64


@dataclass(frozen=True)
class Layers:
    """One frame, ready to be composed with any texture.

    Attributes
    ----------
    pixels : int
        Side of the image.
    still : ndarray (3, pixels^2)
        Scene, first- and second-order light of what is not cloth, averaged over each pixel.
    pixel : ndarray (N,) int
        Pixel of each ray that meets the cloth, rising.
    uv : ndarray (N, 2)
        Where on the cloth.
    light : ndarray (3, N)
        Scene, first- and second-order light there, divided by the rays per pixel.
    """

    pixels: int
    still: np.ndarray
    pixel: np.ndarray
    uv: np.ndarray
    light: np.ndarray


def separate(radiance: np.ndarray) -> np.ndarray:
    """Scene, first- and second-order light (3, ...) of a shading render (..., 3)."""
    scene = radiance[..., 1]
    high, low = radiance[..., 0] - scene, radiance[..., 2] - scene
    return np.stack([scene, (4 * low - high) / 0.8, (high - 2 * low) / 0.32])


def make_layers(
    radiance: np.ndarray,
    uv: np.ndarray,
    positions_m: np.ndarray,
    faces: np.ndarray,
    vertex_uv: np.ndarray,
    floor_m: np.ndarray,
    camera: Camera,
) -> Layers:
    """Separate a shading render and join it with what is seen where.

    Parameters
    ----------
    radiance : ndarray (2, 2 pixels, 2 pixels, 3)
    uv : ndarray (2 pixels, 2 pixels, 3)
        As `ClothScene.render` returns them at twice the camera's resolution.
    positions_m, faces, vertex_uv : ndarray
        The cloth's mesh.
    floor_m : ndarray (4, 3)
        Corners of the floor.
    camera : Camera
        At the resolution of the image.
    """
    light = np.stack([separate(part) for part in radiance])
    rays = _rays_per_side(camera.pixels)
    step = rays // LIGHT_OVERSAMPLING
    fine = camera.at_resolution(camera.pixels * rays)
    found = visible_cloth(positions_m, faces, vertex_uv, fine, rays)
    y, x = np.divmod(found.seen, fine.pixels)
    floor = sees_quad(floor_m, fine, rays).astype(np.float32)
    # Light comes from pixels that see nothing but one surface.
    cover = uv[..., 2]
    on_cloth = cover > 0.999
    of_floor = _shrink(floor, step)
    on_floor = (of_floor > 0.999) & (cover < 0.001)
    elsewhere = (of_floor < 0.001) & (cover < 0.001)
    cloth_light = _smooth_on_cloth(light, uv, on_cloth)
    floor_light = sum(map(_spread, light, (on_floor,) * 2, _FLOOR_BLUR))

    # What is not cloth, without the rays that meet the cloth.
    other = 1 - floor
    for share in (floor, other):
        share.ravel()[found.seen] = 0
    still = floor_light * _shrink(floor, step)
    background = np.median(light[:, 0].sum(axis=0)[elsewhere]) if elsewhere.any() else 0.0
    still[0] += background * _shrink(other, step)
    still = np.stack([_shrink(part, LIGHT_OVERSAMPLING) for part in still])
    light = cloth_light[:, y // step, x // step] / np.float32(rays**2)
    pixel = (y // rays) * camera.pixels + x // rays
    order = np.argsort(pixel, kind="stable")
    return Layers(
        camera.pixels, still.reshape(3, -1), pixel[order], found.uv[order], light[:, order]
    )


def _rays_per_side(pixels: int) -> int:
    """Rays along each side of a pixel: small images show more of the texture in each."""
    return 8 if pixels <= 80 else 4


def _shrink(image: np.ndarray, step: int) -> np.ndarray:
    """Means over blocks of step x step pixels."""
    return cv2.resize(image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)


def _spread(light: np.ndarray, where: np.ndarray, blur: float) -> np.ndarray:
    """Light (3, H, W) smoothed within a region and carried a little way out of it."""
    share = where.astype(np.float32)
    values = np.moveaxis(light, 0, -1).astype(np.float32) * share[..., None]
    result = np.zeros_like(values)
    # First far, then near, so that every pixel around the region gets a value.
    for smooth in (
        lambda image: cv2.blur(image, (15, 15)),
        lambda image: cv2.GaussianBlur(image, (7, 7), blur),
    ):
        total = smooth(share)[..., None]
        np.divide(smooth(values), total, out=result, where=total > 1e-3)
    return np.moveaxis(result, -1, 0)


def _smooth_on_cloth(light: np.ndarray, uv: np.ndarray, on_cloth: np.ndarray) -> np.ndarray:
    """Light (2, 3, H, W) smoothed over pixels close both in the image and on the cloth, added."""
    result = sum(map(_spread, light, (on_cloth,) * 2, _CLOTH_BLUR))
    rows, columns = np.flatnonzero(on_cloth.any(axis=1)), np.flatnonzero(on_cloth.any(axis=0))
    if not len(rows):
        return result
    window = np.s_[..., rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    inside = on_cloth[window]
    smooth = light[window].astype(np.float32)
    place = np.moveaxis(uv[window[1:]][..., :2], -1, 0) / np.float32(_CLOTH_NEARBY)
    # Along the rows, then along the columns: nearly the same as over squares, at a third the cost.
    for axis in (-1, -2):
        smooth = _smooth_along(axis, smooth, place, inside)
    result[window] = np.where(inside, smooth.sum(axis=0), result[window])
    return result


def _smooth_along(
    axis: int, light: np.ndarray, place: np.ndarray, inside: np.ndarray
) -> np.ndarray:
    share = inside.astype(np.float32)
    total = np.zeros((2, *inside.shape), np.float32)
    parts = np.zeros_like(light)
    size = inside.shape[axis]
    # Every pair of pixels that lie `step` apart, weighted both ways at once.
    for step in range(min(_CLOTH_RADIUS, size - 1) + 1):
        one, other = [slice(None)] * 2, [slice(None)] * 2
        one[axis], other[axis] = slice(0, size - step), slice(step, size)
        one, other = (..., *one), (..., *other)
        apart = place[one] - place[other]
        near = np.exp(-(apart[0] ** 2 + apart[1] ** 2)) * share[one] * share[other]
        for k, blur in enumerate(_CLOTH_BLUR):
            weight = near * np.float32(np.exp(-(step**2) / 2 / blur**2))
            for to, source in ((one, other), (other, one))[: 1 + (step > 0)]:
                total[k][to] += weight
                parts[k][to] += weight * light[k][source]
    return parts / np.maximum(total, 1e-6)[:, None]


@cache
def _prepared(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A texture's texels (M, 3), its neighbourhood means (64^2, 3) and its mean (3,)."""
    full = texture(name)
    coarse = cv2.resize(full, (_COARSE_TEXELS,) * 2, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(
        coarse, (0, 0), _NEIGHBOURHOOD * _COARSE_TEXELS, borderType=cv2.BORDER_REFLECT
    )
    return full.reshape(-1, 3), coarse.reshape(-1, 3), full.mean(axis=(0, 1))


def _texel(uv: np.ndarray, texels: int) -> np.ndarray:
    column, row = np.clip((uv * texels).astype(np.int64), 0, texels - 1).T
    return row * texels + column


def compose(layers: Layers, names: list[str]) -> list[np.ndarray]:
    """The frame with each of these textures, as 8-bit sRGB images (pixels, pixels, 3)."""
    texel, coarse_texel = _texel(layers.uv, TEXELS), _texel(layers.uv, _COARSE_TEXELS)
    scene, first, second = layers.light[..., None]
    pixel, start = np.unique(layers.pixel, return_index=True)
    images = []
    for name in names:
        fine, coarse, mean = _prepared(name)
        linear = layers.still[1:].T @ np.stack([mean, mean**2]) + layers.still[0][:, None]
        if len(pixel):
            value = coarse[coarse_texel]
            value *= second
            value += first
            value *= fine[texel]
            value += scene
            linear[pixel] += np.add.reduceat(value, start, axis=0)
        images.append(encode_srgb(linear).reshape(layers.pixels, layers.pixels, 3))
    return images


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light (IEC 61966-2-1), cut off at 0 and 1."""
    # In steps of 2^-16 the encoding moves by less than 0.06 of an 8-bit level.
    steps = np.rint(np.clip(linear, 0, 1) * (len(_SRGB) - 1)).astype(np.int64)
    return _SRGB[steps]


def _srgb_table() -> np.ndarray:
    linear = np.linspace(0, 1, 2**16 + 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


_SRGB = _srgb_table()
