"""The rendered frames of a trajectory, and the camera of each."""

from dataclasses import dataclass

import numpy as np

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.config.render import RenderSettings
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.images.bench_camera import BenchCamera, bench_room
from slipstitch.images.camera import Camera, Pose, cloth_room, crop_to, pose, turned
from slipstitch.images.camera_file import read_camera_file
from slipstitch.physics.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Shot:
    """One frame to render."""

    row: int
    frame: int
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
    if settings.frames == "all":
        rows = np.arange(count)
    else:
        rows = sampled_frames(count, frames_sampled)
    width, length = cloth_size(trajectory)
    x, z = trajectory.stage_x_m, trajectory.stage_z_m
    fixed = viewpoint_pose(viewpoint, settings)
    result = []
    for row in rows:
        at_x, at_z = (x, z) if settings.crop == "fixed" else (x[row], z[row])
        room = cloth_room(at_x, at_z, width, length)
        camera = crop_to(fixed, room, settings.pixels)
        if bench:
            pixels = round(settings.pixels * settings.bench_camera.oversampling)
            room = bench_room(camera, float(x[row]), room)
            camera = crop_to(bench.pose(*fixed), room, pixels)
        result.append(Shot(int(row), int(trajectory.frame[row]), camera))
    return result


def viewpoint_pose(viewpoint: str, settings: RenderSettings) -> Pose:
    """Pose of a viewpoint's fixed camera: from the calibration or the catalogue."""
    seen_from = VIEWPOINTS[viewpoint]
    path = settings.camera_of(viewpoint)
    if path is None:
        return pose(seen_from)
    turn = seen_from.azimuth_deg - VIEWPOINTS["calibrated"].azimuth_deg
    return turned(*read_camera_file(path).pose, turn)


def cloth_size(trajectory: Trajectory) -> tuple[float, float]:
    """Width and length (m) of the cloth at rest, over which u and v run from 0 to 1.

    By least squares, whatever plane the rest mesh lies in.
    """
    design = np.column_stack([trajectory.uv, np.ones(len(trajectory.uv))])
    along = np.linalg.lstsq(design, trajectory.rest_positions_m, rcond=None)[0]
    width, length = np.linalg.norm(along[:2], axis=1)
    return float(width), float(length)


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
        result.append(Shot(rows[int(frame)], int(frame), camera))
    return result
