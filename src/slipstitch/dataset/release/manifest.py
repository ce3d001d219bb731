"""The manifest of a release: that of the sample stage, with named splits and image locations."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.provenance import attach_metadata
from slipstitch.dataset.manifest import dataset_digest
from slipstitch.dataset.release.splits import PREFIX, question

MANIFEST = "manifest.parquet"
# Columns of the sample stage's manifest that the release gives its own meaning.
SAMPLED = "sampled_"

COLUMNS = {
    "video": "id of the video: simulation, texture, viewpoint",
    "simulation": "id of the simulation: fabric, friction, replicate",
    "material_id": "id of the fabric",
    "friction_id": "id of the friction coefficient",
    "replicate_id": "id of the replicate: same fabric and friction, independent bench set-up",
    "texture_id": "id of the texture",
    "viewpoint_id": "id of the viewpoint",
    "material": "fabric (Wang, O'Brien and Ramamoorthi 2011)",
    "friction": "Coulomb friction coefficient between cloth and floor, and between layers of "
    "cloth if the simulation has self-contact",
    "interpolated": "whether the cloth lies between simulated ones, its friction coefficient "
    "between theirs; only videos that train",
    "texture": "texture of the cloth: its name in the manifest, its id in the shards",
    "viewpoint": "viewpoint: its name in the manifest, its id in the shards",
    "viewpoint_turn_deg": "azimuth of the viewpoint minus the calibrated one's, degrees",
    "pose_yaw_deg": "azimuth of the camera minus the calibrated viewpoint's, as it was calibrated, "
    "degrees; this and the other numbers of the pose are 0 where images were not rectified",
    "pose_pitch_deg": "elevation of the camera minus the calibrated viewpoint's, degrees",
    "pose_roll_deg": "turn of the camera about its own axis, degrees",
    "pose_log_distance": "logarithm of the camera's distance over the calibrated viewpoint's",
    "floor": "substrate, by name",
    "floor_reflectance": "specular reflectance of the floor at normal incidence",
    "floor_roughness": "roughness of the floor's reflection, as defined in Blender",
    "frames": "number of images of the video",
    "pixels": "side length of the square images",
    "pixels_sha256": "SHA-256 of the decoded pixels: uint8, (frames, pixels, pixels, 3), RGB",
    "position": "position of the image in its video, from 0",
    "frame": "number of the simulated frame",
    "time_s": "time since the stage began to move, s",
    "stage_x_m": "position of the stage along the drag direction, m",
    "image": "PNG, RGB",
    "part": "number of the part; videos with the same side in every split share one",
    "shard": "file that contains the images",
    "first_row": "row of the first image in it; the others follow",
}


def described(column: str) -> str:
    """The meaning of a column of the manifest or of a shard."""
    if column in COLUMNS:
        return COLUMNS[column]
    if column.endswith("_role"):
        return f"train, or test if the {column.removesuffix('_role')} is for testing only"
    if column.startswith(SAMPLED):
        return f"`{column.removeprefix(SAMPLED)}` as the sampling stage wrote it"
    if column.startswith(PREFIX):
        return f"side in the split {column.removeprefix(PREFIX)}: train, validation, test or none"
    return column.replace("_", " ")


def _sampled_name(column: str) -> str:
    renamed = column == "file" or column.startswith(PREFIX)
    return f"{SAMPLED}{column}" if renamed else column


def released_rows(
    sampled: Sequence[Mapping[str, Any]],
    splits: Mapping[str, Sequence[str | None]],
    part_of: Sequence[str],
    places: Mapping[str, Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Rows of the release's manifest."""
    rows = []
    for number, row in enumerate(sampled):
        released = {_sampled_name(name): value for name, value in row.items()}
        released |= {PREFIX + name: sides[number] for name, sides in splits.items()}
        rows.append({**released, "part": part_of[number], **places[row["video"]]})
    return rows


def sampled_rows(released: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[dict]:
    """The sample stage's rows again, from the release's; `names` are that manifest's columns."""
    return [{name: row[_sampled_name(name)] for name in names} for row in released]


def released_schema(sampled: pa.Schema, splits: Sequence[str]) -> pa.Schema:
    """Columns of the release's manifest."""
    fields = [pa.field(_sampled_name(column.name), column.type) for column in sampled]
    fields += [pa.field(PREFIX + name, pa.string()) for name in splits]
    fields += [("part", pa.string()), ("shard", pa.string()), ("first_row", pa.int64())]
    return pa.schema(fields)


def notes_of(
    rows: Sequence[Mapping[str, Any]], sampled: pa.Schema, splits: Sequence[str]
) -> dict[str, Any]:
    """What the release's manifest says of itself."""
    return {
        "dataset_digest": dataset_digest(rows),
        "sampled_columns": sampled.names,
        "splits": {name: question(name) for name in splits},
    }


def write_manifest(
    rows: Sequence[Mapping[str, Any]], sampled: pa.Schema, splits: Sequence[str], folder: Path
) -> None:
    """Write ``manifest.parquet``; nothing in it differs between equal runs."""
    table = pa.Table.from_pylist(list(rows), schema=released_schema(sampled, splits))
    notes = notes_of(rows, sampled, splits)
    pq.write_table(attach_metadata(table, notes), folder / MANIFEST, compression="zstd")
