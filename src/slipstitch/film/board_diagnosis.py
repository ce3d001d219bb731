"""What is seen in images in which a board is not: markers of other kinds, a checkerboard."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.film.board import Board, small_image

# Marker sets, the smaller ones first: a set's first markers are those of the next larger one.
_DICTIONARIES = (
    *(
        f"DICT_{bits}X{bits}_{count}"
        for bits in (4, 5, 6, 7)
        for count in (50, 100, 250, 1000)
    ),
    "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
)  # fmt: skip
_FEWEST_MARKERS = 4
# By how much the measured side of a marker may differ from the stated one, as a share of a square.
_SIDE_TOLERANCE = 0.05
_IMAGES_TRIED = 5


def what_is_seen(board: Board, images: Iterable[np.ndarray]) -> str:
    """Return in a few words what grey images show in place of a board; empty if it is nothing."""
    seen: tuple[int, str] = (0, "")
    for _, grey in zip(range(_IMAGES_TRIED), images, strict=False):
        found = _markers(board, grey) or _checkerboard(board, grey)
        seen = max(seen, found or seen, key=lambda one: one[0])
    return seen[1]


def _markers(board: Board, grey: np.ndarray) -> tuple[int, str] | None:
    """Number of markers in an image and what they are of."""
    names = dict.fromkeys([board.dictionary, *_DICTIONARIES] if board.dictionary else _DICTIONARIES)
    best: tuple[str, np.ndarray, Sequence[np.ndarray]] | None = None
    for name in names:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        corners, ids, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(grey)
        found = np.zeros(0, int) if ids is None else ids.ravel()
        # Each marker of a board is there once.
        if len(np.unique(found)) == len(found) > (len(best[1]) if best else _FEWEST_MARKERS - 1):
            best = name, found, corners
    if best is None:
        return None
    name, ids, corners = best
    where = f"{len(ids)} markers of {name}, numbers {ids.min()} to {ids.max()}, are seen"
    if not board.marker_m:
        return len(ids), f"{where}: --board charuco"
    if name != board.dictionary:
        return len(ids), f"{where}: --dictionary {name}"
    columns, rows = board.squares
    expected = columns * rows // 2
    if ids.max() >= expected or len(ids) == ids.max() + 1 < expected:
        of = f"{ids.max() + 1} markers or more" if len(ids) <= ids.max() else f"{len(ids)} markers"
        return len(ids), f"{where}: a board of {of}; {columns}x{rows} squares have {expected}"
    turned = replace(board, squares=(rows, columns))
    if columns != rows and turned.find(grey) is not None:
        return len(ids), f"{where}, on {rows}x{columns} squares: width and height are swapped"
    side = _marker_side(corners)
    stated = board.marker_m / board.square_m
    if abs(side - stated) > _SIDE_TOLERANCE:
        return len(ids), (
            f"{where}, whose sides are about {side:.2f} of a square; --marker-mm is "
            f"{stated:.2f} of --square-mm"
        )
    return len(ids), f"{where}, but too few corners of squares between them"


def _marker_side(corners: Sequence[np.ndarray]) -> float:
    """Side of the markers in units of a square, by the distance of diagonal neighbours."""
    quads = np.array(corners).reshape(-1, 4, 2)
    sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).mean(axis=1)
    middles = quads.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - middles, axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(np.median(sides / apart.min(axis=1)) * np.sqrt(2))


def _checkerboard(board: Board, grey: np.ndarray) -> tuple[int, str] | None:
    """Number of corners of a checkerboard in an image, and its size."""
    seen = _squares_seen(grey)
    if seen is None:
        return None
    columns, rows = seen
    what = f"a checkerboard of {columns}x{rows} squares is seen"
    if board.marker_m:
        what += ", without markers: --board checkerboard"
    elif sorted((columns - 1, rows - 1)) == sorted(board.squares):
        what += f", which has {columns - 1}x{rows - 1} inner corners: --squares counts squares"
    return (columns - 1) * (rows - 1), what


def _squares_seen(grey: np.ndarray) -> tuple[int, int] | None:
    """Squares along width and height of a checkerboard of any size, None if there is none."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(small_image(grey)[0], (3, 3), flags)
    return (meta.shape[1] + 1, meta.shape[0] + 1) if found else None


def check_size(board: Board, grey: np.ndarray, name: str) -> None:
    """Refuse a checkerboard that is part of a larger one: its first corner would be another.

    Parameters
    ----------
    board : Board
        As stated.
    grey : ndarray (rows, columns) uint8
        An image in which it was found.
    name : str
        Of the image.
    """
    if board.marker_m or (seen := _squares_seen(grey)) is None:
        return
    if min(seen) > min(board.squares) or max(seen) > max(board.squares):
        _, what = _checkerboard(board, grey) or (0, "")
        raise BadInput(f"{name}: not {board.squares[0]}x{board.squares[1]} squares; {what}")
