"""Reading a video frame by frame, with its timestamps and without trusting its header."""

import codecs
import functools
import itertools
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from slipstitch.base.errors import BadInput

_FIRST_BYTES = 4096
# Packets come in the order in which they are decoded; frames are shown this much later at most.
_SHOWN_LATER_S = 1.0
# Frames come in the order in which they are shown: a larger step back is of another recording. So
# large a share of frames at the time of another, among so many, is of a clock coarser than they.
_STEP_BACK_S, _EQUAL_SHARE, _FEWEST_FRAMES = 0.2, 0.1, 25
#: How a user gives a frame rate: to `measure`, and in the table of `capture ingest`.
GIVE_RATE = "--frame-rate-hz, or frame_rate_hz in a captures table"


@dataclass(frozen=True)
class Moment:
    """A decoded frame of a video, not yet converted, and its time since the first frame."""

    time_s: float
    frame: av.VideoFrame

    def image(self) -> np.ndarray:
        """The frame (rows, columns, 3) uint8, blue first."""
        return np.asarray(self.frame.to_ndarray(format="bgr24"))


@dataclass(frozen=True)
class FrameIndex:
    """The frames of a video in turn."""

    time_s: np.ndarray  # (n,): since the first frame
    is_key: np.ndarray  # (n,) bool: whether decoding can begin at the frame
    # (n,) int: in the stream's unit; None where only decoding all frames tells which one is which
    timestamp: np.ndarray | None


class Recording:
    """A video file; BadInput if there is no such file, or it is not a video.

    With a `frame_rate_hz` of the camera, frame k is at k / this; by default each frame's own
    time is taken. `size_px` is width and height as the sensor has it, whatever the orientation
    tag says, by which a player turns the film by `rotation_deg`; `frames_claimed` is what the
    file's header says.
    """

    def __init__(self, path: str | Path, frame_rate_hz: float | None = None):
        self.path, self.frame_rate_hz = Path(path), frame_rate_hz
        if not self.path.is_file():
            missing = "is a folder; must be a video" if self.path.is_dir() else "no such file"
            raise BadInput(f"{path}: {missing}")
        with open(self.path, "rb") as stream:
            first = stream.read(_FIRST_BYTES)
        # FFmpeg would draw the letters of a text file, or follow a playlist to other places.
        if not first or _is_text(first):
            raise BadInput(f"{path}: {'a text file' if first else 'empty'}, not a video")
        with self._open() as video:
            frame = next(_frames(video), None)
            if frame is None:
                raise self._unreadable()
            self.size_px: tuple[int, int] = (frame.width, frame.height)
            self.rotation_deg = round(frame.rotation) % 360
            self.frames_claimed = _frames_claimed(video)

    def _unreadable(self) -> BadInput:
        return BadInput(f"{self.path}: not a video that FFmpeg can read (damaged or truncated?)")

    def _open(self) -> av.container.InputContainer:
        name = str(self.path.resolve())
        try:
            name.encode()
        except UnicodeEncodeError:
            raise BadInput(f"{self.path}: the name is not text; FFmpeg cannot open it") from None
        try:
            # A play list must not lead to other files or to the network.
            only_files = {"protocol_whitelist": "file"}
            video = av.open(name, options=only_files, metadata_errors="ignore")
        except (av.FFmpegError, ValueError):
            raise self._unreadable() from None
        if video.streams.best("video") is None:
            video.close()
            raise self._unreadable()
        _stream(video).thread_type = "AUTO"
        return video

    @functools.cached_property
    def listed(self) -> FrameIndex | None:
        """The frames, known without decoding them; None if the container does not list them."""
        stamps, keys, decoded_at = [], [], -math.inf
        with self._open() as video:
            unit_s = _unit_s(_stream(video))
            for packet in _packets(video):
                if packet.pts is None or packet.is_corrupt or packet.is_discard:
                    return None
                if packet.dts is not None and packet.dts < decoded_at:
                    return None  # of another recording
                decoded_at = decoded_at if packet.dts is None else packet.dts
                stamps.append(packet.pts)
                keys.append(packet.is_keyframe)
        stamp = np.array(stamps, np.int64)
        back_s = (np.maximum.accumulate(stamp) - stamp).max(initial=0) * unit_s
        order = np.argsort(stamp)
        if not len(stamp) or not unit_s or (np.diff(stamp[order]) == 0).any():
            return None
        if back_s > _SHOWN_LATER_S or not keys[order[0]]:
            return None
        time_s = (stamp[order] - stamp[order[0]]) * unit_s
        if self.frame_rate_hz:
            time_s = np.arange(len(stamp)) / self.frame_rate_hz
        return FrameIndex(time_s, np.array(keys)[order], stamp[order])

    @functools.cached_property
    def decoded(self) -> FrameIndex:
        """The frames that can be decoded; it takes as long as decoding all of them."""
        time_s = np.array([moment.time_s for moment in self.moments()])
        return FrameIndex(time_s, np.zeros(len(time_s), bool), None)

    def moments(self) -> Iterator[Moment]:
        """Every frame in turn; frames whose time does not advance are left out.

        BadInput if the file gives no times, times that start again, or too coarse ones, and no
        frame rate was stated.
        """
        first = last = None
        equal = 0
        with self._open() as video:
            unit_s = _unit_s(_stream(video))
            for number, frame in enumerate(_frames(video)):
                stamp = frame.dts if frame.pts is None else frame.pts
                time_s = (stamp or 0) * unit_s
                if self.frame_rate_hz:
                    time_s = number / self.frame_rate_hz
                first = time_s if first is None else first
                if last is not None and time_s < last - _STEP_BACK_S:
                    raise BadInput(
                        f"{self.path}: its timestamps step back by {last - time_s:.2f} s after "
                        f"{last - first:.1f} s, as where parts were joined that start again or "
                        f"overlap: join them with new timestamps, or give the "
                        f"frame rate of the camera ({GIVE_RATE})"
                    )
                equal += time_s == last
                if number >= _FEWEST_FRAMES and equal > _EQUAL_SHARE * number:
                    raise BadInput(
                        f"{self.path}: {equal} of the first {number + 1} frames have the timestamp "
                        f"of the frame before: the clock is coarser than the frames; give the "
                        f"frame rate of the camera ({GIVE_RATE})"
                    )
                if (last is None or time_s > last) and self._is_whole(frame):
                    last = time_s
                    yield Moment(time_s - first, frame)

    def _is_whole(self, frame: av.VideoFrame) -> bool:
        return (frame.width, frame.height) == self.size_px

    def some(self, index: FrameIndex, needed: Collection[int]) -> Iterator[tuple[int, Moment]]:
        """The frames of these numbers that can be decoded; the others only from a key frame on."""
        if index.timestamp is None:
            yield from (one for one in enumerate(self.moments()) if one[0] in needed)
            return
        keys, timestamp = np.flatnonzero(index.is_key), index.timestamp
        with self._open() as video:
            frames, last = _frames(video), -1
            for number in sorted(needed):
                stamp = int(timestamp[number])
                group = int(np.searchsorted(keys, number, side="right")) - 1
                frame = None
                if keys[group] <= last + 1:
                    frame = _first_from(frames, stamp)
                else:
                    # A container seeks by decoding times: aim within the group, else before it.
                    end = keys[group + 1] if group + 1 < len(keys) else len(timestamp)
                    within = max(number, min(keys[group] + 2, end - 1))
                    for aim in (within, keys[group], 0):
                        video.seek(int(timestamp[aim]), stream=_stream(video))
                        frames = _frames(video)
                        frame = _first_from(frames, stamp)
                        if frame is not None and frame.pts == stamp:
                            break
                last = number
                if frame is not None and frame.pts == stamp and self._is_whole(frame):
                    yield number, Moment(float(index.time_s[number]), frame)


def _first_from(frames: Iterator[av.VideoFrame], stamp: int) -> av.VideoFrame | None:
    """The first of these frames that is shown at a timestamp or later; None if there is none."""
    return next((one for one in frames if one.pts is not None and one.pts >= stamp), None)


def _frames(video: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    """What can be decoded from here on; damaged frames are left out."""
    decoder = _stream(video).codec_context
    for packet in itertools.chain(_packets(video), [None]):
        try:
            yield from decoder.decode(packet)
        except av.FFmpegError:
            continue


def _packets(video: av.container.InputContainer) -> Iterator[av.Packet]:
    """Those of the video stream, up to the file's end or to where it can no longer be read."""
    try:
        for packet in video.demux(_stream(video)):
            if packet.size:  # the last one, which PyAV adds, is empty
                yield packet
    except av.FFmpegError:
        return


def _stream(video: av.container.InputContainer) -> av.video.stream.VideoStream:
    """The one that FFmpeg takes for the film: others may be a cover picture or a thumbnail."""
    stream = video.streams.best("video")
    assert isinstance(stream, av.video.stream.VideoStream)
    return stream


def _unit_s(stream: av.video.stream.VideoStream) -> float:
    """What one unit of the stream's timestamps is in seconds; 0 where the file does not say."""
    return float(stream.time_base or 0)


def _frames_claimed(video: av.container.InputContainer) -> int:
    stream = _stream(video)
    if stream.frames:
        return stream.frames
    length_s = (stream.duration or 0) * _unit_s(stream) or (video.duration or 0) / av.time_base
    return round(length_s * float(stream.average_rate or 0))


def _is_text(content: bytes) -> bool:
    """Whether bytes are text: no video format does without bytes below 9."""
    try:  # not to the end, where a character may be cut
        text = codecs.getincrementaldecoder("utf-8")().decode(content)
    except UnicodeDecodeError:
        return False
    return not any(ord(letter) < 9 for letter in text)
