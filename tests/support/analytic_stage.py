"""A bench drawn ray by ray: a flat cloth that moves with the stage over a patterned floor.

Every pixel's light is a formula, so that the image of any camera, with or without a lens, is known.
The cloth is rigid: it keeps hanging where the clamps are and ends at the floor.
"""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from slipstitch.config import Config, resolve_config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.film.frame_schedule import Schedule
from slipstitch.images.camera import Camera, pose
from slipstitch.images.camera_file import camera_record, write_camera_file

PATH = StagePath()
SIZE = (320, 240)
DISTORTION = np.array([-0.16, 0.05, 0.0012, -0.0008, 0.0])
_RAYS = 2


def lens_camera(
    rotation: np.ndarray,
    translation_m: np.ndarray,
    size: tuple[int, int] = SIZE,
    focal_px: float = 552.0,
    distortion: np.ndarray = DISTORTION,
) -> Camera:
    """A camera that sees the whole track from 1.4 m."""
    scale = size[0] / SIZE[0]
    focal_px *= scale
    middle = size[0] / 2 - 4.5, size[1] / 2 - 3
    matrix = np.array([[focal_px, 0, middle[0]], [0, 1.01 * focal_px, middle[1]], [0, 0, 1.0]])
    return Camera(rotation, translation_m, matrix, *size, distortion)


#: At the calibrated viewpoint.
LENS = lens_camera(*pose(VIEWPOINTS["calibrated"]))


def protocol(frames: int = 24, sampled: int = 6, pixels: int = 64) -> tuple[Config, Schedule]:
    """A configuration that simulates and samples so many frames, and which of a film are needed."""
    counts = {"simulation": {"frames": frames}, "sample": {"frames": sampled}}
    config = resolve_config(counts | {"render": {"pixels": pixels}})
    return config, Schedule.of(config)


def camera_file(camera: Camera, path: Path) -> Path:
    """The camera file of a camera."""
    write_camera_file(path, camera_record(camera))
    return path


class Bench:
    """What one camera sees, at any time of the protocol."""

    def __init__(self, camera: Camera, lifted_m: float = 0.0):
        self.lifted_m = lifted_m  # by which the clamps hang too high
        columns, rows = camera.size_px
        self.shape = (rows, columns)
        part = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
        y, x = np.meshgrid(
            (np.arange(rows)[:, None] + part).ravel(),
            (np.arange(columns)[:, None] + part).ravel(),
            indexing="ij",
        )
        pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
        lens = np.zeros(5) if camera.distortion is None else camera.distortion
        flat = cv2.undistortPointsIter(pixels, camera.matrix, lens, None, None, until)[:, 0]
        self.rays = np.column_stack([flat, np.ones(len(flat))]) @ camera.rotation
        self.eye = -camera.rotation.T @ camera.translation_m
        floor = self.eye + (-self.eye[2] / self.rays[:, 2])[:, None] * self.rays
        self.floor = np.where(self.rays[:, 2] < 0, _floor_light(floor), 0.006)
        self.rest = None

    def light(self, time_s: float) -> np.ndarray:
        """Linear light (rows, columns, 3) at a time of the protocol; before 0 nothing moves."""
        if time_s <= 0 and self.rest is not None:
            return self.rest
        x_m, z_m = PATH.position_m(max(time_s, 0.0)) + np.array([0.0, self.lifted_m])
        along = (x_m - self.eye[0]) / self.rays[:, 0]
        y = self.eye[1] + along * self.rays[:, 1]
        z = self.eye[2] + along * self.rays[:, 2]
        down = z_m - z
        cloth = (along > 0) & (abs(y) < SIDE_M / 2) & (down > 0) & (down < SIDE_M) & (z > 0)
        grey = self.floor.copy()
        grey[cloth] = _cloth_light(y[cloth], down[cloth])
        rows, columns = self.shape
        grey = grey.reshape(rows, _RAYS, columns, _RAYS).mean(axis=(1, 3))
        light = grey[..., None] * np.array([1.0, 0.9, 0.75])
        if time_s <= 0:
            self.rest = light
        return light

    def image(self, time_s: float) -> np.ndarray:
        """8-bit sRGB image, red first."""
        linear = np.clip(self.light(time_s), 0, 1)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        return np.rint(255 * encoded).astype(np.uint8)


def _floor_light(points_m: np.ndarray) -> np.ndarray:
    x, y = points_m[:, 0], points_m[:, 1]
    pattern = 0.16 + 0.04 * np.sin(2 * np.pi * x / 0.05) * np.sin(2 * np.pi * y / 0.06)
    return np.where((abs(x - 0.15) < 0.49) & (abs(y) < 0.3), pattern, 0.006)


def _cloth_light(y: np.ndarray, down: np.ndarray) -> np.ndarray:
    """A checkerboard of 2.5 cm squares with something finer on it."""
    board = (np.floor(y / 0.025) + np.floor(down / 0.025)) % 2
    return 0.15 + 0.45 * board + 0.06 * np.sin(2 * np.pi * (1.3 * y + down) / 0.031)


def write_video(path: Path, images, times_s, codec: str = "libx264", **options: str) -> Path:
    """A video of 8-bit images, red first, each with its own time; options are FFmpeg's."""
    clock = Fraction(1, 90000)
    with av.open(str(path), "w") as container:
        stream = None
        for image, time_s in zip(images, times_s, strict=True):
            if stream is None:
                stream = container.add_stream(codec, rate=30, options={"crf": "16", **options})
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.time_base = stream.codec_context.time_base = clock
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = round(time_s / clock), clock
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_avi(path: Path, images, codec: str = "MJPG") -> Path:
    """A film of 5 frames a second, written by OpenCV; blue first."""
    first, *others = images
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 5.0, first.shape[1::-1])
    for image in (first, *others):
        film.write(image)
    film.release()
    return path
