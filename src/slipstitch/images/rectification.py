"""From a real camera's image to the image that the calibrated viewpoint would have.

The lens's distortion is taken out, and what lies on a surface, the mean cloth and the floor, is put
where a camera at the calibrated viewpoint sees it. If the real camera stands there, this holds for
every point. If it stands elsewhere, points off the surface are shifted by their parallax; of the
surfaces that were tried this one shifts cloth least.

The mean cloth is known from the stage alone: of ten fabrics, a cloth that is dragged steadily hangs
from the clamps in nearly one profile, and its lower edge lags by 0.6 to 0.8 of a taut sheet's
reach.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from slipstitch.images.camera import Camera
from slipstitch.images.encoding import LINEAR, encode_srgb

# Averaging more source pixels than this along a side of an image's pixel changes nothing visible.
_MOST_RAYS = 8
#: How far the lower edge may lag, in units of a taut sheet's reach along the floor.
LAG = 0.7
#: Height above the floor in units of the clamps', and lag in units of that reach: means over steady
#: strokes of the paper's grid, friction coefficients 0.3 to 1.5. The rest lies on the floor.
PROFILE = np.array(
    [(1.0, 0.7, 0.4, 0.2, 0.1, 0.03, 0.0), (0.0, 0.03, 0.12, 0.19, 0.26, 0.36, 0.46)]
)


def lags_m(stage_x_m: np.ndarray, stage_z_m: np.ndarray, length_m: float) -> np.ndarray:
    """Place (T,) of the lower edge relative to the clamps: it stays until it is pulled."""
    reach = LAG * np.sqrt(np.maximum(length_m**2 - stage_z_m**2, 0.0))
    edge, found = float(stage_x_m[0]), np.empty(len(stage_x_m))
    for i, (x, half) in enumerate(zip(stage_x_m.tolist(), reach.tolist(), strict=True)):
        edge = min(max(edge, x - half), x + half)
        found[i] = edge - x
    return found


@dataclass(frozen=True)
class MeanCloth:
    """The profile at a moment, drawn out across the track, and the floor around it.

    Beside the cloth too: the floor behind, which others see elsewhere, would break the image there.
    """

    # place of the clamps
    stage_x_m: float
    stage_z_m: float
    lag_m: float  # as of `lags_m`

    def seen(self, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """The first points (N, 3) on rays (N, 3) from an eye (3,); NaN where there is none."""
        height, lag = PROFILE
        places_m = self.stage_x_m + lag * self.lag_m / LAG
        corners = np.column_stack([places_m, height * self.stage_z_m])
        depth = np.full(len(rays), np.inf)
        for number, (upper, lower) in enumerate(pairwise(corners)):
            along = upper - lower
            normal = np.array([along[1], 0.0, -along[0]])
            met = _depth(eye, rays, normal, normal[0] * lower[0] + normal[2] * lower[1])
            z = eye[2] + met * rays[:, 2]
            # The first facet goes on above the clamps.
            within = (z >= lower[1]) & ((z < upper[1]) | (number == 0))
            depth = np.where(within & (met > 0) & (met < depth), met, depth)
        floor = _depth(eye, rays, np.array([0.0, 0.0, 1.0]), 0.0)
        depth = np.where((floor > 0) & (floor < depth), floor, depth)
        return eye + np.where(np.isfinite(depth), depth, np.nan)[:, None] * rays


@dataclass(frozen=True)
class Plane:
    """The plane n x = d."""

    normal: tuple[float, float, float]
    offset_m: float

    def seen(self, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """As that of `MeanCloth`."""
        depth = _depth(eye, rays, np.array(self.normal), self.offset_m)
        return eye + np.where(depth > 0, depth, np.nan)[:, None] * rays


Surface = MeanCloth | Plane


def across_the_track(crop: Camera) -> bool:
    """Whether the upright plane through the clamps is seen from the front; else it is along it."""
    towards = crop.rotation[2]
    return bool(abs(towards[0]) >= abs(towards[1]))


def stage_plane(crop: Camera, stage_x_m: float) -> Plane:
    """The upright plane through the clamps: across the track, or along it, as one sees it."""
    if across_the_track(crop):
        return Plane((1.0, 0.0, 0.0), stage_x_m)
    return Plane((0.0, 1.0, 0.0), 0.0)


def cloth_surface(crop: Camera, cloth: MeanCloth) -> Surface:
    """The mean cloth; for a camera that looks across the track, the plane that it moves in."""
    return cloth if across_the_track(crop) else stage_plane(crop, cloth.stage_x_m)


def _depth(eye: np.ndarray, rays: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (offset - eye @ normal) / (rays @ normal)
    return np.where(np.isfinite(depth), depth, -1.0)


def in_stage_plane(crop: Camera, sideways_m: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the upright plane through the clamps' start, by place and height."""
    along = np.array([0.0, 1.0, 0.0] if across_the_track(crop) else [-1.0, 0.0, 0.0])
    return sideways_m[..., None] * along + height_m[..., None] * [0, 0, 1.0]


def source_pixels(
    lens: Camera, crop: Camera, surface: Surface, along: np.ndarray | None = None
) -> np.ndarray:
    """Position in the real image (`lens`) of each pixel of a crop, (n, n, 2) float64.

    The crop's pixels, their centres or places `along` (n,) either side, are taken to show the
    surface. NaN where the crop looks past it or the real camera cannot see it.
    """
    along = np.arange(crop.pixels) if along is None else along
    size = len(along)
    y, x = (part.ravel() for part in np.meshgrid(along, along, indexing="ij"))
    rays = np.column_stack([x, y, np.ones(size * size)]) @ np.linalg.inv(crop.matrix).T
    rays = rays @ crop.rotation
    eye = -crop.rotation.T @ crop.translation_m
    points = surface.seen(eye, rays)
    real = points @ lens.rotation.T + lens.translation_m
    seen = real[:, 2] > 0  # not where it is NaN
    found = np.full((size * size, 2), np.nan)
    if seen.any():
        found[seen] = lens.project(points[seen])
    return found.reshape(size, size, 2)


def fine_source_pixels(lens: Camera, crop: Camera, surface: Surface) -> np.ndarray:
    """`source_pixels`, (rays pixels, rays pixels, 2) float32: no real pixel is jumped over."""
    rays = _rays_per_side(lens, crop, surface)
    # Between the corners of a pixel the place is as good as linear.
    corners = source_pixels(lens, crop, surface, np.arange(crop.pixels + 1) - 0.5)
    fine = ((np.arange(crop.pixels * rays) + 0.5) / rays).astype(np.float32)
    return cv2.remap(corners.astype(np.float32), *np.meshgrid(fine, fine), cv2.INTER_LINEAR)


def rectify(
    image: np.ndarray, lens: Camera, crop: Camera, surface: Surface
) -> tuple[np.ndarray, float]:
    """The crop, each pixel the mean of the light that falls on it, and its share in the image.

    The real image is sRGB, uint8; its border is repeated. Black is past the surface.
    """
    return resample(image, fine_source_pixels(lens, crop, surface), crop.pixels)


def resample(image: np.ndarray, place: np.ndarray, pixels: int) -> tuple[np.ndarray, float]:
    """As `rectify`, at the `place` of `fine_source_pixels`: for images of one moment and camera."""
    rows, columns = image.shape[:2]
    inside = in_image(place, columns, rows)
    if not inside.any():
        return np.zeros((pixels, pixels, 3), np.uint8), 0.0
    # Only the part of the image that is used is turned into linear light.
    low, high = bounds(place[inside])
    low = np.maximum(np.floor(low).astype(int) - 2, 0)
    high = np.ceil(high).astype(int) + 3
    part = LINEAR[image[low[1] : high[1], low[0] : high[0]]]
    known = np.isfinite(place[..., 0]) & np.isfinite(place[..., 1])
    at = np.where(known[..., None], np.nan_to_num(place) - low, -1e4).astype(np.float32)
    light = cv2.remap(part, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    light[~known] = 0
    light = cv2.resize(light, (pixels, pixels), interpolation=cv2.INTER_AREA)
    return encode_srgb(light), float(inside.mean())


def in_image(place: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """Whether an image has these pixels (..., 2), bool of shape (...); not where they are NaN."""
    x, y = place[..., 0], place[..., 1]
    with np.errstate(invalid="ignore"):
        return (x > -0.5) & (x < columns - 0.5) & (y > -0.5) & (y < rows - 0.5)


def bounds(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest x and y, shape (2,) each, of pixels (..., 2).

    One at a time: over all axes but a last one of length 2, NumPy takes 30 times as long.
    """
    x, y = place[..., 0], place[..., 1]
    return np.array([x.min(), y.min()]), np.array([x.max(), y.max()])


def _rays_per_side(lens: Camera, crop: Camera, surface: Surface) -> int:
    """So many that no pixel of the real image is jumped over."""
    coarse = crop.at_resolution(16)
    place = source_pixels(lens, coarse, surface)
    steps = np.concatenate([np.diff(place, axis=k).reshape(-1, 2) for k in (0, 1)])
    longest = np.nanmax(np.linalg.norm(steps, axis=1), initial=0.0) * 16 / crop.pixels
    return int(np.clip(math.ceil(longest), 1, _MOST_RAYS))
