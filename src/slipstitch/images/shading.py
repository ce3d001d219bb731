"""The light of one frame, separated by the number of bounces on the cloth, and visibility.

Lamps, floor and background are grey and the cloth is Lambertian, so the light that reaches a pixel
is a power series in the albedo a of a uniform cloth, L(a) = scene + a first + a^2 second + ...,
where `scene` never touched the cloth, `first` touched it once, `second` twice (light between folds,
or from cloth to floor to cloth). One render with the albedos 0.8, 0 and 0.4 in its three channels
gives three equations a pixel: scene = G, first = (4 (B - G) - (R - G)) / 0.8, second = ((R - G) - 2
(B - G)) / 0.32, with higher orders folded in so that L is exact at a = 0.4 and a = 0.8. All three
channels follow the same paths, so the solution holds path by path and adds no noise.

Light varies slowly over a surface, textures and outlines do not. So light comes from a few paths a
pixel, at twice the resolution and smoothed along the surface; what is seen where comes from 16 rays
per pixel, 64 in small images (`slipstitch.images.visibility`). `slipstitch.images.composition`
joins the two and puts textures on.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.images import reflection
from slipstitch.images.camera import Camera
from slipstitch.images.reflection import MirroredSight, spread
from slipstitch.images.surroundings import FLOOR_M, Surroundings
from slipstitch.images.visibility import Visibility, sees_quad, visible_cloth

#: The shading render has this many times the pixels of the image along each side.
LIGHT_OVERSAMPLING = 2

# Smoothing of the lamp's light and of the dome's, in pixels of the shading render. The lamp's has
# the edges of shadows in it, the dome's is smooth but noisier.
_FLOOR_BLUR = (0.7, 2.0)
_CLOTH_BLUR = (1.2, 2.0)
# Of light that the cloth casts onto a reflective floor.
_CLOTH_LIGHT_BLUR = 1.4
# On the cloth: this many pixels around, and weighted by nearness in texture coordinates.
_CLOTH_RADIUS = 3
_CLOTH_NEARBY = 0.06


@dataclass(frozen=True)
class Sight:
    """Visibility of the rays of one frame."""

    rays: int  # along each side of a pixel
    cloth: Visibility  # of the rays
    floor: np.ndarray  # (rays pixels, rays pixels) bool: the rays that see the floor
    mirrored: MirroredSight | None  # on a reflective floor


@dataclass(frozen=True)
class Shading:
    """One frame's light, separated and smoothed: all that composing needs of Blender."""

    # (3, pixels, pixels): scene, first- and second-order light of what is not cloth, averaged over
    # each pixel
    still: np.ndarray
    cloth: np.ndarray  # (3, 2 pixels, 2 pixels): the same of the cloth, where there is any
    # (2, pixels, pixels): first- and second-order light reflected by the floor
    mirrored: np.ndarray | None = None


def separate(radiance: np.ndarray) -> np.ndarray:
    """Scene, first- and second-order light (3, ...) of a shading render (..., 3)."""
    scene = radiance[..., 1]
    high, low = radiance[..., 0] - scene, radiance[..., 2] - scene
    return np.stack([scene, (4 * low - high) / 0.8, (high - 2 * low) / 0.32])


def look(
    positions_m: np.ndarray,
    faces: np.ndarray,
    vertex_uv: np.ndarray,
    camera: Camera,
    surroundings: Surroundings,
) -> Sight:
    """Visibility of the rays of an image, of the cloth and the floor."""
    rays = _rays_per_side(camera.pixels)
    fine = camera.at_resolution(camera.pixels * rays)
    mesh = (positions_m, faces, vertex_uv)
    cloth, floor = visible_cloth(*mesh, fine, rays), sees_quad(FLOOR_M, fine, rays)
    mirrored = None
    if surroundings.reflects:
        mirrored = reflection.mirrored_sight(*mesh, surroundings, cloth, camera, rays)
    return Sight(rays, cloth, floor, mirrored)


def separated_light(
    radiance: np.ndarray, uv: np.ndarray, glossy: np.ndarray | None, sight: Sight
) -> Shading:
    """Separate and smooth what `ClothScene.render` returns at twice the camera's resolution."""
    light = np.stack([separate(part) for part in radiance])
    step = sight.rays // LIGHT_OVERSAMPLING
    floor = sight.floor.astype(np.float32)
    # Light comes from pixels that see nothing but one surface.
    cover = uv[..., 2]
    on_cloth = cover > 0.999
    of_floor = _shrink(floor, step)
    on_floor = (of_floor > 0.999) & (cover < 0.001)
    elsewhere = (of_floor < 0.001) & (cover < 0.001)
    cloth_light = _smooth_on_cloth(light, uv, on_cloth)
    mirrored = None
    if glossy is None or sight.mirrored is None:
        floor_light = sum(map(spread, light, (on_floor,) * 2, _FLOOR_BLUR))
    else:
        mirrored, floor_light = _light_of_mirror(light, separate(glossy), on_floor, sight.mirrored)

    # What is not cloth, without the rays that meet the cloth.
    other = 1 - floor
    for share in (floor, other):
        share.ravel()[sight.cloth.seen] = 0
    share = _shrink(floor, step)
    still = floor_light * share
    background = np.median(light[:, 0].sum(axis=0)[elsewhere]) if elsewhere.any() else 0.0
    still[0] += background * _shrink(other, step)
    still = np.stack([_shrink(part, LIGHT_OVERSAMPLING) for part in still])
    if mirrored is not None:
        mirrored = np.stack([_shrink(part * share, LIGHT_OVERSAMPLING) for part in mirrored])
    return Shading(still, cloth_light, mirrored)


def _light_of_mirror(
    light: np.ndarray, glossy: np.ndarray, on_floor: np.ndarray, sight: MirroredSight
) -> tuple[np.ndarray, np.ndarray]:
    """Light (2, H, W) of the mirrored cloth, and all other light (3, H, W) of the floor."""
    shares = reflection.mirror_shares(sight, LIGHT_OVERSAMPLING)
    camera = sight.camera.at_resolution(sight.camera.pixels * LIGHT_OVERSAMPLING)
    scene, by_cloth = glossy[0], glossy[1:]
    mirrored = reflection.smooth_mirrored_light(by_cloth, on_floor, shares, sight.squeeze)
    # What the floor scatters has the edges of shadows in it, and so has the lamp's glint; what it
    # mirrors of the dome has those of the mirrored cloth.
    dome = scene - light[0, 0] * reflection.glint_share(sight.surroundings, camera)
    still = spread(light[0, :1], on_floor, _FLOOR_BLUR[0])
    still += spread(light[1, :1] - dome, on_floor, _FLOOR_BLUR[1])
    still += reflection.smooth_beside(dome, on_floor, shares.cloth)
    thrown = spread(light[:, 1:].sum(axis=0) - by_cloth, on_floor, _CLOTH_LIGHT_BLUR)
    return mirrored, np.concatenate([still, thrown])


def _rays_per_side(pixels: int) -> int:
    """Rays along each side of a pixel: small images show more of the texture in each."""
    return 8 if pixels <= 80 else 4


def _shrink(image: np.ndarray, step: int) -> np.ndarray:
    return cv2.resize(image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)


def _smooth_on_cloth(light: np.ndarray, uv: np.ndarray, on_cloth: np.ndarray) -> np.ndarray:
    """Light (2, 3, H, W) smoothed over pixels close both in the image and on the cloth, added."""
    result = np.sum([*map(spread, light, (on_cloth,) * 2, _CLOTH_BLUR)], axis=0)
    left, top, columns, rows = cv2.boundingRect(on_cloth.astype(np.uint8))
    if not rows:
        return result
    window = np.s_[..., top : top + rows, left : left + columns]
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
        ends = slice(0, size - step), slice(step, size)
        one, other = ((..., end) if axis == -1 else (..., end, slice(None)) for end in ends)
        apart = place[one] - place[other]
        near = np.exp(-(apart[0] ** 2 + apart[1] ** 2)) * share[one] * share[other]
        for k, blur in enumerate(_CLOTH_BLUR):
            weight = near * np.float32(np.exp(-(step**2) / 2 / blur**2))
            for to, source in ((one, other), (other, one))[: 1 + (step > 0)]:
                total[k][to] += weight
                parts[k][to] += weight * light[k][source]
    return parts / np.maximum(total, 1e-6)[:, None]
