"""Where a camera of a known lens stands at the stage, from an image of the board on the floor."""

from dataclasses import asdict, dataclass

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.film.board import Board
from slipstitch.film.board_diagnosis import check_size
from slipstitch.images.camera import AIM_M, Lens

# From the middle of the track, 30 cm long, and above the floor. A square given in the wrong unit
# puts the camera at a tenth or ten times of its distance.
_NEAREST_M, _FARTHEST_M, _LOWEST_M = 0.2, 5.0, 0.05


@dataclass(frozen=True)
class FloorPlace:
    """Position of the board on the floor: its first corner, its width's direction, its height."""

    x_mm: float
    y_mm: float
    angle_deg: float
    thickness_mm: float

    def record(self) -> dict:
        """The values as a mapping."""
        return asdict(self)

    def on_stage(self, points_m: np.ndarray) -> np.ndarray:
        """Points of the board (N, 3) in the stage's coordinates; the board's face looks up."""
        angle = np.radians(self.angle_deg)
        across = np.array([np.cos(angle), np.sin(angle), 0.0])
        # Seen from above, y of the board is a quarter turn clockwise from its x.
        down = np.array([np.sin(angle), -np.cos(angle), 0.0])
        origin = np.array([self.x_mm, self.y_mm, self.thickness_mm]) / 1e3
        return origin + points_m[:, :1] * across + points_m[:, 1:2] * down


@dataclass(frozen=True)
class StagePose:
    """The camera's place at the stage.

    Attributes
    ----------
    rotation : ndarray (3, 3)
        Stage to camera.
    translation_m : ndarray (3,)
    position_uncertainty_m : float
        Standard deviation of the camera's place, from the scatter of the residuals.
    rms_px : float
    place : FloorPlace
    """

    rotation: np.ndarray
    translation_m: np.ndarray
    position_uncertainty_m: float
    rms_px: float
    place: FloorPlace

    @property
    def position_m(self) -> np.ndarray:
        """The camera's place (3,) in the stage's coordinates."""
        return -self.rotation.T @ self.translation_m

    def summary(self) -> str:
        """The place in a few words."""
        x, y, z = self.position_m * 1e3
        error_mm = 1e3 * self.position_uncertainty_m
        return f"; position ({x:.0f}, {y:.0f}, {z:.0f}) mm, to {error_mm:.1g} mm"


def stage_pose(
    lens: Lens, grey: np.ndarray, board: Board, place: FloorPlace, name: str
) -> StagePose:
    """Return the position of a camera, from one image of the board lying on the floor.

    Parameters
    ----------
    lens : Lens
    grey : ndarray (rows, columns) uint8
    board : Board
    place : FloorPlace
        Where the board lies.
    name : str
        Of the image.

    Raises
    ------
    BadInput
        If the image has another size, no board is found in it, or no camera of a bench could stand
        where this one would.
    """
    if grey.shape[::-1] != tuple(lens.size_px):
        raise BadInput(
            f"{name}: {grey.shape[1]}x{grey.shape[0]} pixels; the lens was calibrated with "
            f"{lens.size_px[0]}x{lens.size_px[1]}"
        )
    seen = board.find(grey)
    if seen is None:
        raise BadInput(f"{name}: no board found in it")
    check_size(board, grey, name)
    points = place.on_stage(seen.points_m.astype(np.float64))
    model = (lens.matrix, lens.distortion)
    corners = seen.corners_px.astype(np.float64)
    _, rvec, tvec = cv2.solvePnP(points, corners, *model, flags=cv2.SOLVEPNP_ITERATIVE)
    projected, jacobian = cv2.projectPoints(points, rvec, tvec, *model)
    residuals = corners - projected.reshape(-1, 2)
    variance = (residuals**2).sum() / (residuals.size - 6)
    covariance = variance * np.linalg.inv(jacobian[:, :6].T @ jacobian[:, :6])
    moved = _place_derivative(rvec, tvec)
    spread = moved @ covariance @ moved.T
    rms_px = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    pose = StagePose(
        cv2.Rodrigues(rvec)[0], tvec.ravel(), float(np.sqrt(np.trace(spread))), rms_px, place
    )
    _check_place(name, pose.position_m, board)
    return pose


def _check_place(name: str, position_m: np.ndarray, board: Board) -> None:
    height_m = position_m[2]
    if height_m <= 0:
        raise BadInput(f"{name}: the camera would be below the floor; is the image mirrored?")
    distance_m = float(np.linalg.norm(position_m - AIM_M))
    if not (_NEAREST_M <= distance_m <= _FARTHEST_M and height_m >= _LOWEST_M):
        raise BadInput(
            f"{name}: the camera would stand {distance_m:.2g} m from the middle of the track and "
            f"{100 * height_m:.2g} cm above the floor; must be {_NEAREST_M:g} to {_FARTHEST_M:g} m "
            f"and at least {100 * _LOWEST_M:g} cm: are the squares {1e3 * board.square_m:g} mm "
            "(--square-mm)?"
        )


def _place_derivative(rvec: np.ndarray, tvec: np.ndarray) -> np.ndarray:
    """Derivatives (3, 6) of the camera's place with respect to rotation vector and translation."""
    rotation, turn = cv2.Rodrigues(rvec)
    # OpenCV gives the derivative of the nine entries of R, row by row.
    by_turn = -np.einsum("kij,il->jk", turn.reshape(3, 3, 3), tvec)
    return np.hstack([by_turn, -rotation.T])
