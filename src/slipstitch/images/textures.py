"""Cloth textures: the project's own, drawn by formula and seeded noise, and image files.

A texture is linear albedo over the unit square of the cloth's texture coordinates; the demo cloth
is 20 cm wide, so that 0.05 is a centimetre. Patterns are drawn with edges of a texel's width and
repeat nothing finer than about 4 mm, which the images can still resolve.
"""

import colorsys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import image_bytes
from slipstitch.config.catalogue import TEXTURE_FAMILY, TEXTURES, is_texture_file
from slipstitch.images.encoding import decode_image, decode_srgb
from slipstitch.images.surroundings import generator

TEXELS = 512
# Cloth is neither black nor a mirror of all light; the interreflection is resolved up to 0.8.
_DARKEST, _LIGHTEST = 0.02, 0.80
#: Textures kept in memory: those of a simulation's film from two viewpoints.
KEPT = 16


def worn_texture(name: str, seed: int, simulation: str, viewpoint: str) -> str:
    """What `texture` takes for the cloth of a film: a name, of the family with a drawn number."""
    if name not in TEXTURE_FAMILY:
        return name
    return f"{name}:{generator(seed, simulation, viewpoint, name, 'cloth').integers(2**32)}"


@lru_cache(KEPT)
def texture(name: str) -> np.ndarray:
    """Linear albedo (512, 512, 3) float32 of a texture, in [0.02, 0.8], read-only.

    Row 0 is at v = 0 (the cloth's upper edge), column 0 at u = 0. `name` is one of
    `slipstitch.config.catalogue.TEXTURES`, an image file (sRGB), or of `worn_texture`; else
    BadInput.
    """
    member, _, number = name.partition(":")
    centres = (np.arange(TEXELS) + 0.5) / TEXELS
    u, v = np.meshgrid(centres, centres)
    if member in TEXTURE_FAMILY:
        srgb = _drawn_cloth(u, v, np.random.default_rng(int(number)))
    elif file := texture_file(name):
        srgb = _read(file)
    else:
        srgb = _DRAWINGS[name](u, v, np.random.default_rng(TEXTURES[name]))
    albedo = np.clip(decode_srgb(srgb), _DARKEST, _LIGHTEST).astype(np.float32)
    albedo.setflags(write=False)
    return albedo


def texture_file(name: str) -> Path | None:
    """The image file that a texture is read from, None if it is drawn; BadInput if neither."""
    if name in TEXTURES or name in TEXTURE_FAMILY:
        return None
    path = Path(name)
    if not is_texture_file(name):
        raise BadInput(f"unknown texture {name!r}; known: {', '.join(TEXTURES)}, or image files")
    if not path.is_file():
        raise BadInput(f"{path}: no such texture file")
    return path


def _read(path: Path) -> np.ndarray:
    """An image file as sRGB values (512, 512, 3) in 0 ... 1, its upper edge the cloth's."""
    image = decode_image(image_bytes(path), str(path))
    size = (TEXELS, TEXELS)
    shrinks = min(image.shape[:2]) >= TEXELS
    how = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return np.clip(cv2.resize(image, size, interpolation=how)[..., ::-1] / 255.0, 0, 1)


def _colour(code: str) -> np.ndarray:
    return np.array([int(code[k : k + 2], 16) / 255 for k in (0, 2, 4)])


def _mix(below: np.ndarray, above: np.ndarray, share: np.ndarray) -> np.ndarray:
    share = np.clip(share, 0, 1)[..., None]
    return below * (1 - share) + above * share


def _step(x: np.ndarray, width: float = 1.5 / TEXELS) -> np.ndarray:
    """0 below zero, 1 above, linear over `width`."""
    return np.clip(x / width + 0.5, 0, 1)


def _wave(x: np.ndarray, period: float, duty: float = 0.5) -> np.ndarray:
    """1 on the first `duty` of every period, 0 on the rest, with soft edges."""
    phase = np.mod(x, period)
    return _step(np.minimum(phase, duty * period - phase)) + _step(phase - period)


def _noise(rng: np.random.Generator, cells_u: int, cells_v: int) -> np.ndarray:
    """Smooth noise in about [-1, 1]: random values on a lattice, smoothly joined."""

    def axis(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        place = (np.arange(TEXELS) + 0.5) / TEXELS * cells
        low = np.floor(place).astype(int)
        t = place - low
        return low, low + 1, t * t * (3 - 2 * t)

    values = rng.uniform(-1, 1, (cells_v + 1, cells_u + 1))
    left, right, t = axis(cells_u)
    across = values[:, left] * (1 - t) + values[:, right] * t
    left, right, t = axis(cells_v)
    return across[left] * (1 - t[:, None]) + across[right] * t[:, None]


def _stripes(u, v, rng):
    cloth = _mix(_colour("f2ead8"), _colour("1d3f72"), _wave(u, 0.16, 0.5))
    return _mix(cloth, _colour("b5342c"), _wave(u + 0.05, 0.16, 0.12))


def _checks(u, v, rng):
    # Gingham: warp and weft each half dyed, so that three tones appear.
    share = (_wave(u, 0.2) + _wave(v, 0.2)) / 2
    return _mix(_colour("f5f3ee"), _colour("2f7d4f"), share)


def _tartan(u, v, rng):
    cloth = np.broadcast_to(_colour("7e1a1f"), (*u.shape, 3))
    for x in (u, v):
        cloth = _mix(cloth, _colour("12312a"), 0.62 * _wave(x - 0.04, 0.333, 0.42))
        cloth = _mix(cloth, _colour("e7c64b"), 0.75 * _wave(x - 0.235, 0.333, 0.07))
        cloth = _mix(cloth, _colour("e9e6e0"), 0.55 * _wave(x - 0.285, 0.333, 0.05))
    return cloth


def _spots(x, y, pitch, radius, offset):
    """Round spots; every second row is set off by a part of the pitch."""
    offset = offset * np.mod(np.floor(y / pitch), 2)
    from_centre = np.hypot(np.mod(x / pitch + offset, 1) - 0.5, np.mod(y / pitch, 1) - 0.5)
    return _step(radius - from_centre, 1.5 / TEXELS / pitch)


def _dots(u, v, rng):
    return _mix(_colour("274b8c"), _colour("f4efe2"), _spots(u, v, 0.125, 0.3, 0.5))


def _woven(x, y, thread, repeat, over, top):
    """1 where a dark thread, half of each, shows; the warp is on top `top` of `over` times."""
    i, j = np.floor(x / thread).astype(int), np.floor(y / thread).astype(int)
    warp_on_top = np.mod(i + j, over) < top
    half = repeat / 2
    return np.where(warp_on_top, np.mod(i, repeat) < half, np.mod(j, repeat) < half).astype(float)


def _houndstooth(u, v, rng):
    # A 2/2 twill of four dark and four light threads each way.
    return _mix(_colour("efe9dc"), _colour("26221f"), _woven(u, v, 0.025, 8, 4, 2))


def _floral(u, v, rng):
    cloth = _mix(_colour("e8d9c0"), _colour("d3bfa0"), 0.5 + 0.5 * _noise(rng, 9, 9))
    for code, count, size in (("55733f", 26, 0.05), ("b23a57", 16, 0.075), ("e0a63a", 14, 0.055)):
        for _ in range(count):
            x, y, turn = rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(0, 2 * np.pi)
            radius = size * rng.uniform(0.7, 1.2)
            petals = 2 if code == "55733f" else 5
            # Only the flower's own square of the cloth.
            (left, right), (top, bottom) = (
                np.clip(np.rint(np.array([at - radius, at + radius]) * TEXELS), 0, TEXELS)
                for at in (x, y)
            )
            square = np.s_[int(top) : int(bottom), int(left) : int(right)]
            across, down = u[square] - x, v[square] - y
            edge = radius * (0.6 + 0.4 * np.cos(petals * (np.arctan2(down, across) + turn)))
            distance = np.hypot(across, down)
            patch = _mix(cloth[square], _colour(code), _step(edge - distance, 0.006))
            if petals == 5:
                patch = _mix(patch, _colour("f3e3a1"), _step(0.22 * radius - distance, 0.006))
            cloth[square] = patch
    return cloth


def _denim(u, v, rng):
    twill = 0.5 + 0.5 * np.cos(2 * np.pi * (u + v) / 0.028)
    fade = 0.5 + 0.35 * _noise(rng, 60, 7) + 0.25 * _noise(rng, 8, 8) + 0.2 * _noise(rng, 90, 90)
    cloth = _mix(_colour("1c2f52"), _colour("7f9cc4"), 0.30 * twill + 0.55 * fade)
    seam = _wave(u - 0.235, 0.53, 0.014) + _wave(u - 0.275, 0.53, 0.014)
    return _mix(cloth, _colour("c98d3c"), seam * _wave(v, 0.025, 0.66))


def _linen(u, v, rng):
    weft = 0.6 * _noise(rng, 10, 64) + 0.4 * _noise(rng, 24, 110)
    warp = 0.6 * _noise(rng, 64, 10) + 0.4 * _noise(rng, 110, 24)
    cloth = _mix(_colour("8f7a58"), _colour("d9c9a6"), 0.55 + 0.4 * (weft + warp))
    return _mix(cloth, _colour("a5482f"), 0.8 * _wave(v - 0.82, 1.0, 0.06))


def _chevron(u, v, rng):
    zigzag = 0.09 * np.abs(np.mod(u / 0.18, 1) * 2 - 1)
    cloth = _mix(_colour("e6e1d3"), _colour("5b2a6e"), _wave(v + zigzag, 0.11))
    return _mix(cloth, _colour("2a8f92"), _wave(v + zigzag + 0.02, 0.22, 0.16))


def _drawn_cloth(u, v, rng):
    """A cloth of random pattern: one, or two over one another, on a mottled ground."""
    pale = rng.uniform() < 0.25
    ground = _drawn_colour(rng, (0.85, 0.98), 0.2) if pale else _drawn_colour(rng)
    cloth = np.broadcast_to(ground, (*u.shape, 3))
    mottle = _noise(rng, *rng.integers(3, 80, 2)) + _noise(rng, *rng.integers(3, 80, 2))
    cloth = _mix(cloth, _drawn_colour(rng), 0.5 * rng.uniform(0, 0.25) * (1 + mottle))
    for _ in range(rng.choice(3, p=[0.1, 0.5, 0.4])):
        share = _PATTERNS[rng.integers(len(_PATTERNS))](*_turned(u, v, rng), rng)
        if rng.uniform() < 0.5:
            values = (0.7, 0.97) if ground.max() < 0.5 else (0.08, 0.4)
            cloth = _mix(cloth, _drawn_colour(rng, values), rng.uniform(0.6, 1) * share)
        else:
            cloth = _mix(cloth, _drawn_colour(rng), rng.uniform(0.15, 1) * share)
    return cloth


def _drawn_colour(rng, values=(0.08, 0.97), most_saturated=1.0):
    """A colour in sRGB; its largest channel is drawn from `values`."""
    # Cloth is often grey, seldom saturated.
    saturation = most_saturated * rng.uniform() ** 1.5
    hue, value = rng.uniform(), rng.uniform(*values)
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value))


def _turned(u, v, rng):
    """Coordinates along the threads, or across the cloth at any angle, from any origin."""
    angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)])
    cos, sin = np.cos(angle), np.sin(angle)
    return cos * u + sin * v + rng.uniform(), cos * v - sin * u + rng.uniform()


def _period(rng, least=0.03, most=0.35):
    return np.exp(rng.uniform(np.log(least), np.log(most)))


def _drawn_stripes(x, y, rng):
    return _wave(x, _period(rng), rng.uniform(0.1, 0.6))


def _drawn_checks(x, y, rng):
    duty = rng.uniform(0.1, 0.6)
    across = _period(rng)
    down = across if rng.uniform() < 0.7 else _period(rng)
    return (_wave(x, across, duty) + _wave(y, down, duty)) / 2


def _drawn_dots(x, y, rng):
    return _spots(x, y, _period(rng, 0.04), rng.uniform(0.15, 0.42), rng.choice([0, 0.5]))


def _drawn_zigzag(x, y, rng):
    period = _period(rng, 0.06)
    zigzag = rng.uniform(0.2, 0.8) * period * np.abs(np.mod(x / _period(rng), 1) * 2 - 1)
    return _wave(y + zigzag, period, rng.uniform(0.2, 0.6))


def _drawn_blotches(x, y, rng):
    cells = rng.integers(4, 24)
    shape = _noise(rng, cells, rng.integers(4, 24)) + 0.5 * _noise(rng, 2 * cells, 2 * cells)
    return _step(shape - rng.uniform(-0.2, 0.5), rng.uniform(0.05, 0.8))


def _drawn_weave(x, y, rng):
    thread, repeat = _period(rng, 0.02, 0.05), rng.integers(2, 9)
    return _woven(x, y, thread, repeat, rng.integers(2, 5), 1 + rng.integers(2))


_PATTERNS: tuple[Callable, ...] = (
    *(_drawn_stripes, _drawn_checks, _drawn_dots),
    *(_drawn_zigzag, _drawn_blotches, _drawn_weave),
)
# By name; all but a few draw nothing at random.
_DRAWINGS = {
    draw.__name__.removeprefix("_"): draw
    for draw in (
        *(_stripes, _checks, _tartan, _dots, _houndstooth),
        *(_floral, _denim, _linen, _chevron),
    )
}
