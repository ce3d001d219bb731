"""Where a dragged cloth is, on average over fabrics and coefficients: known from the stage alone.

Of ten fabrics, a cloth that is dragged steadily hangs from the clamps in nearly one profile, and
its lower edge lags by 0.6 to 0.8 of a taut sheet's reach. So images of another camera are brought
into the calibrated viewpoint through this profile and the floor: what parallax is left is that of
the difference from it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slipstitch.images.camera import Camera

#: How far the lower edge may lag, in units of a taut sheet's reach along the floor.
LAG = 0.7
#: Height above the floor in units of the clamps', and lag in units of that reach: means over steady
#: strokes of the paper's grid, friction coefficients 0.3 to 1.5. The rest lies on the floor.
PROFILE = (
    (1.0, 0.0),
    (0.7, 0.03),
    (0.4, 0.12),
    (0.2, 0.19),
    (0.1, 0.26),
    (0.03, 0.36),
    (0.0, 0.46),
)


def lags_m(stage_x_m: np.ndarray, stage_z_m: np.ndarray, length_m: float) -> np.ndarray:
    """Place of the lower edge relative to the clamps, shape (T,): it stays until it is pulled.

    Parameters
    ----------
    stage_x_m, stage_z_m : ndarray (T,)
        Place of the clamps along the track and above the floor, from the start of the motion on, in
        steps much shorter than the reach.
    length_m : float
        Of the cloth, from the clamps to its lower edge.
    """
    reach = LAG * np.sqrt(np.maximum(length_m**2 - stage_z_m**2, 0.0))
    edge, found = float(stage_x_m[0]), np.empty(len(stage_x_m))
    for i, (x, half) in enumerate(zip(stage_x_m.tolist(), reach.tolist(), strict=True)):
        edge = min(max(edge, x - half), x + half)
        found[i] = edge - x
    return found


@dataclass(frozen=True)
class MeanCloth:
    """The profile at a moment, drawn out across the track, and the floor around it.

    It goes on beside the cloth: the floor behind, which another camera sees elsewhere or not at
    all, would break the image there.

    Attributes
    ----------
    stage_x_m, stage_z_m : float
        Place of the clamps.
    lag_m : float
        As of `lags_m`.
    """

    stage_x_m: float
    stage_z_m: float
    lag_m: float

    def seen(self, eye: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """The first points (N, 3) on rays (N, 3) from an eye (3,); NaN where there is none."""
        height, lag = np.array(PROFILE).T
        corners = np.column_stack(
            [self.stage_x_m + lag * self.lag_m / LAG, height * self.stage_z_m]
        )
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
