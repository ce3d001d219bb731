"""Reading and validating the image shards of the render stage."""

import io
import os
from dataclasses import dataclass

import numpy as np
from PIL import Image

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import check_image, read_parquet

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

    Parameters
    ----------
    png : bytes
    where : str
        What to call the image in an error.
    pixels : int, optional
        Side that it must have; any square by default.

    Raises
    ------
    BadInput
        If it cannot be decoded, is not RGB, not square, or of another size.
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

    Parameters
    ----------
    path : path
    frames : ndarray of int
        Frame numbers to keep, in this order.

    Returns
    -------
    dict
        (simulation, texture, viewpoint) -> list of `Frame`.

    Raises
    ------
    BadInput
        If the file is damaged, a wanted frame is missing or there twice, or an image is empty.
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
