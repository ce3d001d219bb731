"""Reading a video frame by frame, with its timestamps and without trusting its header."""

import functools
import math
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from slipstitch.base.errors import BadInput

_FIRST_BYTES = 4096


class Moment:
    """A frame of a video, not yet converted.

    Attributes
    ----------
    number : int
        Of the frame in the file, from 0.
    time_s : float
        Since the first frame.
    """

    def __init__(
        self, number: int, time_s: float, frame: av.VideoFrame | None, size_px: tuple[int, int]
    ):
        self.number, self.time_s, self._frame = number, time_s, frame
        if frame is not None and (frame.width, frame.height) != size_px:
            self._frame = None

    @property
    def has_image(self) -> bool:
        """False for a frame that is damaged, or was not decoded because nobody needs it."""
        return self._frame is not None

    def image(self) -> np.ndarray | None:
        """The frame (rows, columns, 3) uint8, blue first; None if it has no image."""
        if self._frame is None:
            return None
        return np.asarray(self._frame.to_ndarray(format="bgr24"))


@dataclass(frozen=True)
class FrameIndex:
    """The frames of a video as its container lists them, by number.

    Attributes
    ----------
    time_s : ndarray (n,)
        Since the first frame.
    is_entry : ndarray (n,) bool
        Whether no other frame is needed to decode this one, and none before it for later ones.
    timestamp : ndarray (n,) int
        In the stream's unit.
    packet_number : ndarray (n,) int
        The frames' numbers in the order of the packets.
    """

    time_s: np.ndarray
    is_entry: np.ndarray
    timestamp: np.ndarray
    packet_number: np.ndarray


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
        with self._open() as video:
            frame = next(_all_frames(video), None)
            if frame is None:
                raise self._unreadable()
            self.size_px: tuple[int, int] = (frame.width, frame.height)
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
    def index(self) -> FrameIndex | None:
        """The frames, known without decoding them; None if the container does not list them."""
        timestamps, keys = [], []
        with self._open() as video:
            for packet in _packets(video):
                if packet.pts is None or packet.is_corrupt or packet.is_discard:
                    return None
                timestamps.append(packet.pts)
                keys.append(packet.is_keyframe)
            unit_s = _unit_s(_stream(video))
        stamp = np.array(timestamps, np.int64)
        order = np.argsort(stamp)
        if not len(stamp) or not unit_s or (np.diff(stamp[order]) == 0).any():
            return None
        number = np.empty(len(stamp), int)
        number[order] = np.arange(len(stamp))
        # In every packet before an entry there is an earlier frame, in all from it on a later one.
        before = np.concatenate([[-1], np.maximum.accumulate(number)[:-1]])
        after = np.minimum.accumulate(number[::-1])[::-1]
        entry = np.array(keys) & (before < number) & (after >= number)
        if not entry[0]:
            return None
        is_entry = np.zeros(len(stamp), bool)
        is_entry[number[entry]] = True
        time_s = (stamp[order] - stamp[order[0]]) * unit_s
        if self.frame_rate_hz:
            time_s = np.arange(len(stamp)) / self.frame_rate_hz
        return FrameIndex(time_s, is_entry, stamp[order], number)

    def moments(self, needed: Collection[int] | None = None) -> Iterator[Moment]:
        """Every frame in turn; frames whose time does not advance are left out.

        Parameters
        ----------
        needed : collection of int, optional
            Numbers of frames in `index` that are to have images; others may have none, which saves
            the decoding of all that comes between two entries and is not needed. By default all.

        Raises
        ------
        BadInput
            If the file gives no times and no frame rate was stated.
        """
        with self._open() as video:
            if needed is None or self.index is None:
                yield from self._all_moments(video)
            else:
                yield from self._indexed_moments(video, self.index, needed)

    def _all_moments(self, video: av.container.InputContainer) -> Iterator[Moment]:
        first, last = None, -math.inf
        unit_s = _unit_s(_stream(video))
        for number, frame in enumerate(_all_frames(video)):
            stamp = frame.dts if frame.pts is None else frame.pts
            time_s = (stamp or 0) * unit_s
            if self.frame_rate_hz:
                time_s = number / self.frame_rate_hz
            first = time_s if first is None else first
            if time_s > last:
                last = time_s
                yield Moment(number, time_s - first, frame, self.size_px)
            elif number == 25 and last <= first:
                raise BadInput(
                    f"{self.path}: its frames have no timestamps; give the frame rate of the camera"
                )

    def _indexed_moments(
        self, video: av.container.InputContainer, index: FrameIndex, needed: Collection[int]
    ) -> Iterator[Moment]:
        number_of = {int(stamp): number for number, stamp in enumerate(index.timestamp)}
        wanted = np.zeros(len(index.time_s), np.bool_)
        wanted[list(needed)] = True
        fed = _packets_to_decode(index, wanted)
        number = 0

        def moment(frame: av.VideoFrame | None) -> Moment:
            return Moment(number, float(index.time_s[number]), frame, self.size_px)

        for frame in _fed_frames(video, fed):
            at = -1 if frame.pts is None else number_of.get(frame.pts, -1)
            while number < at:
                yield moment(None)
                number += 1
            if number == at:
                yield moment(frame)
                number += 1
        while number < len(index.time_s):
            yield moment(None)
            number += 1


def _packets_to_decode(index: FrameIndex, wanted: np.ndarray) -> np.ndarray:
    """Which packets are to be decoded for the frames wanted (both bool, shape (n,)).

    From the entry before a frame up to the frame: a frame's packet comes after those of the frames
    that it rests on.
    """
    starts = np.flatnonzero(index.is_entry[index.packet_number])
    fed = np.zeros(len(wanted), bool)
    for start, stop in zip(starts, [*starts[1:], len(wanted)], strict=True):
        of_group = np.flatnonzero(wanted[index.packet_number[start:stop]])
        if len(of_group):
            fed[start : start + of_group[-1] + 1] = True
    return fed


def _fed_frames(video: av.container.InputContainer, fed: np.ndarray) -> Iterator[av.VideoFrame]:
    """Frames of the packets for which `fed` (n,) is true."""
    decoder = _stream(video).codec_context
    waiting = False
    for packet, feed in zip(_packets(video), fed, strict=False):
        if feed:
            waiting = True
            yield from _frames(decoder, packet)
        elif waiting:
            waiting = False
            yield from _frames(decoder, None)
            decoder.flush_buffers()
    yield from _frames(decoder, None)


def _all_frames(video: av.container.InputContainer) -> Iterator[av.VideoFrame]:
    decoder = _stream(video).codec_context
    for packet in _packets(video):
        yield from _frames(decoder, packet)
    yield from _frames(decoder, None)


def _packets(video: av.container.InputContainer) -> Iterator[av.Packet]:
    """Those of the video stream, up to the file's end or to where it can no longer be read."""
    try:
        for packet in video.demux(_stream(video)):
            if packet.size:  # the last one, which PyAV adds, is empty
                yield packet
    except av.FFmpegError:
        return


def _frames(
    decoder: av.video.codeccontext.VideoCodecContext, packet: av.Packet | None
) -> list[av.VideoFrame]:
    """What the decoder has after a packet, or after the last one (None); nothing if damaged."""
    try:
        return decoder.decode(packet)
    except av.FFmpegError:
        return []


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
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        # A character may be cut at the end.
        if error.start < len(content) - 4:
            return False
        text = content[: error.start].decode("utf-8")
    return not any(ord(letter) < 9 for letter in text)
