"""Reading a video frame by frame, with its timestamps and without trusting its header."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

# A broken file is answered with one line of ours, and a play list must not lead to other files or
# to the network; set before FFmpeg is first used.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "protocol_whitelist;file")

import cv2
import numpy as np

from slipstitch.errors import BadInput

_FIRST_BYTES = 4096


class Moment:
    """A frame that was decoded but not yet converted; good until the next one is asked for.

    Attributes
    ----------
    number : int
        Of the frame in the file, from 0.
    time_s : float
        Since the first frame.
    """

    def __init__(self, video: cv2.VideoCapture, number: int, time_s: float, size: tuple[int, int]):
        self._video, self.number, self.time_s, self._size = video, number, time_s, size

    def image(self) -> np.ndarray | None:
        """The frame (rows, columns, 3) uint8, blue first; None if it is damaged."""
        good, image = self._video.retrieve()
        return image if good and image.shape[1::-1] == self._size else None


class Recording:
    """A video file.

    Parameters
    ----------
    path : path
    frame_rate_hz : float, optional
        Of the camera: frame k is at k / this. By default each frame's own time is taken.

    Attributes
    ----------
    size_px : tuple of int
        Width, height, as the sensor has it: no orientation tag is followed.
    frames_claimed : int
        By the file's header, which may be wrong.

    Raises
    ------
    BadInput
        If there is no such file, or it is not a video.
    """

    def __init__(self, path: str | os.PathLike, frame_rate_hz: float | None = None):
        self.path, self.frame_rate_hz = Path(path), frame_rate_hz
        if not self.path.is_file():
            missing = "is a folder; must be a video" if self.path.is_dir() else "no such file"
            raise BadInput(f"{path}: {missing}")
        with open(self.path, "rb") as stream:
            first = stream.read(_FIRST_BYTES)
        # FFmpeg would draw the letters of a text file, or follow a playlist to other places.
        if not first or _is_text(first):
            raise BadInput(f"{path}: {'a text file' if first else 'empty'}, not a video")
        video = self._open()
        good, image = video.read()
        self.frames_claimed = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        video.release()
        if not good:
            raise BadInput(f"{path}: not a video that OpenCV can read (damaged or truncated?)")
        self.size_px: tuple[int, int] = (image.shape[1], image.shape[0])

    def _open(self) -> cv2.VideoCapture:
        name = str(self.path.resolve())
        try:
            name.encode()
        except UnicodeEncodeError:
            raise BadInput(f"{self.path}: the name is not text; OpenCV cannot open it") from None
        level = cv2.getLogLevel()
        cv2.setLogLevel(0)
        try:
            video = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        finally:
            cv2.setLogLevel(level)
        video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return video

    def moments(self) -> Iterator[Moment]:
        """Every frame in turn; frames whose time does not advance are left out.

        Raises
        ------
        BadInput
            If the file gives no times and no frame rate was stated.
        """
        video = self._open()
        try:
            number, first, last = 0, None, -math.inf
            while video.grab():
                if self.frame_rate_hz:
                    time_s = number / self.frame_rate_hz
                else:
                    time_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                first = time_s if first is None else first
                if time_s > last:
                    last = time_s
                    yield Moment(video, number, time_s - first, self.size_px)
                elif number == 25 and last <= first:
                    raise BadInput(
                        f"{self.path}: its frames have no timestamps; give the frame rate of the "
                        "camera"
                    )
                number += 1
        finally:
            video.release()


def _is_text(content: bytes) -> bool:
    """Whether bytes are text: no video format does without bytes below 9."""
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        # A character may be cut at the end.
        if error.start < len(content) - 4:
            return False
        text = content[: error.start].decode("utf-8")
    return not any(ord(letter) < 9 for letter in text)
