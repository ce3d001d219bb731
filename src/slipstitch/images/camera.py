"""Pinhole cameras in OpenCV's convention, and the crop that follows the stage.

A viewpoint is a camera that stands still on the bench. The image is a square crop of what it sees:
the smallest square that holds a room around the stage which the cloth cannot leave. The stage path
is known, so the same crop can be cut from a real video. A crop of a pinhole image is a pinhole
image with other intrinsics, which is how Blender renders it directly.
"""

import math
from dataclasses import dataclass

import numpy as np

from slipstitch.config.catalogue import Viewpoint

#: Rotation (3, 3) and translation (3,), world to camera.
Pose = tuple[np.ndarray, np.ndarray]

#: The fixed cameras are aimed here: the middle of the stage's travel, between clamps and floor.
AIM_M = (0.15, 0.0, 0.07)

# Where the cloth can be, in units of its length: this far from under the clamps, at this share of
# their height. A taut sheet of length L held at height 0.75 L reaches 0.66 L along the floor; a
# hanging one does not, which leaves room for stretch and for a yawed clamp.
_REACH = ((0.0, 0.66), (0.35, 0.55), (1.0, 0.12))
_HALF_WIDTH = 0.54
_MARGIN = 1.03


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: x_camera = rotation @ x_world + translation_m, z forward, y down.

    Attributes
    ----------
    rotation : ndarray (3, 3)
        World to camera.
    translation_m : ndarray (3,)
    matrix : ndarray (3, 3)
        Intrinsics in pixels; the centre of the first pixel is (0, 0), as in OpenCV.
        May have two focal lengths (pixels that are not square), but no skew.
    pixels : int
        Columns of the image; rows too, unless `rows` says otherwise.
    rows : int, optional
        Rows of an image that is not square.
    """

    rotation: np.ndarray
    translation_m: np.ndarray
    matrix: np.ndarray
    pixels: int
    rows: int | None = None

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Pixel coordinates (N, 2) of world points (N, 3)."""
        image = (points_m @ self.rotation.T + self.translation_m) @ self.matrix.T
        return image[:, :2] / image[:, 2:]

    def at_resolution(self, pixels: int) -> "Camera":
        """The same view with another number of columns, and of rows in proportion."""
        scale = pixels / self.pixels
        matrix = self.matrix.copy()
        matrix[:2, :2] *= scale
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * scale - 0.5
        rows = None if self.rows is None else round(self.rows * scale)
        return Camera(self.rotation, self.translation_m, matrix, pixels, rows)

    def with_margin(self, margin: int) -> "Camera":
        """A square image and so many pixels more on every side."""
        matrix = self.matrix.copy()
        matrix[:2, 2] += margin
        return Camera(self.rotation, self.translation_m, matrix, self.pixels + 2 * margin)


def pose(viewpoint: Viewpoint) -> Pose:
    """Pose of the fixed camera of a viewpoint in the catalogue."""
    azimuth, elevation = (
        math.radians(viewpoint.azimuth_deg),
        math.radians(viewpoint.elevation_deg),
    )
    backwards = np.array(
        [
            math.cos(azimuth) * math.cos(elevation),
            -math.sin(azimuth) * math.cos(elevation),
            math.sin(elevation),
        ]
    )
    position = np.array(AIM_M) + viewpoint.distance_m * backwards
    forward = -backwards
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    rotation = np.stack([right, down, forward])
    return rotation, -rotation @ position


def cloth_room(
    stage_x_m: float | np.ndarray, stage_z_m: float | np.ndarray, width_m: float, length_m: float
) -> np.ndarray:
    """Corners (N, 3) of a room around the stage that the cloth stays in.

    Parameters
    ----------
    stage_x_m, stage_z_m : float or array
        Place of the clamps; of several places, the room holds all.
    width_m, length_m : float
        Of the cloth at rest: along its upper edge, and from there to its lower edge.
    """
    first, last, top = np.min(stage_x_m), np.max(stage_x_m), np.max(stage_z_m)
    corners = [
        (x, side * _HALF_WIDTH * width_m, share * top)
        for share, reach in _REACH
        for x in (first - reach * length_m, last + reach * length_m)
        for side in (-1, 1)
    ]
    return np.array(corners)


def turned(rotation: np.ndarray, translation_m: np.ndarray, turn_deg: float) -> Pose:
    """A camera's rotation and translation after walking round the vertical through `AIM_M`.

    Parameters
    ----------
    rotation, translation_m : ndarray (3, 3), (3,)
        World to camera.
    turn_deg : float
        By how much the camera's azimuth grows, see `Viewpoint.azimuth_deg`.
    """
    turn = math.radians(turn_deg)
    # The camera walks clockwise seen from above; the world, as it sees it, turns the other way.
    about = np.array(
        [
            [math.cos(turn), -math.sin(turn), 0.0],
            [math.sin(turn), math.cos(turn), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    aim = np.array(AIM_M)
    return rotation @ about, rotation @ (aim - about @ aim) + translation_m


def crop_to(fixed: Pose, room_m: np.ndarray, pixels: int) -> Camera:
    """A fixed camera's image, cropped to the smallest square around these points (N, 3).

    Parameters
    ----------
    fixed : Pose
    room_m : ndarray (N, 3)
    pixels : int
        Side of the image.
    """
    rotation, translation = fixed
    local = room_m @ rotation.T + translation
    image = local[:, :2] / local[:, 2:]
    low, high = image.min(axis=0), image.max(axis=0)
    focal = pixels / (_MARGIN * np.max(high - low))
    centre = (pixels - 1) / 2 - focal * (low + high) / 2
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
    return Camera(rotation, translation, matrix, pixels)
