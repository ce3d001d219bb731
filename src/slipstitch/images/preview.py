"""Contact sheets and videos of finished image shards, made without Blender."""

import os
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    check_image,
    provenance_record,
    read_parquet,
    recorded_path,
    start_clock,
)
from slipstitch.images.image_shards import SCHEMA

_SHEET_COLUMNS = 9
_SECONDS = 12.0
_SMALLEST_VIDEO_PX = 224
_GAP = 2


def read_images(path: str | os.PathLike) -> dict[tuple[str, str, str], dict[int, bytes]]:
    """PNG files of a shard: (simulation, texture, viewpoint) -> frame -> bytes.

    Raises
    ------
    BadInput
        If the file is missing, damaged, or not an image shard.
    """
    table = read_parquet(path)
    for name in SCHEMA.names:
        if name not in table.column_names:
            raise BadInput(f"{path}: not an image shard: no column {name!r}")
    videos: dict[tuple[str, str, str], dict[int, bytes]] = {}
    for row in table.to_pylist():
        key = (row["simulation"], row["texture"], row["viewpoint"])
        videos.setdefault(key, {})[row["frame"]] = row["image"]["bytes"]
    return videos


def decode_image(data: bytes, where: str) -> np.ndarray:
    """An image file's content, blue first (H, W, 3) uint8; BadInput if it is damaged."""
    check_image(data, where)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise BadInput(f"{where}: an image cannot be decoded")
    return image


def preview(
    shards: Sequence[str | os.PathLike],
    sheet: str | os.PathLike | None = None,
    video: str | os.PathLike | None = None,
) -> None:
    """Make a contact sheet and a video of image shards, usually all viewpoints of a simulation.

    Parameters
    ----------
    shards : sequence of paths
        Image shards; the frames that all of them have are shown.
    sheet : path, optional
        PNG: for every viewpoint a row of the first texture through time, then, at one time, a row
        of all textures.
    video : path, optional
        MP4: the viewpoints side by side, the first texture.

    Raises
    ------
    BadInput
        If a shard cannot be read or the shards have no frame in common.
    """
    started = start_clock()
    videos = {}
    for path in shards:
        for key, frames in read_images(path).items():
            if key in videos:
                raise BadInput(f"{path}: holds {'_'.join(key)}, which is also in another shard")
            videos[key] = {number: (data, path) for number, data in frames.items()}
    numbers = [set(frames) for frames in videos.values()]
    common = sorted(set.intersection(*numbers)) if numbers else []
    if not common:
        raise BadInput(f"no common frame in {', '.join(map(str, shards))}")
    textures: dict[tuple[str, str], list[str]] = {}
    for simulation, texture, view in sorted(videos):
        textures.setdefault((simulation, view), []).append(texture)

    def image(simulation: str, texture: str, view: str, number: int) -> np.ndarray:
        data, path = videos[simulation, texture, view][number]
        return decode_image(data, f"{path}: {simulation}_{texture}_{view} frame {number}")

    record = provenance_record("render", inputs=shards, started=started)
    if sheet is not None:
        times = [common[k] for k in _evenly(len(common), _SHEET_COLUMNS)]
        middle = common[len(common) // 2]
        rows = [[image(s, all_[0], v, n) for n in times] for (s, v), all_ in textures.items()]
        for (s, v), all_ in textures.items():
            for k in range(0, len(all_) if len(all_) > 1 else 0, _SHEET_COLUMNS):
                rows.append([image(s, t, v, middle) for t in all_[k : k + _SHEET_COLUMNS]])
        with recorded_path(sheet, record) as temporary:
            temporary.write_bytes(cv2.imencode(".png", _tile(rows))[1].tobytes())
    if video is not None:
        pictures = (
            _tile([[image(s, all_[0], v, n) for (s, v), all_ in textures.items()]]) for n in common
        )
        with recorded_path(video, record) as temporary:
            _write_video(temporary, pictures, rate_hz=max(1.0, len(common) / _SECONDS))


def _evenly(count: int, wanted: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(wanted, count)).round().astype(int).tolist()))


def _tile(rows: list[list[np.ndarray]]) -> np.ndarray:
    """Images in a grid with a thin gap, all at the size of the largest."""
    side = max(image.shape[0] for row in rows for image in row)
    wide = max(len(row) for row in rows)
    canvas = np.full(
        (len(rows) * (side + _GAP) - _GAP, wide * (side + _GAP) - _GAP, 3), 255, dtype=np.uint8
    )
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            if image.shape[0] != side:
                image = cv2.resize(image, (side, side), interpolation=cv2.INTER_CUBIC)
            y, x = i * (side + _GAP), j * (side + _GAP)
            canvas[y : y + side, x : x + side] = image
    return canvas


def _write_video(path: Path, pictures, rate_hz: float) -> None:
    """H.264, which browsers play; OpenCV writes MPEG-4 Part 2 only, which they do not."""
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        rate = Fraction(rate_hz).limit_denominator(1000)
        stream = container.add_stream("libx264", rate=rate, options={"threads": "1"})
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            scale = max(1, -(-_SMALLEST_VIDEO_PX // picture.shape[0]))
            picture = np.kron(picture, np.ones((scale, scale, 1), np.uint8))
            # The codec needs even sides.
            picture = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
            if not stream.codec_context.is_open:
                stream.height, stream.width = picture.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode())
