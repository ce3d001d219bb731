"""Videos of the dataset: image shards read, files of the dataset written, videos decoded in memory.

Every frame is decoded once, as 8-bit RGB: 216 videos of 30 frames at 64 pixels take 80 MB; the
paper's 3840 training videos 1.4 GB.
"""

import hashlib
import io
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
from PIL import Image

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import check_image, read_metadata, read_parquet, write_parquet
from slipstitch.config.train import REFLECTIVE
from slipstitch.dataset.manifest import read_manifest
from slipstitch.design.grid import sampled_frames
from slipstitch.images.camera import KEYPOINTS_UV

COLUMNS = ("simulation", "texture", "viewpoint", "frame", "time_s", "stage_x_m", "image")


def decode(png: bytes, where: str, pixels: int | None = None) -> np.ndarray:
    """An image file (`where`) as uint8 RGB, (pixels, pixels, 3); BadInput if it is none such."""
    check_image(png, where)
    try:
        with Image.open(io.BytesIO(png)) as image:
            mode, array = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise BadInput(f"{where}: damaged image: {error}") from None
    side = pixels or array.shape[0]
    if mode != "RGB" or array.shape != (side, side, 3):
        size = "x".join(map(str, array.shape[1::-1]))
        raise BadInput(f"{where}: image is {size} {mode}; must be {side}x{side} RGB")
    return array


def simulations_of(path: str | os.PathLike) -> set[str]:
    """Ids of the simulations that a shard holds images of."""
    names = set(read_parquet(path, ["simulation"]).column(0).to_pylist())
    if not names:
        raise BadInput(f"{path}: contains no images")
    return names


def read_shard(path: str | os.PathLike, frames: np.ndarray) -> dict[tuple[str, str, str], list]:
    """The wanted frames of every video in a shard: (simulation, texture, viewpoint) -> rows.

    A row has the `COLUMNS`, the image undecoded.

    BadInput if the file is damaged, a wanted frame is missing or there twice, or an image is empty.
    """
    table = read_parquet(path, COLUMNS)
    wanted = frames.tolist()
    videos: dict[tuple[str, str, str], dict[int, dict]] = {}
    for batch in table.to_batches(max_chunksize=1024):
        for row in batch.to_pylist():
            video = (row["simulation"], row["texture"], row["viewpoint"])
            kept, number = videos.setdefault(video, {}), row["frame"]
            if number not in wanted:
                continue
            where = f"{path}: {'_'.join(video)}"
            if number in kept:
                raise BadInput(f"{where} has frame {number} twice")
            if not (row["image"] or {}).get("bytes"):
                raise BadInput(f"{where} frame {number} has no image")
            kept[number] = row
    for video, kept in videos.items():
        if missing := [number for number in wanted if number not in kept]:
            raise BadInput(
                f"{path}: {'_'.join(video)} lacks frame {missing[0]} "
                f"({len(missing)} of the {len(wanted)} sampled frames missing)"
            )
    return {video: [kept[number] for number in wanted] for video, kept in videos.items()}


IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_COLUMNS: dict[str, pa.DataType] = {
    **dict.fromkeys(("video", "simulation", "texture", "viewpoint", "material"), pa.string()),
    "friction": pa.float64(),
    **dict.fromkeys(("position", "frame"), pa.int32()),
    **dict.fromkeys(("time_s", "stage_x_m"), pa.float64()),
    "image": IMAGE,
}
_KINDS = {pa.string(): "string", pa.float64(): "float64", pa.int32(): "int32"}
_FEATURES = {
    name: {"_type": "Image"} if kind == IMAGE else {"dtype": _KINDS[kind], "_type": "Value"}
    for name, kind in _COLUMNS.items()
}
#: Of the images, with the metadata by which Hugging Face datasets shows `image` as images.
DATASET_SCHEMA = pa.schema(
    _COLUMNS, metadata={"huggingface": json.dumps({"info": {"features": _FEATURES}})}
)


def pixels_digest(video: np.ndarray) -> str:
    """SHA-256 of a video's decoded pixels, uint8 of shape (frames, pixels, pixels, 3)."""
    return hashlib.sha256(np.ascontiguousarray(video).tobytes()).hexdigest()


def write_frames(
    images: Sequence[dict[str, Any]],
    path: str | os.PathLike,
    record: dict[str, Any],
    metadata: dict[str, Any] | None = None,
) -> None:
    """Write the images of a simulation or capture, rows as in `DATASET_SCHEMA`."""
    table = pa.Table.from_pylist(list(images), schema=DATASET_SCHEMA)
    # PNG is compressed already.
    write_parquet(table, path, metadata or {}, record, compression="none")


def read_frames(
    path: str | os.PathLike, video: str | None = None
) -> Iterator[tuple[str, int, bytes]]:
    """Give the images of a file, or of one video in it, in the order in which they were written.

    Each as its video, its position in that, and the undecoded PNG, empty where there is none.
    """
    table = read_parquet(path, ["video", "position", "image"])
    if video is not None:
        table = table.filter(pyarrow.compute.field("video") == video)
    for batch in table.to_batches(max_chunksize=256):
        for row in batch.to_pylist():
            yield row["video"], row["position"], (row["image"] or {}).get("bytes") or b""


ROLES = ("material", "friction", "texture", "viewpoint", "floor")


@dataclass(frozen=True)
class Videos:
    """Videos and what is known of them."""

    rows: list[dict[str, Any]]  # their rows of the manifest, n of them
    pixels: np.ndarray  # uint8, shape (n, frames, side, side, 3)
    digest: str  # digest of the whole dataset (also of the videos that are not here)
    # float32 (n, frames, points, 3): keypoints of the cloth, where there are for all videos
    points_m: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def chosen(self, use: np.ndarray) -> "Videos":
        """Those where `use` (bool, shape (n,)) is true."""
        points_m = None if self.points_m is None else self.points_m[use]
        return Videos([*compress(self.rows, use)], self.pixels[use], self.digest, points_m)

    def seen_with(self, pixels: int, frames: int | None) -> "Videos":
        """With fewer frames, at regular intervals from the first, and images of another side."""
        stored = self.pixels.shape[1]
        kept = sampled_frames(stored, frames or stored)
        seen = resized(self.pixels[:, kept], pixels)
        points_m = None if self.points_m is None else self.points_m[:, kept]
        return Videos(self.rows, seen, self.digest, points_m)


def read_videos(
    dataset: str | os.PathLike,
    chosen: Callable[[dict[str, Any]], bool] = lambda row: True,
    pixels: int | None = None,
    frames: int | None = None,
) -> Videos:
    """Decode the chosen videos of a dataset, a folder with ``manifest.parquet`` and its files.

    `chosen` says of a manifest row whether to read its video; `pixels` and `frames` are the side of
    the images and the number of frames, at regular intervals from the first, by default as
    rendered, and all. BadInput if a file is missing, damaged or altered, a video has not all its
    frames in order, or nothing is chosen.
    """
    every, digest = read_manifest(dataset)
    rows = [row for row in every if chosen(row)]
    if not rows:
        raise BadInput(f"{dataset}: none of its {len(every)} videos matches the selection")
    rows.sort(key=lambda row: row["video"])
    shapes = {(row["frames"], row["pixels"]) for row in rows}
    if len(shapes) > 1:
        raise BadInput(f"{dataset}: videos of different sizes: {sorted(shapes)} (frames, pixels)")
    ((stored, rendered),) = shapes
    kept = sampled_frames(stored, frames or stored)
    side = pixels or rendered
    array = np.empty((len(rows), len(kept), side, side, 3), np.uint8)
    points_m = np.full((len(rows), len(kept), len(KEYPOINTS_UV), 3), np.nan, np.float32)
    place = {row["video"]: index for index, row in enumerate(rows)}
    for file in sorted({row["file"] for row in rows}):
        path = Path(dataset) / file
        found: dict[str, list[np.ndarray]] = defaultdict(list)
        for video, position, png in read_frames(path):
            if video in place:
                where = f"{path}: {video} position {position}"
                found[video].append(decode(png, where, rendered))
        marked = read_metadata(path).get("marked_points_m", {})
        for row in (row for row in rows if row["file"] == file):
            index = place[row["video"]]
            whole = np.stack(found[row["video"]] or [np.empty((rendered, rendered, 3), np.uint8)])
            if pixels_digest(whole) != row["pixels_sha256"]:
                what = f"{row['video']} was altered: its pixels do not match the manifest"
                raise Damaged(path, what)
            array[index] = resized(whole[kept], side)
            if row["viewpoint_id"] in marked:
                places = np.array(marked[row["viewpoint_id"]], np.float32)
                points_m[index] = places.reshape(stored, -1, 3)[kept]
    return Videos(rows, array, digest, None if np.isnan(points_m).any() else points_m)


def resized(frames: np.ndarray, side: int) -> np.ndarray:
    """Square frames (..., any, any, 3) averaged down (or blown up) to a side."""
    *leading, before = frames.shape[:-2]
    if side == before:
        return frames
    result = np.empty((*leading, side, side, 3), np.uint8)
    filtered = Image.Resampling.BOX if side < before else Image.Resampling.BICUBIC
    for place in np.ndindex(*leading):
        result[place] = Image.fromarray(frames[place]).resize((side, side), filtered)
    return result


def takes_part(row: Mapping[str, Any], trained_on: str = "") -> bool:
    """Whether a video may train: nothing in it (`ROLES`) is for testing, or a floor that trains."""
    return test_only(row) <= ({"floor"} if trained_on == REFLECTIVE else set())


def test_only(row: Mapping[str, Any]) -> set[str]:
    """Test-only properties of a video: material, friction, texture, viewpoint."""
    return {kind for kind in ROLES if row[f"{kind}_role"] == "test"}
