"""The images of one simulation or capture in a dataset: their columns, writing and reading them."""

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute

from slipstitch.base.provenance import read_parquet, write_parquet

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

    Yields
    ------
    video : str
    position : int
        In the video, from 0.
    png : bytes
        Undecoded; empty where the file has none.

    Raises
    ------
    BadInput
        If the file is missing, damaged, or lacks a column.
    """
    table = read_parquet(path, ["video", "position", "image"])
    if video is not None:
        table = table.filter(pyarrow.compute.field("video") == video)
    for batch in table.to_batches(max_chunksize=256):
        for row in batch.to_pylist():
            yield row["video"], row["position"], (row["image"] or {}).get("bytes") or b""
