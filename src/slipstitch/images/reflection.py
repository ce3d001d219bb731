"""The reflection of the cloth in the floor: the point seen by each ray, its blur and its light.

A mirror at z = 0 shows points at -z, so the mirrored cloth is seen by the same rasteriser. A
floor of roughness r has slopes t about either axis of the GGX distribution (Walter et al. 2007),
with the parameter r^2. A point that lies d behind the floor along the mirrored ray is moved by
2 t d along the plane of incidence and 2 t d cos(angle of incidence) across it. GGX has long tails:
a tenth of the light comes from beyond three times its parameter, which makes dark cloth look hazy
even in a good mirror. The blur has another width at every pixel: images are blurred with a few
widths, and every pixel takes its share of each.

Blender renders the light of each order that the floor reflects towards the camera, with the true
distribution of slopes, from few paths; it is smoothed inside and outside the reflected cloth.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from scipy.special import ive

from slipstitch.images.camera import Camera
from slipstitch.images.surroundings import FLOOR_M, Surroundings
from slipstitch.images.visibility import Visibility, sees_quad, visible_cloth

# Standard deviations in pixels, upwards in the image, between which is interpolated.
_WIDTHS = (0.0, 0.35, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0, 16.0, 44.8)
# Images that are blurred more than this are made smaller first.
_SHARPEST_PX = 1.4
# How far round a pixel light carries, if there is none within reach of the blur.
_FAR_PX = 7
# Of the planes that `spread` fits: added to the variances of place (pixels^2), against noise.
_PLANE_STIFFNESS = 0.3

#: A blur whose shape is a single Gaussian.
GAUSSIAN = ((1.0, 1.0),)


def blur_weights(width: np.ndarray, shape: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Weights (L, H, W) float32 of the images blurred by each width that some pixel uses.

    `width` is in pixels; `shape` has weights, and widths over `width`, of Gaussians.
    """
    numbers, variances = range(len(_WIDTHS)), np.square(_WIDTHS)
    weights = np.zeros((len(_WIDTHS), *width.shape), np.float32)
    for share, times in shape:
        # By variance, which is what adds up when blurred images are mixed.
        level = np.interp((width * times) ** 2, variances, numbers).astype(np.float32)
        for number in range(int(level.min()), int(np.ceil(level.max())) + 1):
            weights[number] += share * np.clip(1 - np.abs(level - number), 0, None)
    last = max(number for number in numbers if weights[number].any())
    return weights[: last + 1]


def blurred(image: np.ndarray, weights: np.ndarray, squeeze: float) -> np.ndarray:
    """An image (H, W, C) blurred as `blur_weights` say, sideways `squeeze` times as wide."""
    result = weights[0][..., None] * image
    for width, weight in zip(_WIDTHS[1:], weights[1:], strict=False):
        smooth = _smooth(image, width, squeeze * width)
        result += weight[..., None] * smooth.reshape(image.shape)
    return result


def _smooth(image: np.ndarray, upwards: float, sideways: float) -> np.ndarray:
    fewer = 2 ** int(np.log2(max(upwards / _SHARPEST_PX, 1)))
    if fewer == 1:
        return cv2.sepFilter2D(image, -1, _kernel(sideways), _kernel(upwards))
    height, width = image.shape[:2]
    low = cv2.resize(image, (width, -(-height // fewer)), interpolation=cv2.INTER_AREA)
    # Making an image smaller and larger again blurs it by half a pixel of the smaller one.
    upwards = np.sqrt((upwards / fewer) ** 2 - 0.25)
    low = cv2.sepFilter2D(low, -1, _kernel(sideways), _kernel(upwards))
    return cv2.resize(low, (width, height), interpolation=cv2.INTER_LINEAR)


@cache
def _kernel(width: float) -> np.ndarray:
    """The discrete Gaussian (Lindeberg 1990): its variance is right below a pixel, too."""
    reach = math.ceil(4 * width) + 1
    kernel = ive(np.abs(np.arange(-reach, reach + 1)), width**2)
    return kernel / kernel.sum()


def spread(light: np.ndarray, share: np.ndarray, blur: float) -> np.ndarray:
    """Light over share (C, H, W): smoothed within a region and carried a little way out of it.

    Around every pixel a plane is fitted to the light nearby: a mean would miss the gradient of a
    shadow at the region's edge. `share` (H, W) is the region's, `blur` the weights' width in
    pixels.
    """
    share = share.astype(np.float32)
    values = np.moveaxis(light, 0, -1).astype(np.float32) * (share > 0)[..., None]
    whole = cv2.blur(share, (2 * _FAR_PX + 1,) * 2)[..., None]
    far = cv2.blur(values, (2 * _FAR_PX + 1,) * 2).reshape(values.shape)
    far = far / np.maximum(whole, 1e-3)
    reach = max(3, math.ceil(2 * blur))
    place = np.arange(-reach, reach + 1)
    flat = np.exp(-(place**2) / 2 / blur**2)
    slope, bend = flat * place, flat * place**2

    def moment(image: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
        # OpenCV correlates: the moments are about the pixel itself.
        return cv2.sepFilter2D(image, -1, across, down).reshape(*share.shape, -1)

    count = moment(share, flat, flat)
    scale = 1 / np.maximum(count, 1e-3)
    x, y = (moment(share, *kernels) * scale for kernels in ((slope, flat), (flat, slope)))
    mean = moment(values, flat, flat) * scale
    xx = moment(share, bend, flat) * scale - x**2 + _PLANE_STIFFNESS
    yy = moment(share, flat, bend) * scale - y**2 + _PLANE_STIFFNESS
    xy = moment(share, slope, slope) * scale - x * y
    vx = moment(values, slope, flat) * scale - x * mean
    vy = moment(values, flat, slope) * scale - y * mean
    near = mean - ((yy * vx - xy * vy) * x + (xx * vy - xy * vx) * y) / (xx * yy - xy**2)
    return np.moveaxis(np.where(count > 1e-3, near, far), -1, 0)


#: GGX, p(t1, t2) = a^2 / pi (a^2 + t1^2 + t2^2)^2, is a mixture of Gaussians whose inverse
#: variances are exponentially distributed. Five of them: their shares, and widths over a.
GGX = tuple(
    (last - first, 1 / math.sqrt(-2 * math.log(1 - (first + last) / 2)))
    for first, last in itertools.pairwise((0.0, 0.02, 0.07, 0.25, 0.6, 1.0))
)
FLOOR_Z_M = float(FLOOR_M[0, 2])
# Mirrored cloth is looked for this many pixels beyond the image too: it blurs into it.
MARGIN = 8
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

    camera: Camera  # of the image without its `MARGIN`
    rays: int  # along each side of a pixel
    # (N,) int: flat numbers of the rays that meet mirrored cloth on floor that they see, rising
    seen: np.ndarray
    uv: np.ndarray  # (N, 2): where on the cloth
    lying: np.ndarray  # (N,) bool: whether the cloth lies on the floor there; its underside is dark
    bare: np.ndarray  # (rays pixels, rays pixels) bool: the rays that see the floor
    # (pixels, pixels) float32: the parameter of the blur, upwards in pixels, everywhere
    width: np.ndarray
    squeeze: float  # the blur's sideward width over its upward one
    surroundings: Surroundings  # the floor's look and the lamp's place


def mirrored_sight(
    positions_m: np.ndarray,
    faces: np.ndarray,
    vertex_uv: np.ndarray,
    surroundings: Surroundings,
    cloth: Visibility,
    camera: Camera,
    rays: int,
) -> MirroredSight:
    """Find the mirrored cloth, of a mesh, in the floor.

    `cloth` is what the image's rays, `rays` along each side of a pixel, see of the cloth itself.
    """
    wide = camera.with_margin(MARGIN)
    fine = wide.at_resolution(wide.pixels * rays)
    bare = sees_quad(FLOOR_M, fine, rays)
    y, x = np.divmod(cloth.seen, camera.pixels * rays)
    bare[y + MARGIN * rays, x + MARGIN * rays] = False
    below = positions_m.copy()
    below[:, 2] = 2 * FLOOR_Z_M - below[:, 2]
    found = visible_cloth(below, faces, vertex_uv, fine, rays)
    keep = bare.ravel()[found.seen]
    seen, depth = found.seen[keep], found.depth_m[keep]
    y, x = np.divmod(seen, fine.pixels)
    # The ray's direction per metre of depth, upwards: where it meets the floor, and how steeply.
    right = (x - fine.matrix[0, 2]) / fine.matrix[0, 0]
    down = (y - fine.matrix[1, 2]) / fine.matrix[1, 1]
    up = camera.rotation[:, 2] @ np.stack([right, down, np.ones_like(right)])
    floor_depth = (FLOOR_Z_M + camera.rotation[:, 2] @ camera.translation_m) / up
    behind = np.clip(1 - floor_depth / depth, 0, 1)
    steepness = np.abs(up) / np.sqrt(1 + right**2 + down**2)
    width = 2 * surroundings.roughness**2 * camera.matrix[1, 1] * behind
    pixel = (y // rays) * wide.pixels + x // rays
    lying = np.abs(up) * (depth - floor_depth) < _LYING_M
    blur = _carried_on(pixel, width, wide.pixels)
    squeeze = float(steepness.mean()) if len(seen) else 1.0
    seen_uv = seen, found.uv[keep]
    return MirroredSight(camera, rays, *seen_uv, lying, bare, blur, squeeze, surroundings)


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
    step, side = sight.rays // cells, (sight.camera.pixels + 2 * MARGIN) * cells
    y, x = np.divmod(sight.seen, side * step)
    cell = (y // step) * side + x // step
    hits = [np.bincount(hit, minlength=side**2) for hit in (cell, cell[~sight.lying])]
    of_floor = cv2.resize(sight.bare.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    width = cv2.resize(sight.width, (side, side), interpolation=cv2.INTER_LINEAR) * cells
    shares = np.stack([*np.reshape(hits, (2, side, side)) / step**2, of_floor], axis=-1)
    shares = shares.astype(np.float32)
    shares = blurred(shares, blur_weights(width, GGX), sight.squeeze)
    inside = np.s_[MARGIN * cells : -MARGIN * cells,] * 2
    shares = shares[inside]
    cloth, lit = np.moveaxis(shares[..., :2] / np.maximum(shares[..., 2:], 1e-3), -1, 0)
    return MirrorShares(cloth, lit, width[inside])


def glint_share(surroundings: Surroundings, camera: Camera) -> np.ndarray:
    """Share (pixels, pixels) of the lamp's light on a floor that is mirrored, not scattered.

    A GGX mirror (Walter et al. 2007) of Schlick's reflectance over a Lambertian body, a point lamp.
    """
    place = np.arange(camera.pixels)
    x = (place[None, :] - camera.matrix[0, 2]) / camera.matrix[0, 0]
    y = (place[:, None] - camera.matrix[1, 2]) / camera.matrix[1, 1]
    ray = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1) @ camera.rotation
    eye = -camera.translation_m @ camera.rotation
    # Pixels that look over the horizon see no floor.
    depth = (FLOOR_Z_M - eye[2]) / np.minimum(ray[..., 2], -1e-6)
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
    """Light (C, H, W) of the mirrored cloth, smoothed within its reflection on the floor."""
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
    """Light (1, H, W) of a region (H, W), smoothed by a filter that the coverage guides."""
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
