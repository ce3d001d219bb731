"""Reading the dataset: its videos in memory, every frame decoded once, as 8-bit RGB.

216 videos of 30 frames at 64 pixels take 80 MB; the paper's 3840 training videos 1.4 GB.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import read_metadata
from slipstitch.config.train import REFLECTIVE
from slipstitch.dataset.images import decode, pixels_digest, read_frames
from slipstitch.dataset.manifest import read_manifest
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.images.keypoints import KEYPOINTS_UV

ROLES = ("material", "friction", "texture", "viewpoint", "floor")


@dataclass(frozen=True)
class Videos:
    """Videos and what is known of them."""

    rows: list[dict[str, Any]]  # their rows of the manifest, n of them
    pixels: np.ndarray  # uint8, shape (n, frames, side, side, 3)
    digest: str  # digest of the whole dataset (also of the videos that are not here)
    # Of the cloth (`slipstitch.images.keypoints`), where the dataset has them for all videos:
    # float32, shape (n, frames, points, 3)
    points_m: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def chosen(self, use: np.ndarray) -> "Videos":
        """Those where `use` (bool, shape (n,)) is true."""
        rows = [row for row, one in zip(self.rows, use, strict=True) if one]
        points_m = None if self.points_m is None else self.points_m[use]
        return Videos(rows, self.pixels[use], self.digest, points_m)

    def seen_with(self, pixels: int, frames: int | None) -> "Videos":
        """With fewer frames, at regular intervals from the first, and images of another side."""
        stored, side = self.pixels.shape[1:3]
        kept = sampled_frames(stored, frames or stored)
        seen = self.pixels[:, kept]
        if pixels != side:
            seen = np.stack([resized(video, pixels) for video in seen])
        points_m = None if self.points_m is None else self.points_m[:, kept]
        return Videos(self.rows, seen, self.digest, points_m)


def read_videos(
    dataset: str | os.PathLike,
    chosen: Callable[[dict[str, Any]], bool] = lambda row: True,
    pixels: int | None = None,
    frames: int | None = None,
) -> Videos:
    """Decode the chosen videos of a dataset.

    Parameters
    ----------
    dataset : path
        Folder with ``manifest.parquet`` and ``{simulation}.parquet``.
    chosen : callable
        Says of a manifest row whether to read its video.
    pixels, frames : int, optional
        Side of the images, averaged down (or blown up) to it, and number of the frames, at regular
        intervals from the first; by default as rendered, and all.

    Raises
    ------
    BadInput
        If a file is missing, damaged or altered, a video has not all its frames in order, or
        nothing is chosen. Digests of the decoded pixels are compared with the manifest's.
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
        found: dict[str, list[np.ndarray]] = {}
        for video, position, png in read_frames(path):
            if video not in place:
                continue
            decoded = found.setdefault(video, [])
            where = f"{path}: {video} position {position}"
            if position != len(decoded):
                raise BadInput(f"{where}: position {len(decoded)} expected here")
            decoded.append(decode(png, where, rendered))
        marked = read_metadata(path).get("marked_points_m", {})
        for video in (row["video"] for row in rows if row["file"] == file):
            row = rows[place[video]]
            images = found.get(video, [])
            if len(images) != stored:
                raise BadInput(f"{path}: {video} has {len(images)} frames; must be {stored}")
            whole = np.stack(images)
            if pixels_digest(whole) != row["pixels_sha256"]:
                raise Damaged(path, f"{video} was altered: its pixels do not match the manifest")
            seen = whole[kept]
            array[place[video]] = seen if side == rendered else resized(seen, side)
            if row["viewpoint_id"] in marked:
                places = np.array(marked[row["viewpoint_id"]], np.float32)
                points_m[place[video]] = places.reshape(stored, -1, 3)[kept]
    return Videos(rows, array, digest, None if np.isnan(points_m).any() else points_m)


def resized(video: np.ndarray, side: int) -> np.ndarray:
    """Frames (frames, any, any, 3) averaged down (or blown up) to another side."""
    filtered = Image.Resampling.BOX if side < video.shape[1] else Image.Resampling.BICUBIC
    return np.stack(
        [np.asarray(Image.fromarray(frame).resize((side, side), filtered)) for frame in video]
    )


def takes_part(row: Mapping[str, Any], trained_on: str = "") -> bool:
    """Whether a video may train: nothing in it (`ROLES`) is for testing.

    Of `slipstitch.config.train.REFLECTIVE`, floors of the second training set may.
    """
    return test_only(row) <= ({"floor"} if trained_on == REFLECTIVE else set())


def test_only(row: Mapping[str, Any]) -> set[str]:
    """Test-only properties of a video: material, friction, texture, viewpoint."""
    return {kind for kind in ROLES if row[f"{kind}_role"] == "test"}
