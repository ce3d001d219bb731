"""The manifest of all videos of a dataset: its columns, its digest, writing and reading it."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import open_parquet, read_metadata, read_parquet, write_parquet
from slipstitch.design.splits import SIDES, check_no_simulation_on_both_sides
from slipstitch.images.camera import POSE

MANIFEST = "manifest.parquet"

MANIFEST_SCHEMA = pa.schema(
    [
        ("video", pa.string()),
        ("simulation", pa.string()),
        ("material_id", pa.string()),
        ("friction_id", pa.string()),
        ("replicate_id", pa.string()),
        ("texture_id", pa.string()),
        ("viewpoint_id", pa.string()),
        ("material", pa.string()),
        ("friction", pa.float64()),
        ("interpolated", pa.bool_()),
        ("texture", pa.string()),
        ("viewpoint", pa.string()),
        ("material_role", pa.string()),
        ("friction_role", pa.string()),
        ("texture_role", pa.string()),
        ("viewpoint_role", pa.string()),
        ("floor_role", pa.string()),
        ("viewpoint_turn_deg", pa.float64()),
        *((f"pose_{name}", pa.float64()) for name in POSE),
        ("floor", pa.string()),
        ("floor_reflectance", pa.float64()),
        ("floor_roughness", pa.float64()),
        ("split_by_video", pa.string()),
        ("split_by_simulation", pa.string()),
        ("frames", pa.int32()),
        ("pixels", pa.int32()),
        ("pixels_sha256", pa.string()),
        ("file", pa.string()),
    ]
)


#: Columns that datasets of before do not have: none of their videos is interpolated.
_LATER = ("interpolated",)


def dataset_digest(rows: Sequence[Mapping[str, Any]]) -> str:
    """SHA-256 of the manifest's rows; images enter by the digests of their decoded pixels."""
    return hashlib.sha256(json.dumps(list(rows), sort_keys=True).encode()).hexdigest()


def write_manifest(
    rows: Sequence[dict[str, Any]], out_dir: str | os.PathLike, record: dict[str, Any]
) -> None:
    """Write the rows of all videos, with the digest of the dataset."""
    write_parquet(
        pa.Table.from_pylist(list(rows), schema=MANIFEST_SCHEMA),
        Path(out_dir) / MANIFEST,
        {"dataset_digest": dataset_digest(rows)},
        record,
    )


def read_manifest(dataset: str | os.PathLike) -> tuple[list[dict[str, Any]], str]:
    """Rows and digest of the dataset in a folder.

    Raises
    ------
    BadInput
        If the manifest is missing or damaged, was altered, or its split by simulation leaks.
    """
    path = Path(dataset) / MANIFEST
    with open_parquet(path) as file:
        there = file.schema_arrow.names
    absent = [name for name in _LATER if name not in there]
    names = [name for name in MANIFEST_SCHEMA.names if name not in absent]
    rows = read_parquet(path, names).to_pylist()
    if not rows:
        raise BadInput(f"{path}: contains no videos")
    for split in ("split_by_video", "split_by_simulation"):
        for row in rows:
            if row[split] not in SIDES:
                raise BadInput(
                    f"{path}: {row['video']}: {split} is {row[split]!r}, "
                    f"allowed: {', '.join(SIDES)}"
                )
    try:
        check_no_simulation_on_both_sides(
            [row["simulation"] for row in rows], [row["split_by_simulation"] for row in rows]
        )
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from None
    digest = dataset_digest(rows)
    if read_metadata(path).get("dataset_digest") != digest:
        raise Damaged(path, "was altered: its rows do not match their digest")
    return rows, digest
