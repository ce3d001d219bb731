"""A bench's own camera: near the calibrated viewpoint, known with errors, brought back into it.

A viewpoint of the family ``bench_1`` ... has another pose in every simulation: as many benches as
films, so that no bench tells its fabric. Its images are rectified into the
calibrated viewpoint by the function that rectifies real videos, from what a calibration would
have told of the camera.
"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np

from slipstitch.images.calibrated_view import CalibratedView
from slipstitch.images.camera import AIM_M, POSE, Camera, relative_pose
from slipstitch.images.rectification import fine_source_pixels, resample, stage_plane
from slipstitch.images.surroundings import drawn_by, generator

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

    def record(self) -> dict[str, Any]:
        """The values as a mapping of plain values."""
        return json.loads(json.dumps(asdict(self)))

    def pose(
        self, rotation: np.ndarray, translation_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
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
        axes = np.radians(self.rotation_error_deg)
        wrong, _ = cv2.Rodrigues(axes)
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1 + self.focal_error
        translation_m = wrong @ camera.translation_m + self.position_error_m
        return replace(
            camera,
            rotation=wrong @ camera.rotation,
            translation_m=translation_m,
            matrix=matrix,
            distortion=_NO_DISTORTION,
        )


def draw_bench_camera(seed: int, simulation: str, viewpoint: str) -> BenchCamera:
    """The camera of a simulation's videos (by its id) from a member of the family (by its name)."""
    rng = generator(seed, drawn_by(simulation, viewpoint), viewpoint, "bench camera")
    yaw, pitch, roll, distance = rng.uniform(-1, 1, 4)
    aim = rng.uniform(-1, 1, 3) * AIM_MAX_M
    if rng.uniform() < CALIBRATED_SHARE:
        yaw = pitch = roll = distance = 0.0
        aim = np.zeros(3)
    return BenchCamera(
        yaw_deg=float(yaw * YAW_MAX_DEG),
        pitch_deg=float(pitch * PITCH_MAX_DEG),
        roll_deg=float(roll * ROLL_MAX_DEG),
        distance=float(1 + distance * DISTANCE_MAX),
        aim_m=_triple(aim),
        rotation_error_deg=_triple(rng.normal(size=3) * ROTATION_SD_DEG),
        position_error_m=_triple(rng.normal(size=3) * POSITION_SD_M),
        focal_error=float(rng.normal() * FOCAL_SD),
        start_error_s=float(rng.uniform(-1, 1) * START_ERROR_MAX_S),
    )


def bench_room(seen: Camera, stage_x_m: float, room_m: np.ndarray) -> np.ndarray:
    """Points (N, 3) that the bench camera's image must hold.

    The cloth's room, and where the calibrated crop's corners look through the stage plane, so that
    hardly any of the rectified image is blind: through the mean cloth up to 2 %, where the border
    is repeated.
    """
    corners = np.column_stack([_CORNERS * seen.pixels - 0.5, np.ones(4)])
    rays = corners @ np.linalg.inv(seen.matrix).T @ seen.rotation
    eye = -seen.rotation.T @ seen.translation_m
    return np.concatenate([room_m, stage_plane(seen, stage_x_m).seen(eye, rays)])


@dataclass(frozen=True)
class Rectifier:
    """Brings a video's images into the calibrated viewpoint; leaves those that need it not."""

    bench: BenchCamera | None  # None: the images are what they shall be
    calibrated: CalibratedView

    def source_pixels(self, camera: Camera, time_s: float) -> np.ndarray:
        """Where a bench camera's image shows what the calibrated viewpoint would see.

        From what its calibration says of it, at the time that was found; as `fine_source_pixels`.
        """
        assert self.bench is not None
        found_s = time_s + self.bench.start_error_s
        return fine_source_pixels(self.bench.stated(camera), *self.calibrated.seen(found_s))

    def at(self, camera: Camera, time_s: float) -> Callable[[np.ndarray], np.ndarray]:
        """Of the images of a camera at a time: what makes each (pixels, pixels, 3) uint8."""
        if self.bench is None:
            return lambda image: image
        place = self.source_pixels(camera, time_s)
        return lambda image: resample(image, place, self.calibrated.pixels)[0]

    def pose(self, camera: Camera) -> dict[str, float]:
        """Pose of the camera relative to the calibrated viewpoint, according to its calibration."""
        if self.bench is None:
            return dict.fromkeys(POSE, 0.0)
        return relative_pose(self.bench.stated(camera).pose, self.calibrated.pose)


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _turn(axis: np.ndarray | list[float], angle_deg: float) -> np.ndarray:
    """Rotation matrix about a unit vector, right-handed."""
    matrix, _ = cv2.Rodrigues(np.asarray(axis, dtype=np.float64) * math.radians(angle_deg))
    return matrix
