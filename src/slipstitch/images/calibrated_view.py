"""What the calibrated viewpoint shows at a time, and a bench's own camera brought back into it.

The image is the smallest square crop that holds a room around the stage which the cloth cannot
leave. The stage path is known, so the same crop can be cut from a real video. A crop of a pinhole
image is a pinhole image with other intrinsics, which is how Blender renders it directly.

A viewpoint of the family ``bench_1`` ... has another pose in every simulation, so that no bench
tells its fabric. Its images are rectified into the calibrated viewpoint by the function that
rectifies real videos, from what a calibration would have told of the camera.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.render import RenderSettings
from slipstitch.images import rectification
from slipstitch.images.camera import AIM_M, POSE, Camera, Pose, pose, relative_pose, turned
from slipstitch.images.camera_file import read_camera_file
from slipstitch.images.rectification import MeanCloth, Surface
from slipstitch.images.surroundings import drawn_by, generator
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
    """Corners (N, 3) of a room that a cloth stays in, around one place of the clamps or several."""
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
    """Width and length (m) of the cloth at rest, over which u and v run from 0 to 1."""
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
        return crop, rectification.cloth_surface(crop, self.cloth(time_s))

    def cloth(self, time_s: float) -> MeanCloth:
        """Where the cloth is at a time, on average."""
        x_m, z_m = map(float, self.stage(time_s))
        return MeanCloth(x_m, z_m, float(np.interp(time_s, self.simulated_s, self._lags_m)))

    @cached_property
    def _lags_m(self) -> np.ndarray:
        return rectification.lags_m(*self.stage(self.simulated_s), self.size_m[1])


# How far a bench's camera is off at most, and how exactly it is known. One in three is not off.
YAW_MAX_DEG, PITCH_MAX_DEG, ROLL_MAX_DEG = 15.0, 8.0, 2.0
DISTANCE_MAX = 0.2  # relative
CALIBRATED_SHARE = 1 / 3
AIM_MAX_M = 0.01  # of the point that it is aimed at, along each axis
ROTATION_SD_DEG = 0.05  # errors of a good calibration, each axis
POSITION_SD_M = 0.001
FOCAL_SD = 0.001  # relative
START_ERROR_MAX_S = 0.02  # of the time at which the stage starts

_NO_DISTORTION = np.zeros(5)
_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])


@dataclass(frozen=True)
class BenchCamera:
    """Pose of a camera relative to the calibrated viewpoint, and the errors of its calibration."""

    # azimuth and elevation more than the viewpoint's, about the point that it is aimed at; turn
    # about the optical axis
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    distance: float = 1.0  # in units of the viewpoint's
    # by how much the point that it is aimed at is off, in the stage's coordinates
    aim_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # of the calibration, about and along the camera's axes
    rotation_error_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_error: float = 0.0  # of the calibration, as a share
    start_error_s: float = 0.0  # how much too late the stage's start was found

    def pose(self, rotation: np.ndarray, translation_m: np.ndarray) -> Pose:
        """Rotation and translation, world to camera, beside those of the viewpoint."""
        around = _turn([0.0, 0.0, 1.0], -self.yaw_deg)
        # Up is against y of the camera: it climbs about its own x axis, after the yaw.
        move = around @ _turn(rotation[0], -self.pitch_deg)
        eye = np.array(AIM_M) + self.aim_m
        eye = eye + self.distance * move @ (-rotation.T @ translation_m - np.array(AIM_M))
        turned = _turn([0.0, 0.0, 1.0], self.roll_deg) @ rotation @ move.T
        return turned, -turned @ eye

    def stated(self, camera: Camera) -> Camera:
        """The camera as a calibration with these errors describes it."""
        wrong, _ = cv2.Rodrigues(np.radians(self.rotation_error_deg))
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1 + self.focal_error
        stands = wrong @ camera.rotation, wrong @ camera.translation_m + self.position_error_m
        return Camera(*stands, matrix, camera.pixels, camera.rows, _NO_DISTORTION)


def draw_bench_camera(seed: int, simulation: str, viewpoint: str) -> BenchCamera:
    """The camera of a simulation's videos (by its id) from a member of the family (by its name)."""
    rng = generator(seed, drawn_by(simulation, viewpoint), viewpoint, "bench camera")
    most = YAW_MAX_DEG, PITCH_MAX_DEG, ROLL_MAX_DEG, DISTANCE_MAX
    turns, aim = rng.uniform(-1, 1, 4) * most, rng.uniform(-1, 1, 3) * AIM_MAX_M
    if rng.uniform() < CALIBRATED_SHARE:
        turns, aim = np.zeros(4), np.zeros(3)
    yaw_deg, pitch_deg, roll_deg, farther = turns.tolist()
    return BenchCamera(
        *(yaw_deg, pitch_deg, roll_deg, 1 + farther, tuple(aim.tolist())),
        rotation_error_deg=tuple((rng.normal(size=3) * ROTATION_SD_DEG).tolist()),
        position_error_m=tuple((rng.normal(size=3) * POSITION_SD_M).tolist()),
        focal_error=float(rng.normal() * FOCAL_SD),
        start_error_s=float(rng.uniform(-1, 1) * START_ERROR_MAX_S),
    )


def bench_room(seen: Camera, stage_x_m: float, room_m: np.ndarray) -> np.ndarray:
    """Points (N, 3) that the bench camera's image must hold.

    The cloth's room, and where the calibrated crop's corners look through the stage plane.
    """
    corners = np.column_stack([_CORNERS * seen.pixels - 0.5, np.ones(4)])
    rays = corners @ np.linalg.inv(seen.matrix).T @ seen.rotation
    eye = -seen.rotation.T @ seen.translation_m
    return np.concatenate([room_m, rectification.stage_plane(seen, stage_x_m).seen(eye, rays)])


@dataclass(frozen=True)
class Rectifier:
    """Brings a video's images into the calibrated viewpoint; leaves those that need it not."""

    bench: BenchCamera | None  # None: the images are what they shall be
    calibrated: CalibratedView

    def source_pixels(self, camera: Camera, time_s: float) -> np.ndarray:
        """Where the image, by its calibration, shows what the calibrated viewpoint would see."""
        assert self.bench is not None
        found_s = time_s + self.bench.start_error_s
        return rectification.fine_source_pixels(
            self.bench.stated(camera), *self.calibrated.seen(found_s)
        )

    def at(self, camera: Camera, time_s: float) -> Callable[[np.ndarray], np.ndarray]:
        """Of the images of a camera at a time: what makes each (pixels, pixels, 3) uint8."""
        if self.bench is None:
            return lambda image: image
        place = self.source_pixels(camera, time_s)
        return lambda image: rectification.resample(image, place, self.calibrated.pixels)[0]

    def pose(self, camera: Camera) -> dict[str, float]:
        """Pose of the camera relative to the calibrated viewpoint, according to its calibration."""
        if self.bench is None:
            return dict.fromkeys(POSE, 0.0)
        return relative_pose(self.bench.stated(camera).pose, self.calibrated.pose)


def _turn(axis: np.ndarray | list[float], angle_deg: float) -> np.ndarray:
    """Rotation matrix about a unit vector, right-handed."""
    matrix, _ = cv2.Rodrigues(np.asarray(axis, dtype=np.float64) * math.radians(angle_deg))
    return matrix
