"""The images for the calibration of a camera: single files, or frames of a video."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import image_bytes
from slipstitch.film.board import Board, Sighting, check_size, what_is_seen
from slipstitch.film.recording import Recording

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


def read_image(path: str | os.PathLike) -> np.ndarray:
    """A grey image (H, W) uint8; BadInput if the file is missing or not an image."""
    data = np.frombuffer(image_bytes(path), np.uint8)
    # As OpenCV would show it: a camera's orientation tag does not turn the sensor.
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise BadInput(f"{path}: not an image that OpenCV can read")
    return image


def _frames(path: str | os.PathLike) -> Iterator[tuple[str, np.ndarray]]:
    """Frames at regular intervals of a video, grey."""
    recording = Recording(path, frame_rate_hz=1.0)  # when a frame was taken does not matter
    claimed = min(max(recording.frames_claimed, 1), _FRAMES_CLAIMED_MAX)
    step = -(-claimed // _FRAMES_TRIED)
    for number, moment in enumerate(recording.moments()):
        if number % step == 0:
            yield f"{path}#{number}", cv2.cvtColor(moment.image(), cv2.COLOR_BGR2GRAY)


def read_views(paths: Sequence[str | os.PathLike], board: Board) -> list[BoardView]:
    """The views in which the board is seen, of images or one video.

    Of a video, up to 60 frames at regular intervals are looked at and the 25 in which the
    board's places differ most are kept. BadInput if a file cannot be read, sizes differ, or the
    board is in none.
    """
    names = [Path(path) for path in paths]
    is_video = [path.suffix.lower() in VIDEOS for path in names]
    if any(is_video) and len(names) > 1:
        raise BadInput(f"{names[is_video.index(True)]}: a video must be the only file")
    images = _frames(names[0]) if is_video[0] else ((str(path), read_image(path)) for path in names)
    views: list[BoardView] = []
    looked_at = 0
    for name, grey in images:
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
        seen = what_is_seen(board, _spread(names, is_video[0], looked_at))
        raise BadInput(
            f"{where}: no {'ChArUco ' if board.marker_m else 'checker'}board of "
            f"{board.squares[0]}x{board.squares[1]} squares in any of {looked_at} "
            f"{'frame' if is_video[0] else 'image'}(s){f'; {seen}' if seen else ''}"
        )
    return _most_different(views, _FRAMES_KEPT) if is_video[0] else views


def _spread(names: Sequence[Path], is_video: bool, count: int) -> Iterator[np.ndarray]:
    """Five images at most, spread over all that were looked at."""
    step = -(-count // 5)
    if is_video:
        yield from (grey for k, (_, grey) in enumerate(_frames(names[0])) if k % step == 0)
    else:
        yield from map(read_image, names[::step])


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
