"""Photographs of a flat calibration board through a known lens."""

import functools

import cv2
import numpy as np

SQUARES, SQUARE_M, MARKER_M, DICTIONARY = (10, 7), 0.025, 0.019, "DICT_4X4_50"
SIZE = (480, 360)
MATRIX = np.array([[612.0, 0, 250.5], [0, 631.0, 171.0], [0, 0, 1]])
DISTORTION = np.array([-0.24, 0.11, 0.0012, -0.0009, 0.0])
# Where the camera stands at the stage, and the board on the floor: first corner, angle, thickness.
POSITION_M = np.array([0.55, -0.32, 0.6])
PLACE_MM, ANGLE_DEG, THICKNESS_MM = (30.0, 90.0), -12.0, 3.0

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
    """The board that is photographed."""
    return board_image(SQUARES, MARKER_M / SQUARE_M, DICTIONARY if charuco else None)


def camera_pose() -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation, stage to camera: it looks at the middle of the stage's travel."""
    forward = np.array([0.15, 0.0, 0.0]) - POSITION_M
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    # Somewhat rolled, as no tripod stands upright.
    roll, _ = cv2.Rodrigues(np.radians([0.0, 0.0, -3.0]))
    rotation = roll @ np.stack([right, np.cross(forward, right), forward])
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


@functools.cache
def _rays(matrix: tuple, distortion: tuple, size: tuple[int, int]) -> np.ndarray:
    """Directions (rows * columns, 1, 2) in which a lens looks, four a pixel."""
    y, x = (np.mgrid[: 2 * size[1], : 2 * size[0]] + 0.5) / 2 - 0.5
    # More steps than OpenCV's five: its error would be of the order of the corners'.
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    seen, lens = np.stack([x, y], axis=-1).reshape(-1, 1, 2), np.reshape(matrix, (3, 3))
    return cv2.undistortPointsIter(seen, lens, np.array(distortion), None, None, until)


def photograph(
    board: np.ndarray, turn: np.ndarray, at: np.ndarray, matrix=MATRIX, distortion=DISTORTION,
    size=SIZE, square_m=SQUARE_M,
) -> np.ndarray:  # fmt: skip
    """Grey image uint8 of a `board_image` at this place in the camera's coordinates; noisy."""
    rays = _rays(tuple(matrix.ravel()), tuple(distortion), size)
    on_board = cv2.perspectiveTransform(rays, np.linalg.inv(np.column_stack([turn[:, :2], at])))
    texels = ((on_board / square_m + 1) * TEXELS - 0.5).astype(np.float32)
    shown = 0.1 + 0.8 * cv2.GaussianBlur(board / 255.0, (0, 0), 1.0)
    fine = cv2.remap(shown, texels.reshape(2 * size[1], -1, 2), None, cv2.INTER_LINEAR, None,
                     cv2.BORDER_CONSTANT, 0.4)  # fmt: skip
    light = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(0, 1.5, light.shape)
    return np.rint(np.clip(255 * light ** (1 / 2.2) + noise, 0, 255)).astype(np.uint8)
