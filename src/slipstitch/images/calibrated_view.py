"""What the calibrated viewpoint shows at a time: a crop that follows the stage, and the mean cloth.

The image is a square crop of what the fixed camera sees: the smallest square that holds a room
around the stage which the cloth cannot leave. The stage path is known, so the same crop can be cut
from a real video. A crop of a pinhole image is a pinhole image with other intrinsics, which is how
Blender renders it directly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.render import RenderSettings
from slipstitch.images.camera import Camera, Pose, pose, turned
from slipstitch.images.camera_file import read_camera_file
from slipstitch.images.rectification import MeanCloth, Surface, cloth_surface, lags_m
from slipstitch.physics.simulation.trajectory import Trajectory

# Where the cloth can be, in units of its length: this far from under the clamps, at this share of
# their height. A taut sheet of length L held at height 0.75 L reaches 0.66 L along the floor; a
# hanging one does not, which leaves room for stretch and for a yawed clamp.
_REACH = ((0.0, 0.66), (0.35, 0.55), (1.0, 0.12))
_HALF_WIDTH = 0.54
_MARGIN = 1.03


def viewpoint_pose(viewpoint: str, settings: RenderSettings) -> Pose:
    """Pose of a viewpoint's fixed camera: from the calibration or the catalogue."""
    seen_from = VIEWPOINTS[viewpoint]
    path = settings.camera_of(viewpoint)
    if path is None:
        return pose(seen_from)
    turn = seen_from.azimuth_deg - VIEWPOINTS["calibrated"].azimuth_deg
    return turned(*read_camera_file(path).pose, turn)


def cloth_room(
    stage_x_m: float | np.ndarray, stage_z_m: float | np.ndarray, width_m: float, length_m: float
) -> np.ndarray:
    """Corners (N, 3) of a room that a cloth of this width and length stays in.

    Around one place of the clamps, or around several places.
    """
    first, last, top = np.min(stage_x_m), np.max(stage_x_m), np.max(stage_z_m)
    corners = [
        (x, side * _HALF_WIDTH * width_m, share * top)
        for share, reach in _REACH
        for x in (first - reach * length_m, last + reach * length_m)
        for side in (-1, 1)
    ]
    return np.array(corners)


def crop_to(fixed: Pose, room_m: np.ndarray, pixels: int) -> Camera:
    """A fixed camera's image of this side, cropped to the smallest square around points (N, 3)."""
    rotation, translation = fixed
    local = room_m @ rotation.T + translation
    image = local[:, :2] / local[:, 2:]
    low, high = image.min(axis=0), image.max(axis=0)
    focal = pixels / (_MARGIN * np.max(high - low))
    centre = (pixels - 1) / 2 - focal * (low + high) / 2
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
    return Camera(rotation, translation, matrix, pixels)


def cloth_size(trajectory: Trajectory) -> tuple[float, float]:
    """Width and length (m) of the cloth at rest, over which u and v run from 0 to 1.

    By least squares, whatever plane the rest mesh lies in.
    """
    design = np.column_stack([trajectory.uv, np.ones(len(trajectory.uv))])
    along = np.linalg.lstsq(design, trajectory.rest_positions_m, rcond=None)[0]
    width, length = np.linalg.norm(along[:2], axis=1)
    return float(width), float(length)


@dataclass(frozen=True)
class CalibratedView:
    """A viewpoint over the course of the protocol."""

    pose: Pose  # of the fixed camera
    pixels: int  # side of an image
    # time(s) -> places x and z of the clamps (m)
    stage: Callable[[float | np.ndarray], tuple[np.ndarray, np.ndarray]]
    simulated_s: np.ndarray  # (n,): times of all frames, from the start of the stage's motion on
    size_m: tuple[float, float]  # width and length of the cloth

    @classmethod
    def of_trajectory(
        cls, trajectory: Trajectory, viewpoint: str, settings: RenderSettings
    ) -> "CalibratedView":
        """The view of a simulation, whose clamps are where its frames have them."""

        def stage(time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x_m, z_m = (
                np.interp(time_s, trajectory.time_s, of)
                for of in (trajectory.stage_x_m, trajectory.stage_z_m)
            )
            return x_m, z_m

        fixed, size_m = viewpoint_pose(viewpoint, settings), cloth_size(trajectory)
        return cls(fixed, settings.pixels, stage, trajectory.time_s, size_m)

    def room(self, time_s: float) -> np.ndarray:
        """Corners (N, 3) of what the image shows at a time."""
        return cloth_room(*self.stage(time_s), *self.size_m)

    def crop(self, time_s: float) -> Camera:
        """The image's camera at a time."""
        return crop_to(self.pose, self.room(time_s), self.pixels)

    def seen(self, time_s: float) -> tuple[Camera, Surface]:
        """The image's camera at a time, and the surface that its pixels are taken to show."""
        crop = self.crop(time_s)
        return crop, cloth_surface(crop, self.cloth(time_s))

    def cloth(self, time_s: float) -> MeanCloth:
        """Where the cloth is at a time, on average."""
        x_m, z_m = map(float, self.stage(time_s))
        return MeanCloth(x_m, z_m, float(np.interp(time_s, self.simulated_s, self._lags_m)))

    @cached_property
    def _lags_m(self) -> np.ndarray:
        return lags_m(*self.stage(self.simulated_s), self.size_m[1])
