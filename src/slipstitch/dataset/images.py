"""Images of the dataset: shards of the render stage read, files of the dataset written and read."""

import hashlib
import io
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
from PIL import Image

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import check_image, read_parquet, write_parquet

COLUMNS = ("simulation", "texture", "viewpoint", "frame", "time_s", "stage_x_m", "image")


@dataclass(frozen=True)
class Frame:
    """One rendered image as it lies in a shard; `png` is undecoded."""

    frame: int
    time_s: float
    stage_x_m: float
    png: bytes


def decode(png: bytes, where: str, pixels: int | None = None) -> np.ndarray:
    """An image file's content as uint8 RGB, shape (pixels, pixels, 3).

    An error calls the image `where`. BadInput if it cannot be decoded, is not RGB, not square, or
    of another side than `pixels`, if that is given.
    """
    check_image(png, where)
    try:
        with Image.open(io.BytesIO(png)) as image:
            mode, array = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise BadInput(f"{where}: damaged image: {error}") from None
    side = pixels or array.shape[0]
    if mode != "RGB" or array.shape != (side, side, 3):
        raise BadInput(
            f"{where}: image is {'x'.join(map(str, array.shape[1::-1]))} {mode}; must be "
            f"{side}x{side} RGB"
        )
    return array


def simulations_of(path: str | os.PathLike) -> set[str]:
    """Ids of the simulations that a shard holds images of."""
    names = set(read_parquet(path, ["simulation"]).column(0).to_pylist())
    if not names:
        raise BadInput(f"{path}: contains no images")
    return names


def read_shard(path: str | os.PathLike, frames: np.ndarray) -> dict[tuple[str, str, str], list]:
    """The wanted frames of every video in a shard.

    BadInput if the file is damaged, a wanted frame is missing or there twice, or an image is empty.
    The result maps (simulation, texture, viewpoint) to a list of `Frame`.
    """
    table = read_parquet(path, COLUMNS)
    wanted = set(frames.tolist())
    videos: dict[tuple[str, str, str], dict[int, Frame]] = {}
    for batch in table.to_batches(max_chunksize=1024):
        for row in batch.to_pylist():
            video = (row["simulation"], row["texture"], row["viewpoint"])
            kept = videos.setdefault(video, {})
            number = row["frame"]
            if number not in wanted:
                continue
            if number in kept:
                raise BadInput(f"{path}: {'_'.join(video)} has frame {number} twice")
            png = (row["image"] or {}).get("bytes")
            if not png:
                raise BadInput(f"{path}: {'_'.join(video)} frame {number} has no image")
            kept[number] = Frame(number, row["time_s"], row["stage_x_m"], png)
    for video, kept in videos.items():
        missing = [number for number in frames.tolist() if number not in kept]
        if missing:
            raise BadInput(
                f"{path}: {'_'.join(video)} lacks frame {missing[0]} "
                f"({len(missing)} of the {len(frames)} sampled frames missing)"
            )
    return {video: [kept[n] for n in frames.tolist()] for video, kept in videos.items()}


IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
FRAMES_SCHEMA = pa.schema(
    [
        ("video", pa.string()),
        ("simulation", pa.string()),
        ("texture", pa.string()),
        ("viewpoint", pa.string()),
        ("material", pa.string()),
        ("friction", pa.float64()),
        ("position", pa.int32()),
        ("frame", pa.int32()),
        ("time_s", pa.float64()),
        ("stage_x_m", pa.float64()),
        ("image", IMAGE),
    ]
)


def _hugging_face(schema: pa.Schema) -> pa.Schema:
    """The schema with the metadata by which Hugging Face datasets shows `image` as images."""
    kinds = {pa.string(): "string", pa.float64(): "float64", pa.int32(): "int32"}
    features = {
        field.name: {"_type": "Image"}
        if field.type == IMAGE
        else {"dtype": kinds[field.type], "_type": "Value"}
        for field in schema
    }
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})


#: As written: what `_hugging_face` makes of `FRAMES_SCHEMA`.
DATASET_SCHEMA = _hugging_face(FRAMES_SCHEMA)


def pixels_digest(video: np.ndarray) -> str:
    """SHA-256 of a video's decoded pixels, uint8 of shape (frames, pixels, pixels, 3)."""
    return hashlib.sha256(np.ascontiguousarray(video).tobytes()).hexdigest()


def write_frames(
    images: Sequence[dict[str, Any]],
    path: str | os.PathLike,
    record: dict[str, Any],
    metadata: dict[str, Any] | None = None,
) -> None:
    """Write the images of a simulation or capture, rows as in `FRAMES_SCHEMA`."""
    write_parquet(
        pa.Table.from_pylist(list(images), schema=DATASET_SCHEMA),
        path,
        metadata or {},
        record,
        compression="none",  # PNG is compressed already
    )


def read_frames(
    path: str | os.PathLike, video: str | None = None
) -> Iterator[tuple[str, int, bytes]]:
    """The images of a file, or of one video in it, in the order in which they were written.

    BadInput if the file is missing, damaged, or lacks a column. Each comes as its video, its
    position in that from 0, and the undecoded PNG, empty where the file has none.
    """
    table = read_parquet(path, ["video", "position", "image"])
    if video is not None:
        table = table.filter(pyarrow.compute.field("video") == video)
    for batch in table.to_batches(max_chunksize=256):
        for row in batch.to_pylist():
            yield row["video"], row["position"], (row["image"] or {}).get("bytes") or b""
