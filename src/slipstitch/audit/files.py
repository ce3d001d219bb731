"""Verification of all file hashes and all decoded images."""

import hashlib
import os
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.audit.contents import Contents
from slipstitch.audit.findings import Finding, Kind
from slipstitch.audit.lineage import Lineage
from slipstitch.errors import BadInput
from slipstitch.provenance import check_image, file_digest
from slipstitch.release.checksums import files_below
from slipstitch.release.shards import FOLDER

# Labels of an image that its video's row of the manifest repeats: column there -> column here.
SHARED = {
    "simulation": "simulation",
    "material": "material",
    "friction": "friction",
    "texture_id": "texture",
    "viewpoint_id": "viewpoint",
}
_BATCH_ROWS = 256


@dataclass
class Shard:
    """What one shard holds: by video, the digest of its pixels and its labels."""

    pixels: dict[str, str] = field(default_factory=dict)
    first_row: dict[str, int] = field(default_factory=dict)
    labels: dict[str, dict[str, Any]] = field(default_factory=dict)
    columns: dict[str, dict[str, list]] = field(default_factory=dict)
    images: int = 0
    problem: str | None = None


def _batches(path: Path) -> Iterator[pa.RecordBatch]:
    with pq.ParquetFile(path) as file:
        yield from file.iter_batches(batch_size=_BATCH_ROWS, use_threads=False)


def read_shard(path: Path) -> Shard:
    """Decode a shard's images and take down what it says of its videos."""
    shard = Shard()
    sums: dict[str, Any] = {}
    try:
        for batch in _batches(path):
            columns = {
                name: batch.column(name).to_pylist()
                for name in batch.schema.names
                if name != "image"
            }
            images = batch.column("image").field("bytes")
            for number, video in enumerate(columns["video"]):
                if video not in sums:
                    sums[video] = hashlib.sha256()
                    shard.first_row[video] = shard.images
                    shard.labels[video] = {name: values[number] for name, values in columns.items()}
                    shard.columns[video] = defaultdict(list)
                data = images[number].as_py() or b""
                check_image(data, f"an image of {video}")
                pixels = cv2.imdecode(np.frombuffer(data, np.uint8), 1)
                if pixels is None:
                    raise ValueError(f"an image of {video} cannot be decoded")
                sums[video].update(np.ascontiguousarray(pixels[..., ::-1]))
                for name, values in columns.items():
                    shard.columns[video][name].append(values[number])
                shard.images += 1
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        pa.ArrowException,
        BadInput,
    ) as error:
        shard.problem = str(error).splitlines()[0] if str(error) else type(error).__name__
    shard.pixels = {video: digest.hexdigest() for video, digest in sums.items()}
    return shard


def check_files(
    contents: Contents, jobs: int
) -> tuple[list[Finding], dict[str, int], dict[str, Shard]]:
    """Hash every file and decode every shard.

    Returns
    -------
    findings : list of Finding
    numbers : dict
        ``files, bytes, images`` that were looked at.
    shards : dict
        Shards that could be read, by path in the release.
    """
    folder, sums = contents.folder, contents.sums
    lineage = Lineage(contents)
    there = files_below(folder)
    findings = [
        Finding(Kind.MISSING, name, "is missing", lineage.clips_of_file(name))
        for name in sums
        if name not in set(there)
    ]
    findings += [
        Finding(Kind.MISSING, name, "listed in the manifest, but not in SHA256SUMS", clips)
        for name in sorted({row["shard"] for row in contents.rows} - set(sums))
        if (clips := lineage.clips_of_file(name))
    ]
    findings += [
        Finding(Kind.UNEXPLAINED, name, "not listed in SHA256SUMS")
        for name in there
        if name not in sums
    ]
    present = [name for name in there if name in sums]
    # The largest first, so that no thread is left with one at the end.
    order = sorted(present, key=lambda name: -os.path.getsize(folder / name))
    with ThreadPoolExecutor(jobs) as pool:
        digests = dict(zip(order, pool.map(lambda n: file_digest(folder / n), order), strict=True))
        shards = [name for name in order if name.startswith(f"{FOLDER}/")]
        decoded = dict(zip(shards, pool.map(lambda n: read_shard(folder / n), shards), strict=True))
    owner = {digest: name for name, digest in sums.items()}
    stated = contents.release.get("files", {})
    for name in present:
        clips = lineage.clips_of_file(name)
        if (folder / name).is_symlink():
            findings.append(Finding(Kind.ALTERED, name, "is a link instead of a file", clips))
        elif digests[name] != sums[name]:
            findings.append(_altered(lineage, name, digests[name], owner, decoded.get(name)))
        elif name in stated and stated[name] != digests[name]:
            what = "SHA256SUMS was rewritten: its digest differs from records/release.json"
            findings.append(Finding(Kind.ALTERED, name, what, clips))
        if name in decoded and contents.rows:
            findings += _check_shard(lineage, name, decoded[name], digests[name] == sums[name])
    numbers = {
        "files": len(present),
        "bytes": sum(os.path.getsize(folder / name) for name in present),
        "images": sum(shard.images for shard in decoded.values()),
    }
    return findings, numbers, decoded


def _altered(
    lineage: Lineage, name: str, digest: str, owner: dict[str, str], shard: Shard | None
) -> Finding:
    """A file whose bytes are others than the sums say, and what that means for its clips."""
    what, contents = "content differs from SHA256SUMS", lineage.contents
    clips = lineage.clips_of_file(name)
    if digest in owner:
        return Finding(Kind.ALTERED, name, f"has the content of {owner[digest]}", clips)
    if shard is not None and shard.problem is None and contents.rows:
        changed = tuple(
            clip
            for clip in clips
            if shard.pixels.get(clip) != contents.row_of[clip]["pixels_sha256"]
        )
        if not changed:
            return Finding(Kind.ALTERED, name, f"{what}; the pixels of its clips do not", ())
        clips = changed
    return Finding(Kind.ALTERED, name, what, clips)


def _check_shard(lineage: Lineage, name: str, shard: Shard, same_bytes: bool) -> list[Finding]:
    """Pixels, places and labels of a shard against the manifest."""
    if shard.problem is not None:
        what = f"cannot be read: {shard.problem}"
        return [Finding(Kind.ALTERED, name, what, lineage.clips_of_file(name))]
    findings = []
    row_of = lineage.contents.row_of
    expected = {video: row_of[video] for video in lineage.clips_of_file(name)}
    strangers = tuple(video for video in shard.pixels if video not in expected)
    if strangers:
        what = f"contains images of {strangers[0]}, which according to the manifest are in "
        "another shard or do not exist"
        findings.append(Finding(Kind.BROKEN, name, what))
    for video, row in expected.items():
        found = shard.pixels.get(video)
        if found is None:
            findings.append(Finding(Kind.BROKEN, name, f"contains no image of {video}", (video,)))
            continue
        if found != row["pixels_sha256"]:
            what = f"the decoded pixels of {video} do not match the manifest"
            findings.append(Finding(Kind.ALTERED, name, what, (video,)))
        problem = _labels(row, shard)
        if problem:
            # An edit of the bytes is the alteration; with the sums rewritten the chain tells.
            kind = Kind.BROKEN if same_bytes else Kind.ALTERED
            findings.append(Finding(kind, name, f"{video}: {problem}", (video,)))
    return findings


def _labels(row: dict[str, Any], shard: Shard) -> str | None:
    """What is wrong with the labels of a video's images, if anything."""
    video = row["video"]
    columns = shard.columns[video]
    for there, here in SHARED.items():
        if there in row and here in columns:
            other = next((value for value in columns[here] if value != row[there]), None)
            if other is not None:
                return f"{here} is {other!r} here, {row[there]!r} in the manifest"
    if shard.first_row[video] != row["first_row"]:
        return f"starts in row {shard.first_row[video]}, not {row['first_row']}"
    if columns.get("position") != list(range(row["frames"])):
        return f"its images are not the {row['frames']} of the manifest in order"
    return None
