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
rays a pixel (`slipstitch.render.visibility`).
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from slipstitch.render.camera import Camera
from slipstitch.render.textures import texture
from slipstitch.render.visibility import TILE, sees_quad, visible_cloth

#: The shading render has this many times the pixels of the image along each side.
LIGHT_OVERSAMPLING = 2
# Rays per pixel along each side that ask what is seen.
_RAYS = TILE
_LIGHT_STEP = _RAYS // LIGHT_OVERSAMPLING

# Smoothing of the light, in pixels of the shading render, and in texture coordinates.
_FLOOR_BLUR = 0.8
_CLOTH_BLUR = 1.2
_CLOTH_RADIUS = 2
_CLOTH_NEARBY = 0.03
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
        Pixel of each ray that meets the cloth.
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
    radiance, uv : ndarray (2 pixels, 2 pixels, 3)
        As `ClothScene.render` returns them at twice the camera's resolution.
    positions_m, faces, vertex_uv : ndarray
        The cloth's mesh.
    floor_m : ndarray (4, 3)
        Corners of the floor.
    camera : Camera
        At the resolution of the image.
    """
    light = separate(radiance)
    fine = camera.at_resolution(camera.pixels * _RAYS)
    found = visible_cloth(positions_m, faces, vertex_uv, fine)
    y, x = np.divmod(found.seen, fine.pixels)
    floor = sees_quad(floor_m, fine).astype(np.float32)
    # Light comes from pixels that see nothing but one surface.
    cover = uv[..., 2]
    on_cloth = cover > 0.999
    of_floor = _shrink(floor, _LIGHT_STEP)
    on_floor = (of_floor > 0.999) & (cover < 0.001)
    elsewhere = (of_floor < 0.001) & (cover < 0.001)
    cloth_light = _smooth_on_cloth(light, uv, on_cloth)
    floor_light = _spread(light, on_floor, _FLOOR_BLUR)

    # What is not cloth, without the rays that meet the cloth.
    other = 1 - floor
    for share in (floor, other):
        share.ravel()[found.seen] = 0
    still = floor_light * _shrink(floor, _LIGHT_STEP)
    background = np.median(light[0][elsewhere]) if elsewhere.any() else 0.0
    still[0] += background * _shrink(other, _LIGHT_STEP)
    still = np.stack([_shrink(part, LIGHT_OVERSAMPLING) for part in still])
    light = cloth_light[:, y // _LIGHT_STEP, x // _LIGHT_STEP] / _RAYS**2
    pixel = (y // _RAYS) * camera.pixels + x // _RAYS
    return Layers(camera.pixels, still.reshape(3, -1), pixel, found.uv, light)


def _shrink(image: np.ndarray, step: int) -> np.ndarray:
    """Means over blocks of step x step pixels."""
    return cv2.resize(image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)


def _spread(light: np.ndarray, where: np.ndarray, blur: float) -> np.ndarray:
    """Light (3, H, W) smoothed within a region and carried a little way out of it."""
    share = where.astype(np.float32)
    result = np.zeros_like(light, dtype=np.float32)
    # Wider and wider, so that every pixel near the region gets a value.
    for width in (4 * blur, blur):
        size = (0, 0) if width > blur else (5, 5)
        total = cv2.GaussianBlur(share, size, width)
        reached = total > 1e-3
        for k in range(3):
            part = cv2.GaussianBlur((light[k] * share).astype(np.float32), size, width)
            np.divide(part, total, out=result[k], where=reached)
    return result


def _smooth_on_cloth(light: np.ndarray, uv: np.ndarray, on_cloth: np.ndarray) -> np.ndarray:
    """Light (3, H, W) smoothed over pixels that are close both in the image and on the cloth."""
    result = _spread(light, on_cloth, _CLOTH_BLUR)
    rows, columns = np.flatnonzero(on_cloth.any(axis=1)), np.flatnonzero(on_cloth.any(axis=0))
    if not len(rows):
        return result
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    r = _CLOTH_RADIUS
    share = np.pad(on_cloth[window].astype(np.float32), r)
    values = np.pad(light[(slice(None), *window)].astype(np.float32), ((0, 0), (r, r), (r, r)))
    place = np.pad(np.moveaxis(uv[window][..., :2], -1, 0), ((0, 0), (r, r), (r, r)))
    height, width = on_cloth[window].shape
    total = np.zeros((height, width), np.float32)
    parts = np.zeros((3, height, width), np.float32)
    here = place[:, r : r + height, r : r + width]
    for dy in range(2 * r + 1):
        for dx in range(2 * r + 1):
            block = np.s_[dy : dy + height, dx : dx + width]
            apart = ((place[(slice(None), *block)] - here) ** 2).sum(axis=0)
            weight = np.exp(apart * np.float32(-1 / _CLOTH_NEARBY**2)) * share[block]
            weight *= np.float32(np.exp(-((dy - r) ** 2 + (dx - r) ** 2) / 2 / _CLOTH_BLUR**2))
            total += weight
            parts += weight * values[(slice(None), *block)]
    inside = on_cloth[window]
    result[(slice(None), *window)] = np.where(
        inside, parts / np.maximum(total, 1e-6), result[(slice(None), *window)]
    )
    return result


@cache
def _prepared(name: str, texels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A texture's texels (M, 3), its neighbourhood means (64^2, 3) and its mean (3,)."""
    full = texture(name)
    fine = cv2.resize(full, (texels, texels), interpolation=cv2.INTER_AREA)
    coarse = cv2.resize(full, (_COARSE_TEXELS,) * 2, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(
        coarse, (0, 0), _NEIGHBOURHOOD * _COARSE_TEXELS, borderType=cv2.BORDER_REFLECT
    )
    return fine.reshape(-1, 3), coarse.reshape(-1, 3), full.mean(axis=(0, 1))


def _texel(uv: np.ndarray, texels: int) -> np.ndarray:
    column, row = np.clip((uv * texels).astype(np.int64), 0, texels - 1).T
    return row * texels + column


def compose(layers: Layers, names: list[str]) -> list[np.ndarray]:
    """The frame with each of these textures, as 8-bit sRGB images (pixels, pixels, 3)."""
    # About two texels a ray where the cloth fills the image.
    texels = 256 if layers.pixels <= 96 else 512
    texel, coarse_texel = _texel(layers.uv, texels), _texel(layers.uv, _COARSE_TEXELS)
    scene, first, second = layers.light
    count = layers.pixels**2
    images = []
    for name in names:
        fine, coarse, mean = _prepared(name, texels)
        albedo = fine[texel]
        value = albedo * (first[:, None] + coarse[coarse_texel] * second[:, None]) + scene[:, None]
        linear = np.stack(
            [
                np.bincount(layers.pixel, value[:, c], count)
                + layers.still[0]
                + mean[c] * (layers.still[1] + mean[c] * layers.still[2])
                for c in range(3)
            ],
            axis=1,
        )
        images.append(encode_srgb(linear).reshape(layers.pixels, layers.pixels, 3))
    return images


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light (IEC 61966-2-1), cut off at 0 and 1."""
    linear = np.clip(linear, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)
