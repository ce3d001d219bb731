"""Put any texture on the cloth of one shading render (`slipstitch.render.shading`).

The albedo of the point that a ray sees is the texture's; that of other points that light came by is
taken as the texture's mean nearby (on the cloth) or all over (on the floor). A floor that mirrors
adds a third kind of point: cloth that is seen in it, whose light of each order comes from the
shading render and whose texture from `slipstitch.render.reflection`. No Blender is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from slipstitch.render.reflection import MirroredSight, mirrored_albedo
from slipstitch.render.shading import LIGHT_OVERSAMPLING, Shading, Sight
from slipstitch.render.textures import TEXELS, texture

# What lit a fold lies about this far away on the cloth.
_NEIGHBOURHOOD = 0.12
_COARSE_TEXELS = 64
_BLUR_PER_RAY = 0.34
_TEXTURE_BLURS = (0.35, 0.5, 0.7, 1.0)


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
    mirrored : ndarray (2, pixels^2), optional
        First- and second-order light that the floor mirrors.
    sight : MirroredSight, optional
        What cloth it mirrors.
    """

    pixels: int
    still: np.ndarray
    pixel: np.ndarray
    uv: np.ndarray
    light: np.ndarray
    mirrored: np.ndarray | None = None
    sight: MirroredSight | None = None


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
    return Layers(
        pixels,
        shading.still.reshape(3, -1),
        pixel[order],
        sight.cloth.uv[order],
        light[:, order],
        mirrored,
        sight.mirrored,
    )


def _texture_blur(rays: int) -> float:
    """Standard deviation (texels) that spreads a texture over what one of so many rays stands for.

    Rays that sample single texels would alias; the factor is what a fit to direct renders gave.
    """
    wanted = _BLUR_PER_RAY * TEXELS / np.sqrt(max(rays, 1))
    return min(_TEXTURE_BLURS, key=lambda blur: abs(blur - wanted))


@cache
def _prepared(name: str, blur: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A texture's texels (3, M), its neighbourhood means (3, 64^2) and its mean (3,)."""
    full = texture(name)
    coarse = cv2.resize(full, (_COARSE_TEXELS,) * 2, interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(
        coarse, (0, 0), _NEIGHBOURHOOD * _COARSE_TEXELS, borderType=cv2.BORDER_REFLECT
    )
    fine = cv2.GaussianBlur(full, (0, 0), blur, borderType=cv2.BORDER_REFLECT)
    # A plane for each colour: gathering from and summing along planes is twice as fast.
    planes = (np.ascontiguousarray(image.reshape(-1, 3).T) for image in (fine, coarse))
    return *planes, full.mean(axis=(0, 1))


def _texel(uv: np.ndarray, texels: int) -> np.ndarray:
    column, row = np.clip((uv * texels).astype(np.int64), 0, texels - 1).T
    return row * texels + column


def compose(layers: Layers, names: list[str]) -> list[np.ndarray]:
    """The frame with each of these textures, as 8-bit sRGB images (pixels, pixels, 3)."""
    return [encode_srgb(light) for light in compose_light(layers, names)]


def compose_light(layers: Layers, names: list[str]) -> Iterator[np.ndarray]:
    """The frame with each of these textures, as linear light (pixels, pixels, 3)."""
    texel, coarse_texel = _texel(layers.uv, TEXELS), _texel(layers.uv, _COARSE_TEXELS)
    if layers.mirrored is not None:
        mirrored_texel = _texel(layers.sight.uv, TEXELS)
    scene, first, second = layers.light
    pixel, start = np.unique(layers.pixel, return_index=True)
    by_pixel = np.add.reduceat(scene, start) if len(pixel) else scene
    blur = _texture_blur(len(layers.pixel))
    for name in names:
        fine, coarse, mean = _prepared(name, blur)
        linear = layers.still[1:].T @ np.stack([mean, mean**2]) + layers.still[0][:, None]
        for colour in range(3 if len(pixel) else 0):
            value = coarse[colour][coarse_texel]
            value *= second
            value += first
            value *= fine[colour][texel]
            linear[pixel, colour] += np.add.reduceat(value, start) + by_pixel
        if layers.mirrored is not None:
            seen = mirrored_albedo(layers.sight, mirrored_texel, fine).reshape(-1, 3)
            linear += (layers.mirrored[0][:, None] + layers.mirrored[1][:, None] * mean) * seen
        yield linear.reshape(layers.pixels, layers.pixels, 3)


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
