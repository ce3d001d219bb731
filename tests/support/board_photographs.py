"""Photographs of a calibration board through a known lens: Blender draws, the lens distorts."""

import cv2
import numpy as np

from slipstitch.images.blender import ClothScene
from slipstitch.images.camera import Camera

SQUARES, SQUARE_M, MARKER_M, DICTIONARY = (10, 7), 0.025, 0.019, "DICT_4X4_50"
SIZE = (480, 360)
MATRIX = np.array([[612.0, 0, 250.5], [0, 631.0, 171.0], [0, 0, 1]])
DISTORTION = np.array([-0.24, 0.11, 0.0012, -0.0009, 0.0])
# Where the camera stands at the stage, and the board on the floor: first corner, angle, thickness.
POSITION_M = np.array([0.55, -0.32, 0.6])
PLACE_MM, ANGLE_DEG, THICKNESS_MM = (30.0, 90.0), -12.0, 3.0

_MARGIN_PX = 60  # what the lens pulls in from beyond the pinhole's image
TEXELS = 60  # a square


def board_image(
    squares=SQUARES, marker=0.75, dictionary="DICT_5X5_100", is_legacy=False
) -> np.ndarray:
    """A ChArUco board, or without a dictionary a checkerboard, with a white margin of a square.

    8-bit, row 0 on top. `marker` is the side of a marker, in squares.
    """
    if dictionary is None:
        y, x = np.mgrid[: squares[1], : squares[0]]
        # The dark corners are those on the left.
        image = 255 * np.kron((x + y) % 2, np.ones((TEXELS, TEXELS))).astype(np.uint8)
    else:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        board = cv2.aruco.CharucoBoard(squares, 1.0, marker, markers)
        board.setLegacyPattern(is_legacy)
        image = board.generateImage((squares[0] * TEXELS, squares[1] * TEXELS))
    return np.pad(image, TEXELS, constant_values=255)


def own_image(charuco: bool = False) -> np.ndarray:
    """The board that is photographed, grey in 0 ... 1."""
    return board_image(SQUARES, MARKER_M / SQUARE_M, DICTIONARY if charuco else None) / 255.0


def camera_pose() -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation, stage to camera: it looks at the middle of the stage's travel."""
    forward = np.array([0.15, 0.0, 0.0]) - POSITION_M
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    # Somewhat rolled, as no tripod stands upright.
    roll = np.radians(3.0)
    down = np.cross(forward, right)
    right, down = (
        np.cos(roll) * right + np.sin(roll) * down,
        np.cos(roll) * down - np.sin(roll) * right,
    )
    rotation = np.stack([right, down, forward])
    return rotation, -rotation @ POSITION_M


def board_places(count: int, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotations and translations, board to camera, of a board held in front of the camera."""
    rng = np.random.default_rng(seed)
    middle = np.array([SQUARES[0], SQUARES[1], 0]) * SQUARE_M / 2
    places = []
    for _ in range(count):
        turn, _ = cv2.Rodrigues(rng.uniform(-1, 1, 3) * (0.7, 0.7, 0.3))
        depth = rng.uniform(0.48, 0.58)
        at = np.array([*rng.uniform(-0.06, 0.06, 2) * (1, 0.7), depth])
        places.append((turn, at - turn @ middle))
    return places


def floor_place() -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation, board to camera, of the board on the floor."""
    angle = np.radians(ANGLE_DEG)
    to_stage = np.array(
        [[np.cos(angle), np.sin(angle), 0], [np.sin(angle), -np.cos(angle), 0], [0, 0, -1.0]]
    )
    corner = np.array([*PLACE_MM, THICKNESS_MM]) / 1e3
    rotation, translation = camera_pose()
    return rotation @ to_stage, rotation @ corner + translation


class Photographer:
    """Photographs one board through the lens."""

    def __init__(self, charuco: bool = False):
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
        self.scene = ClothScene(np.array([[0, 1, 2], [0, 2, 3]]), uv)
        self.scene.wear(np.repeat(0.02 + 0.7 * own_image(charuco)[..., None], 3, axis=2))
        extent = np.array([SQUARES[0] + 2, SQUARES[1] + 2]) * SQUARE_M
        self.corners = np.column_stack([uv * extent - SQUARE_M, np.zeros(4)])
        wide = MATRIX.copy()
        wide[:2, 2] += _MARGIN_PX
        self.pinhole = Camera(
            *camera_pose(), wide, SIZE[0] + 2 * _MARGIN_PX, SIZE[1] + 2 * _MARGIN_PX
        )
        y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
        seen = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
        # More steps than OpenCV's five: its error would be of the order of the corners'.
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
        at = cv2.undistortPointsIter(seen, MATRIX, DISTORTION, None, wide, until)
        self.map = at.reshape(*SIZE[::-1], 2).astype(np.float32)

    def photograph(self, turn: np.ndarray, at: np.ndarray, seed: int = 0) -> np.ndarray:
        """Grey image (360, 480) uint8 of the board at this place in the camera's coordinates."""
        local = self.corners @ turn.T + at
        stage = (local - self.pinhole.translation_m) @ self.pinhole.rotation
        radiance = self.scene.render(stage, self.pinhole, samples=4, seed=seed).radiance
        light = radiance.sum(axis=0).mean(axis=-1)
        seen = cv2.remap(light, self.map, None, cv2.INTER_CUBIC)
        return np.rint(255 * np.clip(seen / 1.1, 0, 1) ** (1 / 2.2)).astype(np.uint8)
