"""Verification of all file hashes and all decoded images."""

import hashlib
import os
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import file_digest
from slipstitch.dataset.audit import admission
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.findings import Kind, not_part
from slipstitch.dataset.release.checksums import files_below
from slipstitch.dataset.release.shards import FOLDER
from slipstitch.dataset.videos import DATASET_SCHEMA, decode

_LABELS = ("simulation", "material", "friction", "texture_id", "viewpoint_id")
# Labels of an image that its video's row of the manifest repeats: column there -> column here.
SHARED = {name: name.removesuffix("_id") for name in _LABELS}
_GROWS = "takes far more memory than it has bytes; not read"


@dataclass
class Shard:
    """The content of a shard, by video; why it could not be read, or how it is odd."""

    pixels: dict[str, str] = field(default_factory=dict)
    first_row: dict[str, int] = field(default_factory=dict)
    columns: dict[str, dict[str, list]] = field(default_factory=dict)
    images: int = 0
    problem: str | None = None
    odd: str | None = None
    grows: bool = False
    flaws: dict[str, str] = field(default_factory=dict)


def decoded_shard(path: Path, pixels: int | None = None) -> Shard:
    """Decode a shard's images and take down what it says of its videos."""
    shard = Shard()
    sums: dict[str, Any] = {}
    try:
        shard.odd = admission.check_parquet(path, images=True)
        if not pq.read_schema(path).equals(DATASET_SCHEMA, check_metadata=True):
            shard.odd = "its columns are not those of a shard"
        for batch in admission.batches(path):
            names = [name for name in batch.schema.names if name != "image"]
            columns = {name: batch.column(name).to_pylist() for name in names}
            images, paths = (batch.column("image").field(name) for name in ("bytes", "path"))
            for number, video in enumerate(columns["video"]):
                if video not in sums:
                    sums[video] = hashlib.sha256()
                    shard.first_row[video] = shard.images
                    shard.columns[video] = defaultdict(list)
                try:
                    image = decode(images[number].as_py() or b"", "an image", pixels)
                    sums[video].update(image.tobytes())
                except BadInput as problem:
                    shard.flaws.setdefault(video, str(problem))
                for name, values in columns.items():
                    shard.columns[video][name].append(values[number])
                shard.columns[video]["path"].append(paths[number].as_py())
                shard.images += 1
    except MemoryError:
        shard.problem, shard.grows = _GROWS, True
    except admission.Harmful as error:
        shard.problem, shard.grows = str(error).removeprefix(f"{path}: "), True
    except admission.UNUSABLE as error:
        shard.problem = first_line(error)
    shard.pixels = {video: digest.hexdigest() for video, digest in sums.items()}
    return shard


def check_files(contents: Contents, jobs: int) -> tuple[dict[str, int], dict[str, Shard]]:
    """Hash every file, decode every shard; return the numbers looked at, and the shards by path."""
    folder, sums = contents.folder, contents.sums
    there = files_below(folder)
    _check_listing(contents, there)
    present = [name for name in there if name in sums]
    # The largest first, so that no thread is left with one at the end.
    order = sorted(present, key=lambda name: -os.path.getsize(folder / name))
    shards = [name for name in order if name.startswith(f"{FOLDER}/")]
    side = contents.config.render.pixels if contents.config else None

    with ThreadPoolExecutor(jobs) as pool:
        digests = dict(zip(order, pool.map(lambda n: file_digest(folder / n), order), strict=True))
        read = pool.map(lambda n: decoded_shard(folder / n, side), shards)
        decoded = dict(zip(shards, read, strict=True))
    for name, shard in decoded.items():
        if shard.grows and digests[name] == sums[name]:
            raise admission.Harmful(f"{folder / name}: {shard.problem}")
    owner = {digest: name for name, digest in sums.items()}
    stated = contents.release.get("files", {})
    for name in present:
        if digests[name] != sums[name]:
            _altered(contents, name, owner.get(digests[name]), decoded.get(name))
        elif name in stated and stated[name] != digests[name]:
            what = "SHA256SUMS was rewritten: its digest differs from records/release.json"
            contents.find(Kind.ALTERED, name, what, contents.clips_of(name))
        if name in decoded and contents.rows:
            _check_shard(contents, name, decoded[name], digests[name] == sums[name])
    numbers = {
        "files": len(present),
        "bytes": sum(os.path.getsize(folder / name) for name in present),
        "images": sum(shard.images for shard in decoded.values()),
    }
    return numbers, decoded


def _check_listing(contents: Contents, there: list[str]) -> None:
    """Note files that are missing, and those that are not part of the release."""
    sums = contents.sums
    for name in sums.keys() - set(there):
        contents.find(Kind.MISSING, name, "is missing", contents.clips_of(name))
    for name in {row["shard"] for row in contents.rows} - set(sums):
        what = "listed in the manifest, but not in SHA256SUMS"
        contents.find(Kind.MISSING, name, what, contents.clips_of(name))
    others = [name for name in there if name not in sums]
    for name in others:
        if name.startswith(f"{FOLDER}/") and name.endswith(".parquet"):
            what = "not listed in SHA256SUMS, but loaded with the other shards"
            contents.find(Kind.UNEXPLAINED, name, what)
    contents.remarks += [not_part("the release", others)] if others else []


def _altered(contents: Contents, name: str, owner: str | None, shard: Shard | None) -> None:
    """Note a file whose bytes are others than the sums say, and what that means for its clips."""
    what, clips = "content differs from SHA256SUMS", contents.clips_of(name)
    if owner is not None:
        what = f"has the content of {owner}"
    elif shard is not None and shard.problem is None and contents.rows:
        own = {clip: contents.row_of[clip]["pixels_sha256"] for clip in clips}
        clips = tuple(clip for clip in clips if shard.pixels.get(clip) != own[clip])
        what += "" if clips else "; the pixels of its clips do not"
    contents.find(Kind.ALTERED, name, what, clips)


def _check_shard(contents: Contents, name: str, shard: Shard, same_bytes: bool) -> None:
    """Compare pixels, places and labels of a shard with the manifest."""
    clips = contents.clips_of(name)
    if shard.problem is not None:
        contents.find(Kind.ALTERED, name, f"cannot be read: {shard.problem}", clips)
        return
    if shard.odd is not None:
        contents.broken(name, shard.odd, clips)
    known = set(clips)
    if strangers := [video for video in shard.pixels if video not in known]:
        what = "which according to the manifest are in another shard or do not exist"
        contents.broken(name, f"contains images of {strangers[0]}, {what}")
    for video in clips:
        row, found = contents.row_of[video], shard.pixels.get(video)
        if found is None:
            contents.broken(name, f"contains no image of {video}", [video])
            continue
        if video in shard.flaws:
            contents.find(Kind.ALTERED, name, f"{video}: {shard.flaws[video]}", [video])
        elif found != row["pixels_sha256"]:
            what = f"the decoded pixels of {video} do not match the manifest"
            contents.find(Kind.ALTERED, name, what, [video])
        if problem := _labels(row, shard):
            # An edit of the bytes is the alteration; with the sums rewritten the chain tells.
            kind = Kind.BROKEN if same_bytes else Kind.ALTERED
            contents.find(kind, name, f"{video}: {problem}", [video])


def _labels(row: dict[str, Any], shard: Shard) -> str | None:
    """Errors in the labels of a video's images."""
    video = row["video"]
    columns = shard.columns[video]
    for there, here in SHARED.items():
        for value in columns.get(here, ()) if there in row else ():
            if value != row[there] and value is not None:
                return f"{here} is {value!r} here, {row[there]!r} in the manifest"
    if shard.first_row[video] != row["first_row"]:
        return f"starts in row {shard.first_row[video]}, not {row['first_row']}"
    if columns.get("position") != list(range(row["frames"])):
        return f"its images are not the {row['frames']} of the manifest in order"
    if columns["path"] != [f"{video}_{n:04d}.png" for n in columns["frame"] if n is not None]:
        return f"its images are not named {video}_<frame>.png"
    return None
