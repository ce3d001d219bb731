"""The manifest of all videos: labels of the grid's videos, columns, digest, writing, reading."""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import pyarrow as pa

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import open_parquet, read_metadata, read_parquet, write_parquet
from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design import splits
from slipstitch.design.grid import films, simulations, textures, viewpoints
from slipstitch.design.interpolation import filmed_friction, interpolations
from slipstitch.images.camera import POSE


def manifest_sides(config: Config) -> dict[str, tuple[str, str]]:
    """Every video of the grid -> its side in split_by_video and in split_by_simulation.

    Test-only textures and viewpoints test by video; by simulation they go with their simulation
    (and never train). Simulations of a test-only fabric or coefficient test in both. A video on a
    floor of the second training set has the side of the same video on its own floor.
    """
    trained = [
        simulation.id
        for simulation in simulations(config)
        if "test" not in (simulation.material_role, simulation.friction_role)
    ]
    fractions = (config.sample.validation_fraction, config.sample.test_fraction)
    of_simulation = splits.sides_of_simulations(config)
    views = viewpoints(config)
    main = {view["name"]: view["id"] for view in reversed(views)}  # each name's first id
    cloths = [texture["id"] for texture in textures(config) if texture["role"] == "train"]
    seen = [main[view] for view in config.render.viewpoints]
    trainable = [
        f"{name}_{texture}_{view}" for name, texture, view in product(trained, cloths, seen)
    ]
    of_video = splits.split_by_video(trainable, *fractions, seed=config.seed)
    names = {view["id"]: view["name"] for view in views}
    sides = {}
    for (name, view), worn in films(config).items():
        for texture in worn:
            twin = f"{name}_{texture}_{main[names[view]]}"
            sides[f"{name}_{texture}_{view}"] = (of_video.get(twin, "test"), of_simulation[name])
    return sides


def video_labels(config: Config) -> dict[str, dict[str, Any]]:
    """Every video of the grid, sorted -> the columns that configuration and seed decide."""
    calibrated = VIEWPOINTS["calibrated"].azimuth_deg
    catalogue = {item["id"]: item for item in textures(config) + viewpoints(config)}
    grid = {simulation.id: simulation for simulation in simulations(config)}
    between = interpolations(config)
    labels = {}
    for video, (by_video, by_simulation) in sorted(manifest_sides(config).items()):
        name, texture, view = video.rsplit("_", 2)
        simulation, shown = grid[name], between.get((name, view))
        of_grid = {key: one for key, one in asdict(simulation).items() if key not in ("seed", "id")}
        labels[video] = {
            "video": video,
            "simulation": name,
            **of_grid,
            "friction": filmed_friction(simulation, shown),
            "interpolated": shown is not None,
            "texture_id": texture,
            "texture": catalogue[texture]["name"],
            "texture_role": catalogue[texture]["role"],
            "viewpoint_id": view,
            "viewpoint": catalogue[view]["name"],
            "viewpoint_role": catalogue[view]["role"],
            "viewpoint_turn_deg": VIEWPOINTS[catalogue[view]["name"]].azimuth_deg - calibrated,
            "floor_role": catalogue[view]["floor_role"],
            "split_by_video": by_video,
            "split_by_simulation": by_simulation,
            "frames": config.sample.frames_kept,
            "pixels": config.render.pixels,
            "file": f"{name}.parquet",
        }
    return labels


MANIFEST = "manifest.parquet"

_COLUMNS = (
    *("video", "simulation", "material_id", "friction_id", "replicate_id", "texture_id"),
    *("viewpoint_id", "material", "friction", "interpolated", "texture", "viewpoint"),
    *("material_role", "friction_role", "texture_role", "viewpoint_role", "floor_role"),
    *("viewpoint_turn_deg", *(f"pose_{name}" for name in POSE)),
    *("floor", "floor_reflectance", "floor_roughness", "split_by_video", "split_by_simulation"),
    *("frames", "pixels", "pixels_sha256", "file"),
)
_KINDS = {  # the others are texts
    **{name: pa.float64() for name in _COLUMNS if name.startswith("pose_")},
    **dict.fromkeys(("friction", "viewpoint_turn_deg"), pa.float64()),
    **dict.fromkeys(("floor_reflectance", "floor_roughness"), pa.float64()),
    **dict.fromkeys(("frames", "pixels"), pa.int32()),
    "interpolated": pa.bool_(),
}
MANIFEST_SCHEMA = pa.schema([(name, _KINDS.get(name, pa.string())) for name in _COLUMNS])


def dataset_digest(rows: Sequence[Mapping[str, Any]]) -> str:
    """SHA-256 of the manifest's rows; images enter by the digests of their decoded pixels."""
    return hashlib.sha256(json.dumps(list(rows), sort_keys=True).encode()).hexdigest()


def write_manifest(
    rows: Sequence[dict[str, Any]], out_dir: str | os.PathLike, record: dict[str, Any]
) -> None:
    """Write the rows of all videos, with the digest of the dataset."""
    table = pa.Table.from_pylist(list(rows), schema=MANIFEST_SCHEMA)
    notes = {"dataset_digest": dataset_digest(rows)}
    write_parquet(table, Path(out_dir) / MANIFEST, notes, record)


def read_manifest(dataset: str | os.PathLike) -> tuple[list[dict[str, Any]], str]:
    """Rows and digest of the dataset in a folder; BadInput if damaged, altered or leaking."""
    path = Path(dataset) / MANIFEST
    with open_parquet(path) as file:
        there = file.schema_arrow.names
    # Datasets of before have no interpolated videos.
    names = [name for name in MANIFEST_SCHEMA.names if name in there or name != "interpolated"]
    rows = read_parquet(path, names).to_pylist()
    if not rows:
        raise BadInput(f"{path}: contains no videos")
    try:
        splits.check_no_simulation_on_both_sides(
            [row["simulation"] for row in rows], [row["split_by_simulation"] for row in rows]
        )
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from None
    digest = dataset_digest(rows)
    if read_metadata(path).get("dataset_digest") != digest:
        raise Damaged(path, "was altered: its rows do not match their digest")
    return rows, digest
