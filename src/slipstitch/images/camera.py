"""Cameras in OpenCV's convention: where they stand, and what they see where; the cloth's keypoints.

A viewpoint is a camera that stands still on the bench. Rendered images come from pinholes; a real
camera has a lens that distorts. The distortion is taken out of real images, never put into rendered
ones: both then follow the same pinhole (`slipstitch.images.rectification`).
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slipstitch.config.catalogue import Viewpoint

#: Rotation (3, 3) and translation (3,), world to camera.
Pose = tuple[np.ndarray, np.ndarray]

#: The fixed cameras are aimed here: the middle of the stage's travel, between clamps and floor.
AIM_M = (0.15, 0.0, 0.07)
#: What a network may be told of a camera, see `relative_pose`.
POSE = ("yaw_deg", "pitch_deg", "roll_deg", "log_distance")


@dataclass(frozen=True)
class Lens:
    """A lens that distorts, before a sensor."""

    size_px: tuple[int, int]  # width, height
    matrix: np.ndarray  # (3, 3): as of `Camera`
    distortion: np.ndarray  # (5,): k1, k2, p1, p2, k3 of OpenCV


@dataclass(frozen=True)
class Camera:
    """A camera: x_camera = rotation @ x_world + translation_m, z forward, y down."""

    rotation: np.ndarray  # (3, 3): world to camera
    translation_m: np.ndarray  # (3,)
    # (3, 3): intrinsics in pixels; the centre of the first pixel is (0, 0), as in OpenCV. May have
    # two focal lengths (pixels that are not square), but no skew
    matrix: np.ndarray
    pixels: int  # columns of the image; rows too, unless `rows` says otherwise
    rows: int | None = None  # rows of an image that is not square
    # (5,): k1, k2, p1, p2, k3 of OpenCV, of a real camera; None for a pinhole
    distortion: np.ndarray | None = None

    @property
    def pose(self) -> Pose:
        """Rotation and translation, world to camera."""
        return self.rotation, self.translation_m

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the image."""
        return self.pixels, self.rows or self.pixels

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Pixel coordinates (N, 2) of world points (N, 3)."""
        if self.distortion is None:
            image = (points_m @ self.rotation.T + self.translation_m) @ self.matrix.T
            return image[:, :2] / image[:, 2:]
        turn, _ = cv2.Rodrigues(self.rotation)
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        lens = (self.translation_m, self.matrix, self.distortion)
        return cv2.projectPoints(points, turn, *lens)[0].reshape(-1, 2)

    def at_resolution(self, pixels: int) -> "Camera":
        """The same view with another number of columns, and of rows in proportion."""
        scale = pixels / self.pixels
        matrix = self.matrix.copy()
        matrix[:2, :2] *= scale
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * scale - 0.5
        rows = None if self.rows is None else round(self.rows * scale)
        return replace(self, matrix=matrix, pixels=pixels, rows=rows)

    def with_margin(self, margin: int) -> "Camera":
        """A square image and so many pixels more on every side."""
        matrix = self.matrix.copy()
        matrix[:2, 2] += margin
        return replace(self, matrix=matrix, pixels=self.pixels + 2 * margin, rows=None)


def pose(viewpoint: Viewpoint) -> Pose:
    """Pose of the fixed camera of a viewpoint in the catalogue."""
    azimuth, elevation = map(math.radians, (viewpoint.azimuth_deg, viewpoint.elevation_deg))
    flat = math.cos(elevation)
    backwards = np.array([math.cos(azimuth) * flat, -math.sin(azimuth) * flat, math.sin(elevation)])
    position = np.array(AIM_M) + viewpoint.distance_m * backwards
    forward = -backwards
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ position


def turned(rotation: np.ndarray, translation_m: np.ndarray, turn_deg: float) -> Pose:
    """A camera's pose after walking round `AIM_M`, by how much its azimuth grows."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    # The camera walks clockwise seen from above; the world, as it sees it, turns the other way.
    about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    aim = np.array(AIM_M)
    return rotation @ about, rotation @ (aim - about @ aim) + translation_m


def relative_pose(camera: Pose, viewpoint: Pose) -> dict[str, float]:
    """Pose of a camera relative to a viewpoint: the numbers of `POSE`."""
    azimuth, elevation, distance, roll = zip(
        _spherical(*camera), _spherical(*viewpoint), strict=True
    )
    return {
        "yaw_deg": (azimuth[0] - azimuth[1] + 180) % 360 - 180,
        "pitch_deg": elevation[0] - elevation[1],
        "roll_deg": (roll[0] - roll[1] + 180) % 360 - 180,
        "log_distance": math.log(distance[0] / distance[1]),
    }


def _spherical(rotation: np.ndarray, translation_m: np.ndarray) -> tuple[float, ...]:
    """Azimuth, elevation (degrees), distance (m) about `AIM_M`, and tilt of the image (degrees)."""
    x, y, z = -rotation.T @ translation_m - np.array(AIM_M)
    up = rotation @ [0.0, 0.0, 1.0]
    distance = math.sqrt(x * x + y * y + z * z)
    azimuth, elevation = math.atan2(-y, x), math.asin(z / distance)
    roll = math.degrees(math.atan2(up[0], -up[1]))
    return math.degrees(azimuth), math.degrees(elevation), distance, roll


#: Texture coordinates of the keypoints: three rows below the clamps, three points each.
KEYPOINTS_UV = np.array([(u, v) for v in (1 / 3, 2 / 3, 1.0) for u in (0.0, 0.5, 1.0)])


def keypoints_m(positions_m: np.ndarray, uv: np.ndarray, stage_x_m: np.ndarray) -> np.ndarray:
    """Places (T, 9, 3) of the vertices nearest to `KEYPOINTS_UV`, of vertices (T, V, 3).

    Metres along the track relative to the clamps `stage_x_m` (T,), across it, above the floor.
    """
    nearest = np.linalg.norm(uv[None] - KEYPOINTS_UV[:, None], axis=2).argmin(axis=1)
    places = positions_m[:, nearest].astype(np.float64)
    places[..., 0] -= stage_x_m[:, None]
    return places
