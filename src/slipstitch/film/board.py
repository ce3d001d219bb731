"""Calibration boards: their geometry, and what an image shows of one, or in its place.

Coordinates on a board, in metres: the origin is the outer corner of its first square, x runs along
its width, y along its height so that (x, y) looks as in the image of the board, y downwards; z
points into the board. A checkerboard's first square is the dark one at a corner from which the
width runs along x: with one odd and one even number of squares there is exactly one.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import image_bytes
from slipstitch.film.recording import Recording
from slipstitch.images.encoding import decode_image

_SEARCH_PX = 1000  # a board that cannot be seen in an image of this width is not there
_FEWEST_CORNERS = 12
_MOST_SQUARES = 100  # along a side
_WITHIN_SQUARE = 0.4  # as far from a corner, no edge but its own is seen
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


@dataclass(frozen=True)
class Sighting:
    """A board's corners in one image."""

    points_m: np.ndarray  # (N, 3) float32: on the board
    corners_px: np.ndarray  # (N, 2) float32: in the image; the centre of the first pixel is (0, 0)


@dataclass(frozen=True)
class Board:
    """A checkerboard, or a ChArUco board if it has markers."""

    squares: tuple[int, int]  # along its width and its height
    square_m: float
    marker_m: float | None = None
    dictionary: str | None = None  # OpenCV's name of the set of markers

    @classmethod
    def named(
        cls, kind: str, squares: str, square_mm: float, marker_mm: float | None, dictionary: str
    ) -> "Board":
        """A board from the words of the command line; BadInput if no such board exists."""
        found = re.fullmatch(r"(\d{1,3})x(\d{1,3})", squares)
        size = (int(found[1]), int(found[2])) if found else (0, 0)
        if min(size) < 4 or max(size) > _MOST_SQUARES:
            raise BadInput(
                f"--squares: {squares!r}; must be width x height, at least 4x4, e.g. 10x7, at most "
                f"{_MOST_SQUARES}x{_MOST_SQUARES}"
            )
        if not 0.1 < square_mm <= 1000:
            raise BadInput(f"--square-mm: {square_mm:g}; must be greater than 0.1 and at most 1000")
        if kind == "checkerboard":
            if marker_mm is not None:
                raise BadInput("--marker-mm: requires --board charuco")
            if sum(size) % 2 == 0:
                raise BadInput(
                    f"--squares: {squares}; a checkerboard needs one odd and one even number; "
                    "otherwise it looks the same upside down"
                )
            return cls(size, square_mm / 1e3)
        if marker_mm is None or not 0 < marker_mm < square_mm:
            raise BadInput("--marker-mm: required for a ChArUco board, smaller than its squares")
        if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
            raise BadInput(
                f"--dictionary: {dictionary!r} is not an OpenCV dictionary; use e.g. DICT_5X5_100"
            )
        return cls(size, square_mm / 1e3, marker_mm / 1e3, dictionary)

    def find(self, grey: np.ndarray) -> Sighting | None:
        """The board in a grey image (H, W) uint8, None if it is not there."""
        if self.marker_m and self.dictionary:
            return self._find_charuco(grey, self.marker_m, self.dictionary)
        return self._find_checkerboard(grey)

    def _find_checkerboard(self, grey: np.ndarray) -> Sighting | None:
        columns, rows = self.squares[0] - 1, self.squares[1] - 1
        small, shrink = _small_image(grey)
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        found, corners = cv2.findChessboardCornersSB(small, (columns, rows), flags=flags)
        if not found:
            return None
        corners = _refine(grey, (corners.reshape(-1, 2) + 0.5) / shrink - 0.5, _WITHIN_SQUARE)
        corners = corners.reshape(rows, columns, 2)
        # As the board is seen from its front, x to y turns clockwise in the image.
        along, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
        if along[0] * down[1] - along[1] * down[0] < 0:
            corners = corners[:, ::-1]
        if _first_square_is_light(grey, corners):
            corners = corners[::-1, ::-1]
        y, x = np.mgrid[1 : rows + 1, 1 : columns + 1] * self.square_m
        points = np.stack([x, y, np.zeros_like(x)], axis=-1)
        return Sighting(
            points.reshape(-1, 3).astype(np.float32),
            np.ascontiguousarray(corners.reshape(-1, 2), dtype=np.float32),
        )

    def _find_charuco(self, grey: np.ndarray, marker_m: float, dictionary: str) -> Sighting | None:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        try:
            board = cv2.aruco.CharucoBoard(self.squares, self.square_m, marker_m, markers)
        except cv2.error:
            raise BadInput(
                f"--dictionary: {self.dictionary} has too few markers for "
                f"{self.squares[0]}x{self.squares[1]} squares"
            ) from None
        ids = None
        # Before OpenCV 4.6, and from most shops, boards of an even number of rows begin otherwise.
        for is_legacy in (False, True)[: 2 - self.squares[1] % 2]:
            board.setLegacyPattern(is_legacy)
            corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
            if ids is not None and len(ids) >= _FEWEST_CORNERS:
                break
        else:
            return None
        points = np.asarray(board.getChessboardCorners())[ids.ravel()]
        # This detector, unlike the rest of OpenCV, counts from the first pixel's corner.
        margin = (1 - marker_m / self.square_m) / 2
        corners = _refine(grey, corners.reshape(-1, 2) - 0.5, margin)
        return Sighting(points.astype(np.float32), corners)


def _small_image(grey: np.ndarray) -> tuple[np.ndarray, float]:
    """An image as wide as is needed to see a board in it soon, and its share of the width."""
    shrink = min(1.0, _SEARCH_PX / grey.shape[1])
    return cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), shrink


def _refine(grey: np.ndarray, corners: np.ndarray, share: float) -> np.ndarray:
    """Corners (N, 2) moved to where the edges cross that lie around within a share of a square."""
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1)
    near = apart[apart > 0].min()
    # The wider, the less the noise, as long as no other edge comes in.
    reach = int(np.clip(share * near, 2, 15))
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    flat = np.ascontiguousarray(corners.reshape(-1, 1, 2), dtype=np.float32)
    return cv2.cornerSubPix(grey, flat, (reach, reach), (-1, -1), until).reshape(-1, 2)


def _first_square_is_light(grey: np.ndarray, corners: np.ndarray) -> bool:
    """Whether the square at the first inner corners is lighter than the one beside it."""

    def middle(row: int, column: int) -> float:
        x, y = corners[row : row + 2, column : column + 2].reshape(-1, 2).mean(axis=0)
        return float(grey[round(y), round(x)])

    # Squares between inner corners, averaged over the board: shadows do not decide then.
    difference = np.mean(
        [
            middle(row, column) - middle(row, column + 1)
            for row in range(0, len(corners) - 1, 2)
            for column in range(0, len(corners[0]) - 2, 2)
        ]
    )
    # Square (1, 1) of the board, the first between inner corners, is as dark as square (0, 0).
    return bool(difference > 0)


def what_is_seen(board: Board, images: Iterable[np.ndarray]) -> str:
    """Return in a few words what grey images show in place of a board; empty if it is nothing."""
    seen: tuple[int, str] = (0, "")
    for grey in images:
        found = _markers(board, grey)
        if found is None and (squares := _squares_seen(grey)):
            found = (squares[0] - 1) * (squares[1] - 1), _checkerboard(board, *squares)
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


def _checkerboard(board: Board, columns: int, rows: int) -> str:
    """What is said of a checkerboard of so many squares in place of a board."""
    what = f"a checkerboard of {columns}x{rows} squares is seen"
    if board.marker_m:
        what += ", without markers: --board checkerboard"
    elif sorted((columns - 1, rows - 1)) == sorted(board.squares):
        what += f", which has {columns - 1}x{rows - 1} inner corners: --squares counts squares"
    return what


def _squares_seen(grey: np.ndarray) -> tuple[int, int] | None:
    """Squares along width and height of a checkerboard of any size, None if there is none."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(_small_image(grey)[0], (3, 3), flags)
    return (meta.shape[1] + 1, meta.shape[0] + 1) if found else None


def check_size(board: Board, grey: np.ndarray, name: str) -> None:
    """Refuse a checkerboard that is part of a larger one: its first corner would be another."""
    if board.marker_m or (seen := _squares_seen(grey)) is None:
        return
    if min(seen) > min(board.squares) or max(seen) > max(board.squares):
        what = _checkerboard(board, *seen)
        raise BadInput(f"{name}: not {board.squares[0]}x{board.squares[1]} squares; {what}")


VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")
_FRAMES_TRIED = 60
_FRAMES_KEPT = 25
_FRAMES_CLAIMED_MAX = 1_000_000


@dataclass(frozen=True)
class BoardView:
    """A board in one image, the image's name and its size (width, height) in pixels."""

    name: str
    size_px: tuple[int, int]
    sighting: Sighting


def read_image(path: str | Path) -> np.ndarray:
    """A grey image (H, W) uint8; BadInput if the file is missing or not an image."""
    # As OpenCV would show it: a camera's orientation tag does not turn the sensor.
    grey = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    return decode_image(image_bytes(path), str(path), grey)


def _frames(path: str | Path) -> Iterator[tuple[str, np.ndarray]]:
    """Frames at regular intervals of a video, grey."""
    recording = Recording(path, frame_rate_hz=1.0)  # when a frame was taken does not matter
    claimed = min(max(recording.frames_claimed, 1), _FRAMES_CLAIMED_MAX)
    step = -(-claimed // _FRAMES_TRIED)
    for number, moment in enumerate(recording.moments()):
        if number % step == 0:
            yield f"{path}#{number}", cv2.cvtColor(moment.image(), cv2.COLOR_BGR2GRAY)


def read_views(paths: Sequence[str | Path], board: Board) -> list[BoardView]:
    """The views in which the board is seen, of images or one video.

    Of a video, up to 60 frames at regular intervals are looked at and the 25 in which the
    board's places differ most are kept. BadInput if a file cannot be read, sizes differ, or the
    board is in none.
    """
    names = [Path(path) for path in paths]
    is_video = [path.suffix.lower() in VIDEOS for path in names]
    if any(is_video) and len(names) > 1:
        raise BadInput(f"{names[is_video.index(True)]}: a video must be the only file")

    def images() -> Iterator[tuple[str, np.ndarray]]:
        if is_video[0]:
            return _frames(names[0])
        return ((str(path), read_image(path)) for path in names)

    views: list[BoardView] = []
    looked_at = 0
    for name, grey in images():
        looked_at += 1
        size = (grey.shape[1], grey.shape[0])
        sighting = board.find(grey)
        if sighting is None:
            continue
        if views and views[0].size_px != size:
            raise BadInput(
                f"{name}: {size[0]}x{size[1]} pixels, {views[0].name} has "
                f"{views[0].size_px[0]}x{views[0].size_px[1]}: all images of a camera must have "
                "the same size"
            )
        if not views:
            check_size(board, grey, name)
        views.append(BoardView(name, size, sighting))
    if not views:
        where = str(names[0]) if len(names) == 1 else f"{names[0]} ... {names[-1]}"
        spread = islice(images(), None, None, -(-looked_at // _IMAGES_TRIED))
        seen = what_is_seen(board, (grey for _, grey in spread))
        raise BadInput(
            f"{where}: no {'ChArUco ' if board.marker_m else 'checker'}board of "
            f"{board.squares[0]}x{board.squares[1]} squares in any of {looked_at} "
            f"{'frame' if is_video[0] else 'image'}(s){f'; {seen}' if seen else ''}"
        )
    return _most_different(views, _FRAMES_KEPT) if is_video[0] else views


def _most_different(views: list[BoardView], count: int) -> list[BoardView]:
    """Views chosen one by one, each the farthest from those chosen before it."""

    def place(view: BoardView) -> np.ndarray:
        points, corners = view.sighting.points_m[:, :2], view.sighting.corners_px
        # Where the board's middle and its unit vectors appear, whichever corners were found.
        design = np.column_stack([points - points.mean(axis=0), np.ones(len(points))])
        affine = np.linalg.lstsq(design, corners, rcond=None)[0]
        affine[:2] *= np.ptp(points, axis=0).max()
        return affine.ravel()

    places = np.array([place(view) for view in views])
    chosen = [0]
    apart = np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < min(count, len(views)):
        chosen.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return [views[k] for k in sorted(chosen)]
