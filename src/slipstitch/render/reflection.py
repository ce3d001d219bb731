"""The cloth mirrored in the floor: which point of it, how blurred, and its texture there.

Blender renders how much light of each order the floor mirrors towards the camera, with the true
distribution of slopes; only the texture on that light is put on here. A mirror at z = 0 shows what
lies at -z, so the mirrored cloth is seen by the same rasteriser. A floor of roughness r has slopes
of about r^2 either way (GGX): a point that lies d behind the floor along the mirrored ray is
smeared over 2 r^2 d along the plane of incidence and 2 r^2 d cos(angle of incidence) across it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.render.camera import Camera
from slipstitch.render.visibility import Visibility, visible_cloth

# Widths (pixels, standard deviation, upwards in the image) between which is interpolated.
_WIDTHS = (0.0, 0.7, 1.4, 2.8, 5.6, 11.2, 22.4)
# What the tails of the slopes make of it, for a Gaussian blur of texture; and how much of that
# width the mirrored light, which is smoother than the texture, may be smoothed.
_SPREAD = 0.85
_LIGHT_SPREAD = 0.15
_LEAST_LIGHT_BLUR = 2.0
# Of the guided filter (He, Sun & Tang 2013): its reach in pixels, and its smallest edge, squared.
_GUIDED_REACH = 6
_GUIDED_EDGE = 1e-3


@dataclass(frozen=True)
class MirroredSight:
    """What the floor mirrors where.

    Attributes
    ----------
    pixel : ndarray (N,) int
        Pixel of each ray that meets the mirrored cloth on floor that it sees, rising.
    uv : ndarray (N, 2)
        Where on the cloth.
    width : ndarray (pixels, pixels) float32
        Upward standard deviation (pixels) of the blur, carried on where nothing is mirrored.
    squeeze : float
        The sideward one's share of it.
    coverage : ndarray (cells pixels, cells pixels) float32
        Share of each cell's light that the mirror takes from the cloth, before its reflectance.
    cells : int
        Along each side of a pixel.
    """

    pixel: np.ndarray
    uv: np.ndarray
    width: np.ndarray
    squeeze: float
    coverage: np.ndarray
    cells: int


def mirrored_sight(
    positions_m: np.ndarray,
    faces: np.ndarray,
    vertex_uv: np.ndarray,
    floor_z_m: float,
    roughness: float,
    on_floor: np.ndarray,
    camera: Camera,
    rays: int,
    cells: int,
) -> MirroredSight:
    """Find the mirrored cloth.

    Parameters
    ----------
    positions_m, faces, vertex_uv : ndarray
        The cloth's mesh.
    floor_z_m : float
        Height of the mirror.
    roughness : float
    on_floor : ndarray (rays pixels, rays pixels) bool
        The rays that see the floor.
    camera : Camera
        Of the image.
    rays, cells : int
        Rays and cells along each side of a pixel.
    """
    fine = camera.at_resolution(camera.pixels * rays)
    below = positions_m.copy()
    below[:, 2] = 2 * floor_z_m - below[:, 2]
    found = visible_cloth(below, faces, vertex_uv, fine, rays)
    keep = on_floor.ravel()[found.seen]
    found = Visibility(found.seen[keep], found.uv[keep], found.depth_m[keep])
    y, x = np.divmod(found.seen, fine.pixels)
    # The ray's direction per metre of depth, upwards: where it meets the floor, and how steeply.
    ray = np.stack(
        [(x - fine.matrix[0, 2]) / fine.matrix[0, 0], (y - fine.matrix[1, 2]) / fine.matrix[1, 1]]
    )
    up = camera.rotation[:2, 2] @ ray + camera.rotation[2, 2]
    height = floor_z_m + camera.rotation[:, 2] @ camera.translation_m
    floor_depth = height / up
    behind = np.clip(1 - floor_depth / found.depth_m, 0, 1)
    squeeze = float(np.mean(np.abs(up) / np.sqrt(1 + (ray**2).sum(axis=0)))) if len(x) else 1.0
    pixel = (y // rays) * camera.pixels + x // rays
    width = _SPREAD * 2 * roughness**2 * camera.matrix[1, 1] * behind
    width = _carried_on(pixel, width, camera.pixels)
    step, side = rays // cells, camera.pixels * cells
    hits = np.bincount((y // step) * side + x // step, minlength=side**2).reshape(side, side, 1)
    of_floor = cv2.resize(on_floor.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    wide = cv2.resize(width, (side, side), interpolation=cv2.INTER_LINEAR) * cells
    shares = np.concatenate([hits / step**2, of_floor[..., None]], axis=-1).astype(np.float32)
    shares = blurred(shares, wide, squeeze)
    coverage = shares[..., 0] / np.maximum(shares[..., 1], 1e-3)
    order = np.argsort(pixel, kind="stable")
    return MirroredSight(pixel[order], found.uv[order], width, squeeze, coverage, cells)


def _carried_on(pixel: np.ndarray, values: np.ndarray, side: int) -> np.ndarray:
    """Means over the pixels' rays, smoothed a little and carried on to where there are none."""
    share = np.bincount(pixel, minlength=side**2).reshape(side, side).astype(np.float32)
    total = np.bincount(pixel, values, side**2).reshape(side, side).astype(np.float32)
    result = np.full_like(total, total.sum() / max(share.sum(), 1e-6))
    for width in (16.0, 5.0, 1.0):
        weight = cv2.GaussianBlur(share, (0, 0), width)
        np.divide(cv2.GaussianBlur(total, (0, 0), width), weight, out=result, where=weight > 1e-2)
    return result


def blurred(image: np.ndarray, width: np.ndarray, squeeze: float) -> np.ndarray:
    """An image (H, W, C) blurred by a width (H, W) of its own at every pixel."""
    last = int(np.searchsorted(_WIDTHS, min(float(width.max()), _WIDTHS[-1])))
    stack = [image] + [
        cv2.GaussianBlur(image, (0, 0), sigmaX=max(squeeze * one, 0.1), sigmaY=one).reshape(
            image.shape
        )
        for one in _WIDTHS[1 : last + 1]
    ]
    level = np.interp(width, _WIDTHS, range(len(_WIDTHS)))
    low = np.minimum(level.astype(np.int64), max(last - 1, 0))
    part = (level - low)[..., None].astype(np.float32)
    result = np.zeros_like(image)
    for k in range(last + 1):
        weight = np.where(low == k, 1 - part[..., 0], np.where(low == k - 1, part[..., 0], 0))
        result += weight[..., None].astype(np.float32) * stack[k]
    return result


def smooth_mirrored_light(light: np.ndarray, where: np.ndarray, sight: MirroredSight) -> np.ndarray:
    """Light (C, H, W) of the mirrored cloth, smoothed within its mirror image.

    Parameters
    ----------
    light : ndarray (C, H, W)
        At the resolution of the sight's cells.
    where : ndarray (H, W) bool
        The pixels that see nothing but floor.
    sight : MirroredSight
    """
    floor = where.astype(np.float32)[..., None]
    coverage = sight.coverage[..., None]
    values = np.moveaxis(light, 0, -1).astype(np.float32) * floor
    size = floor.shape[1::-1]
    width = cv2.resize(sight.width, size, interpolation=cv2.INTER_LINEAR) * sight.cells
    width = np.maximum(_LIGHT_SPREAD * width, _LEAST_LIGHT_BLUR)
    both = np.concatenate([values, floor * coverage], axis=-1)
    near = blurred(both, width, sight.squeeze)
    far = cv2.blur(both, (15, 15))
    whole = np.where(near[..., -1:] > 1e-2, near, far)
    return np.moveaxis(whole[..., :-1] / np.maximum(whole[..., -1:], 1e-2) * coverage, -1, 0)


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


def mirrored_albedo(sight: MirroredSight, texel: np.ndarray, texels: np.ndarray) -> np.ndarray:
    """Mean albedo (pixels, pixels, 3) of the cloth that each pixel of floor mirrors.

    Parameters
    ----------
    sight : MirroredSight
    texel : ndarray (N,) int
        Number of each ray's texel.
    texels : ndarray (3, M)
    """
    shape = (*sight.width.shape, 4)
    image = np.zeros((sight.width.size, 4), np.float32)
    if len(texel):
        pixel, start = np.unique(sight.pixel, return_index=True)
        for colour in range(3):
            image[pixel, colour] = np.add.reduceat(texels[colour][texel], start)
        image[pixel, 3] = np.diff(np.append(start, len(texel)))
    image = blurred(image.reshape(shape), sight.width, sight.squeeze)
    mean = image[..., :3].sum(axis=(0, 1)) / max(float(image[..., 3].sum()), 1e-6)
    covered = image[..., 3:] > 1e-2
    return np.where(covered, image[..., :3] / np.maximum(image[..., 3:], 1e-2), mean)
