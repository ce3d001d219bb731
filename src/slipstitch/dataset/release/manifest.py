"""The manifest of a release: that of the sample stage, with named splits and image locations.

Every split is a column ``split_<name>`` of the manifest; a video that a split does not use has no
side in it. The videos that have the same side in every split form a *part*: shards hold whole
parts, so that a split is a list of files and no image is stored twice.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.provenance import attach_metadata
from slipstitch.config import Config
from slipstitch.dataset.manifest import MANIFEST, MANIFEST_SCHEMA, dataset_digest
from slipstitch.design.grid import simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.design.splits import SIDES

PREFIX = "split_"
#: Of the fabrics, and of the inner friction coefficients, kept for testing; at least one.
UNSEEN_SHARE = 0.2
Row = Mapping[str, Any]

QUESTIONS = {
    "by_video": "videos at random, as in the paper: the simulation of a test video is also in "
    "the training set, with another texture or view",
    "by_simulation": "generalisation to unseen simulations: whole simulations held out",
    "unseen_friction": "whole friction coefficients held out, between the lowest and the highest "
    "unless the grid has test-only ones; videos interpolated from or across them are left out",
    "unseen_fabric": "whole fabrics held out; videos interpolated from them are left out",
}


def question(name: str) -> str:
    """The question of a split, in words."""
    if name in QUESTIONS:
        return QUESTIONS[name]
    kind = name.removeprefix("unseen_")
    return (
        f"trained as by_video, tested with test-only {kind}s under training conditions: the "
        f"{kind} is unseen, the motion of the cloth is not"
    )


def _roles(row: Row) -> dict[str, str]:
    """Kind of variation -> train or test, from the columns ``<kind>_role``."""
    return {name.removesuffix("_role"): row[name] for name in row if name.endswith("_role")}


def unseen_frictions(frictions: Sequence[float], share: float) -> list[float]:
    """Coefficients that unseen_friction tests, evenly between the ends of at least three."""
    inner = sorted(set(frictions))[1:-1]
    if not inner:
        return []
    count = min(max(1, round(share * len(inner))), max(1, len(inner) - 1))
    places = (np.arange(count) + 0.5) * len(inner) / count
    return [inner[int(place)] for place in places]


def unseen_fabrics(materials: Sequence[str], share: float, seed: int) -> list[str]:
    """Fabrics that unseen_fabric tests, drawn at random; empty for fewer than two."""
    names = sorted(set(materials))
    if len(names) < 2:
        return []
    count = min(max(1, round(share * len(names))), len(names) - 1)
    drawn = np.random.default_rng([seed, len(names)]).permutation(names)[:count]
    return sorted(map(str, drawn))


def split_columns(rows: Sequence[Row], config: Config) -> dict[str, list[str | None]]:
    """Every named split's side of every video: train, validation, test or None (not used).

    The coefficients and fabrics that are held out are simulated ones. A video whose cloth is
    interpolated never tests them. It trains unless a held-out fabric is in its cloth, or a held-out
    coefficient is one of its simulations' or lies between these. `rows` are the sample stage's
    manifest, in whose order the sides are; splits that have no test video or none to train on are
    left out.
    """
    splits: dict[str, list[str | None]] = {}
    trains = ["test" not in _roles(row).values() for row in rows]
    for column in (name for name in rows[0] if name.startswith(PREFIX)):
        splits[column.removeprefix(PREFIX)] = [
            row[column] if trained else None for row, trained in zip(rows, trains, strict=True)
        ]
    grid = {simulation.id: simulation for simulation in simulations(config)}
    shown = interpolations(config)
    films = [(row["simulation"], row["viewpoint_id"]) for row in rows]
    parents = [[grid[name] for name in shown[one].weights] if one in shown else [] for one in films]
    simulated = [
        row for row, of, trained in zip(rows, parents, trains, strict=True) if trained and not of
    ]
    frictions = unseen_frictions([row["friction"] for row in simulated], UNSEEN_SHARE)
    fabrics = unseen_fabrics([row["material"] for row in simulated], UNSEEN_SHARE, config.seed)
    splits["unseen_friction"], splits["unseen_fabric"] = [], []
    for row, of, trained in zip(rows, parents, trains, strict=True):
        ends = [parent.friction for parent in of] or [row["friction"]]
        friction = any(min(ends) <= one <= max(ends) for one in frictions)
        fabric = not {row["material"], *(parent.material for parent in of)}.isdisjoint(fabrics)
        for name, held in (("unseen_friction", friction), ("unseen_fabric", fabric)):
            splits[name].append(_held_out(row, bool(of), held) if trained else None)
    for kind in _roles(rows[0]):
        # Where the grid itself keeps some for testing, those are the unseen ones.
        if any(row[f"{kind}_role"] == "test" for row in rows):
            name = "unseen_fabric" if kind == "material" else f"unseen_{kind}"
            splits[name] = [_unseen_kind(row, kind) for row in rows]
    return {name: sides for name, sides in splits.items() if {"train", "test"} <= set(sides)}


def _held_out(row: Row, interpolated: bool, held: bool) -> str | None:
    """Side in unseen_friction or unseen_fabric; only simulated cloths test."""
    if held:
        return None if interpolated else "test"
    return "validation" if row[f"{PREFIX}by_simulation"] == "validation" else "train"


def _unseen_kind(row: Row, kind: str) -> str | None:
    """Side in unseen_<kind>: trained by video, tested on the videos whose `kind` alone is new."""
    new = [name for name, role in _roles(row).items() if role == "test"]
    if new == [kind]:
        return "test"
    side = row[f"{PREFIX}by_video"]
    return side if not new and side != "test" else None


def parts(splits: Mapping[str, Sequence[str | None]]) -> list[str]:
    """Every video's part: part00, part01, ...; equal for videos with equal sides everywhere."""
    order = {side: place for place, side in enumerate((*SIDES, None))}
    cells = list(zip(*splits.values(), strict=True))
    known = sorted(set(cells), key=lambda cell: [order[side] for side in cell])
    names = {cell: f"part{place:02d}" for place, cell in enumerate(known)}
    return [names[cell] for cell in cells]


def parts_of_splits(
    splits: Mapping[str, Sequence[str | None]], names: Sequence[str]
) -> dict[str, dict[str, list[str]]]:
    """Split -> side -> parts that make it up."""
    found: dict[str, dict[str, list[str]]] = {}
    for split, sides in splits.items():
        of_side: dict[str, set[str]] = defaultdict(set)
        for side, part in zip(sides, names, strict=True):
            if side is not None:
                of_side[side].add(part)
        found[split] = {side: sorted(of_side[side]) for side in SIDES if side in of_side}
    return found


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


def write_manifest(rows: Sequence[Mapping[str, Any]], splits: Sequence[str], folder: Path) -> None:
    """Write ``manifest.parquet``; nothing in it differs between equal runs."""
    fields = [pa.field(_sampled_name(column.name), column.type) for column in MANIFEST_SCHEMA]
    fields += [pa.field(PREFIX + name, pa.string()) for name in splits]
    fields += [("part", pa.string()), ("shard", pa.string()), ("first_row", pa.int64())]
    table = pa.Table.from_pylist(list(rows), schema=pa.schema(fields))
    notes = {
        "dataset_digest": dataset_digest(rows),
        "sampled_columns": MANIFEST_SCHEMA.names,
        "splits": {name: question(name) for name in splits},
    }
    pq.write_table(attach_metadata(table, notes), folder / MANIFEST, compression="zstd")
