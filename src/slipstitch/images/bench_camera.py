"""A bench's own camera: near the calibrated viewpoint, known with errors, brought back into it.

A viewpoint of the family ``bench_1`` ... has another pose in every simulation: as many benches as
films, so that no bench tells its fabric. Its images are rectified into the
calibrated viewpoint by the function that rectifies real videos, from what a calibration would
have told of the camera.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from slipstitch.config.render import RenderSettings
from slipstitch.images.camera import AIM_M, Camera, cloth_room, crop_to
from slipstitch.images.camera_file import LensCamera
from slipstitch.images.mean_cloth import MeanCloth, cloth_surface, stage_plane
from slipstitch.images.rectification import fine_source_pixels
from slipstitch.images.surroundings import drawn_by, generator
from slipstitch.physics.simulation.trajectory import Trajectory

_NO_DISTORTION = np.zeros(5)
_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])


@dataclass(frozen=True)
class BenchCamera:
    """Pose of a camera relative to the calibrated viewpoint, and the errors of its calibration.

    Attributes
    ----------
    yaw_deg, pitch_deg, roll_deg : float
        Azimuth and elevation more than the viewpoint's, about the point that it is aimed at; turn
        about the optical axis.
    distance : float
        In units of the viewpoint's.
    aim_m : tuple of float
        By how much the point that it is aimed at is off, in the stage's coordinates.
    rotation_error_deg, position_error_m : tuple of float
        Of the calibration, about and along the camera's axes.
    focal_error : float
        Of the calibration, as a share.
    start_error_s : float
        How much too late the stage's start was found.
    """

    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    distance: float = 1.0
    aim_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_error_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    position_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_error: float = 0.0
    start_error_s: float = 0.0

    def record(self) -> dict[str, Any]:
        """The values as a mapping of plain values."""
        return asdict(self) | {
            name: list(getattr(self, name))
            for name in ("aim_m", "rotation_error_deg", "position_error_m")
        }

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
        return Camera(wrong @ camera.rotation, translation_m, matrix, camera.pixels, camera.rows)


def draw_bench_camera(
    settings: RenderSettings, seed: int, simulation: str, viewpoint: str
) -> BenchCamera:
    """The camera of a simulation's videos from a member of the family.

    Parameters
    ----------
    settings : RenderSettings
        Its ``bench_camera`` says how far it may stand off, and how exactly it is known.
    seed : int
        The configuration's.
    simulation : str
        Its id.
    viewpoint : str
        Name of the member.
    """
    family = settings.bench_camera
    rng = generator(seed, drawn_by(simulation, viewpoint), viewpoint, "bench camera")
    yaw, pitch, roll, distance = rng.uniform(-1, 1, 4)
    aim = rng.uniform(-1, 1, 3) * family.aim_m
    if rng.uniform() < family.calibrated_share:
        yaw = pitch = roll = distance = 0.0
        aim = np.zeros(3)
    return BenchCamera(
        yaw_deg=float(yaw * family.yaw_deg),
        pitch_deg=float(pitch * family.pitch_deg),
        roll_deg=float(roll * family.roll_deg),
        distance=float(1 + distance * family.distance),
        aim_m=_triple(aim),
        rotation_error_deg=_triple(rng.normal(size=3) * family.rotation_error_deg),
        position_error_m=_triple(rng.normal(size=3) * family.position_error_m),
        focal_error=float(rng.normal() * family.focal_error),
        start_error_s=float(rng.uniform(-1, 1) * family.start_error_s),
    )


def relative_pose(
    rotation: np.ndarray, translation_m: np.ndarray, viewpoint: tuple[np.ndarray, np.ndarray]
) -> dict[str, float]:
    """Pose of a camera relative to a viewpoint: the numbers of `slipstitch.images.pose.POSE`.

    Parameters
    ----------
    rotation, translation_m : ndarray (3, 3), (3,)
        World to camera.
    viewpoint : tuple of ndarray
        The same of the viewpoint.
    """
    azimuth, elevation, distance, roll = zip(
        _spherical(rotation, translation_m), _spherical(*viewpoint), strict=True
    )
    return {
        "yaw_deg": (azimuth[0] - azimuth[1] + 180) % 360 - 180,
        "pitch_deg": elevation[0] - elevation[1],
        "roll_deg": (roll[0] - roll[1] + 180) % 360 - 180,
        "log_distance": math.log(distance[0] / distance[1]),
    }


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


def bench_pixels(
    camera: Camera,
    bench: BenchCamera,
    viewpoint: tuple[np.ndarray, np.ndarray],
    trajectory: Trajectory,
    lags_m: np.ndarray,
    row: int,
    settings: RenderSettings,
    size_m: tuple[float, float],
) -> np.ndarray:
    """Where a bench camera's image shows what the calibrated viewpoint would see.

    Parameters
    ----------
    camera : Camera
        Of the image.
    bench : BenchCamera
        What is told wrongly of it.
    viewpoint : tuple of ndarray
        Rotation and translation of the calibrated viewpoint.
    trajectory : Trajectory
    lags_m : ndarray (T,)
        Of the cloth in it (`slipstitch.images.mean_cloth.lags_m`).
    row : int
        Of the frame in it.
    settings : RenderSettings
    size_m : tuple of float
        Width and length of the cloth.

    Returns
    -------
    ndarray (rays pixels, rays pixels, 2) float32
        As of `slipstitch.images.rectification.fine_source_pixels`.
    """
    time_s = trajectory.time_s[row] + bench.start_error_s
    x_m, z_m, lag_m = (
        float(np.interp(time_s, trajectory.time_s, of))
        for of in (trajectory.stage_x_m, trajectory.stage_z_m, lags_m)
    )
    fixed = settings.crop == "fixed"
    room = cloth_room(
        trajectory.stage_x_m if fixed else x_m, trajectory.stage_z_m if fixed else z_m, *size_m
    )
    seen = crop_to(viewpoint, room, settings.pixels)
    lens = LensCamera(bench.stated(camera), _NO_DISTORTION)
    cloth = MeanCloth(x_m, z_m, lag_m)
    return fine_source_pixels(lens, seen, cloth_surface(seen, cloth))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _turn(axis: np.ndarray | list[float], angle_deg: float) -> np.ndarray:
    """Rotation matrix about a unit vector, right-handed."""
    matrix, _ = cv2.Rodrigues(np.asarray(axis, dtype=np.float64) * math.radians(angle_deg))
    return matrix


def _spherical(
    rotation: np.ndarray, translation_m: np.ndarray
) -> tuple[float, float, float, float]:
    """Azimuth, elevation (degrees), distance (m) about `AIM_M`, and tilt of the image (degrees)."""
    x, y, z = -rotation.T @ translation_m - np.array(AIM_M)
    up = rotation @ [0.0, 0.0, 1.0]
    distance = math.sqrt(x * x + y * y + z * z)
    return (
        math.degrees(math.atan2(-y, x)),
        math.degrees(math.asin(z / distance)),
        distance,
        math.degrees(math.atan2(up[0], -up[1])),
    )
