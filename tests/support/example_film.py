"""Films made from the example that comes with Slipstitch: its images, altered and written anew."""

from pathlib import Path

import cv2
import numpy as np

from slipstitch.film.measure import EXAMPLE_CAMERA, EXAMPLE_VIDEO
from slipstitch.film.recording import Recording
from slipstitch.images.camera import Camera
from slipstitch.images.camera_file import read_camera_file
from support import analytic_stage as stage


def images_and_times() -> tuple[list[np.ndarray], list[float]]:
    """All images of the example (rows, columns, 3), red first, and their times in s."""
    moments = [(one.image()[..., ::-1], one.time_s) for one in Recording(EXAMPLE_VIDEO).moments()]
    images, times_s = zip(*moments, strict=True)
    return list(images), list(times_s)


def rolled(folder: Path, roll_deg: float, side_px: int = 300) -> tuple[Path, Path]:
    """The example as a rolled camera without distortion would have filmed it; the camera file."""
    seen = read_camera_file(EXAMPLE_CAMERA)
    turn, _ = cv2.Rodrigues(np.radians([0.0, 0.0, roll_deg]))
    middle = (side_px - 1) / 2
    focal_px = seen.matrix[0, 0]
    matrix = np.array([[focal_px, 0, middle], [0, focal_px, middle], [0, 0, 1.0]])
    rotation, place = turn @ seen.rotation, turn @ seen.translation_m
    camera = stage.camera_file(
        Camera(rotation, place, matrix, side_px, side_px, np.zeros(5)), folder / "rolled.json"
    )
    y, x = np.mgrid[:side_px, :side_px].reshape(2, -1)
    rays = np.column_stack([x, y, np.ones(x.size)]) @ np.linalg.inv(matrix).T @ turn
    source, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), seen.matrix, seen.distortion)
    where = source.reshape(side_px, side_px, 2).astype(np.float32)
    images, times_s = images_and_times()
    turned = (cv2.remap(image, where, None, cv2.INTER_LINEAR) for image in images)
    return stage.write_video(folder / "rolled.mp4", turned, times_s), camera
