"""The rendered frames of a trajectory, and the camera of each."""

from dataclasses import dataclass

import numpy as np

from slipstitch.config.render import RenderSettings
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.images.bench_camera import BenchCamera, bench_room
from slipstitch.images.calibrated_view import CalibratedView, crop_to
from slipstitch.images.camera import Camera
from slipstitch.physics.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Shot:
    """One frame to render: its row in the trajectory, its number, its time, its camera."""

    row: int
    frame: int
    time_s: float
    camera: Camera


def shots(
    trajectory: Trajectory,
    viewpoint: str,
    settings: RenderSettings,
    frames_sampled: int,
    bench: BenchCamera | None = None,
) -> list[Shot]:
    """The frames to render and the crop of each.

    Parameters
    ----------
    trajectory : Trajectory
    viewpoint : str
        By name.
    settings : RenderSettings
    frames_sampled : int
        How many frames the sample stage uses.
    bench : BenchCamera, optional
        Where the camera of a drawn viewpoint stands.
    """
    count = len(trajectory.frame)
    sampled = settings.frames == "sampled"
    rows = sampled_frames(count, frames_sampled) if sampled else np.arange(count)
    calibrated = CalibratedView.of_trajectory(trajectory, viewpoint, settings)
    result = []
    for row in rows:
        time_s = float(trajectory.time_s[row])
        camera = calibrated.crop(time_s)
        if bench:
            pixels = round(settings.pixels * settings.bench_camera.oversampling)
            room = bench_room(camera, float(trajectory.stage_x_m[row]), calibrated.room(time_s))
            camera = crop_to(bench.pose(*calibrated.pose), room, pixels)
        result.append(Shot(int(row), int(trajectory.frame[row]), time_s, camera))
    return result


def share_in_image(trajectory: Trajectory, shot: Shot) -> float:
    """Share of the cloth's vertices that project into the image."""
    place = shot.camera.project(trajectory.positions_m[shot.row].astype(np.float64))
    inside = (place > -0.5) & (place < shot.camera.pixels - 0.5)
    return float(inside.all(axis=1).mean())


def camera_record(
    wanted: list[Shot], settings: RenderSettings, bench: BenchCamera | None = None
) -> dict:
    """The cameras of all shots, as a shard's metadata holds them."""
    first = wanted[0].camera
    return {
        "convention": "OpenCV: x_camera = rotation x_world + translation_m; x right, y down, "
        "z forward; the centre of the first pixel is (0, 0); no distortion",
        "crop": settings.crop,
        "pixels": first.pixels,
        "bench": bench and bench.record(),
        "rotation": first.rotation.tolist(),
        "translation_m": first.translation_m.tolist(),
        "frames": {
            str(shot.frame): {
                "focal_px": shot.camera.matrix[0, 0],
                "principal_point_px": shot.camera.matrix[:2, 2].tolist(),
            }
            for shot in wanted
        },
    }


def recorded_shots(record: dict, trajectory: Trajectory) -> list[Shot]:
    """The shots whose `camera_record` this is."""
    rotation, translation = np.array(record["rotation"]), np.array(record["translation_m"])
    rows = {int(frame): row for row, frame in enumerate(trajectory.frame)}
    result = []
    for frame, crop in record["frames"].items():
        focal, (x, y) = crop["focal_px"], crop["principal_point_px"]
        matrix = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
        camera = Camera(rotation, translation, matrix, record["pixels"])
        row = rows[int(frame)]
        result.append(Shot(row, int(frame), float(trajectory.time_s[row]), camera))
    return result
