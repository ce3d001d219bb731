"""Blurs: by another width at every pixel, as a floor's roughness does, and within a region.

For the former, images are blurred with a few widths, and every pixel takes its share of each.
"""

import math
from functools import cache

import cv2
import numpy as np
from scipy.special import ive

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

    Parameters
    ----------
    width : ndarray (H, W)
        Of the blur, in pixels.
    shape : tuple of (float, float)
        Weights, and widths over `width`, of the Gaussians that the blur is a mixture of.
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
    """An image (H, W, C) float32 blurred at every pixel as `blur_weights` (L, H, W) say.

    `squeeze` is the sideward width over the upward one.
    """
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
    shadow at the region's edge.

    Parameters
    ----------
    light : ndarray (C, H, W)
    share : ndarray (H, W)
        How much of the light is the region's: 0 outside it.
    blur : float
        Standard deviation in pixels of the weights.
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
