"""Tracing every clip to its origin: rendering, simulation, calibration, fabric, configuration.

Two sorts of evidence. Records are compared with each other: what a file was made from must be the
file that the next record is about. And what follows from configuration and seed alone (labels,
seeds, perturbations, stage positions, splits) is recomputed; no edit of the release can make
that agree, short of editing the configuration and every record with it.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest
from slipstitch.config import Config
from slipstitch.config.catalogue import FABRICS_FILE, VIEWPOINTS
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.audit.files import Shard
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.audit.lineage import SAMPLED_MANIFEST, Lineage
from slipstitch.dataset.audit.recorded import check_recorded
from slipstitch.dataset.dataset import manifest_sides
from slipstitch.dataset.manifest import dataset_digest
from slipstitch.dataset.release.code import SOURCES
from slipstitch.dataset.release.currency import (
    catalogue_changes,
    config_changes,
    current_digest,
    recorded_entries,
)
from slipstitch.dataset.release.manifest import MANIFEST, SAMPLED, sampled_rows
from slipstitch.dataset.release.records import (
    RELEASE_RECORD,
    VERIFICATION,
    Artefact,
    carried_file,
    is_carried,
    is_ours,
    record_file,
)
from slipstitch.dataset.release.splits import PREFIX, parts, split_columns
from slipstitch.design.grid import films, simulations, textures, viewpoints
from slipstitch.design.interpolation import filmed_friction, interpolations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.fabric import fabric_digest

_STAGE_TOLERANCE_M = 1e-9


def check_lineage(
    contents: Contents, shards: Mapping[str, Shard]
) -> tuple[list[Finding], list[str]]:
    """Follow every clip.

    Parameters
    ----------
    contents : Contents
    shards : mapping
        What `slipstitch.dataset.audit.files.check_files` read.

    Returns
    -------
    findings : list of Finding
        All of kind BROKEN.
    notes : list of str
        Comparisons that could not be made, and why.
    """
    if not contents.rows:
        return [Finding(Kind.BROKEN, MANIFEST, "no clip can be traced without it")], []
    lineage = Lineage(contents)
    findings = [
        *_links(lineage),
        *_configuration(lineage),
        *_sampled(lineage),
        *_release_record(contents),
    ]
    notes = []
    if contents.config is not None:
        from slipstitch.dataset.audit.judged import check_judged  # and with it the theory: SciPy

        stale = sorted({artefact.stage for artefact in _ours(lineage) if _is_stale(artefact)})
        if stale:
            notes.append(
                "seeds, perturbations, stage positions, labels and splits are checked with code "
                f"that has changed since ({', '.join(stale)})"
            )
        findings += _recomputed(lineage, contents.config, shards, stale)
        findings += check_recorded(lineage, contents.config, set(stale))
        findings += check_judged(contents, contents.config, shards, set(stale))
    return findings, notes


def _ours(lineage: Lineage) -> Iterator[Artefact]:
    return (
        artefact
        for path, artefact in lineage.artefacts.items()
        if is_ours(path) and artefact.provenance
    )


def _is_stale(artefact: Artefact) -> bool:
    made_by = artefact.record.get("code_digest")
    now = current_digest(artefact.stage, None, artefact.versions)
    return made_by != now or bool(catalogue_changes(artefact))


def _links(lineage: Lineage) -> Iterator[Finding]:
    """Records that are missing, or about other files than what was made from them says."""
    folder = lineage.contents.folder
    starts = {path for row in lineage.contents.rows for path in lineage.behind(row)}
    starts |= {SAMPLED_MANIFEST} | ({VERIFICATION} & set(lineage.artefacts))
    for path in sorted(starts):
        artefact = lineage.artefacts.get(path)
        where, clips = record_file(path), lineage.clips(path)
        if artefact is None:
            yield Finding(Kind.BROKEN, where, f"no readable record of {path}", clips)
            continue
        if is_ours(path) and artefact.provenance is None:
            yield Finding(Kind.BROKEN, where, "does not state its origin", clips)
        if is_carried(artefact):
            carried = folder / carried_file(path)
            if carried.is_file() and file_digest(carried) != artefact.sha256:
                what = f"not the file described by {record_file(path)}"
                yield Finding(Kind.BROKEN, carried_file(path), what, clips)
        for name, digest in artefact.inputs.items():
            behind = lineage.artefacts.get(name)
            if behind is not None and behind.sha256 != digest:
                what = f"was made from a {name} other than the one described by {record_file(name)}"
                touched = min(lineage.clips(name), clips, key=len)
                yield Finding(Kind.BROKEN, where, what, touched)
    listed = (
        lineage.artefacts[SAMPLED_MANIFEST].inputs if SAMPLED_MANIFEST in lineage.artefacts else {}
    )
    for row in lineage.contents.rows:
        if f"results/sample/{row['sampled_file']}" not in listed:
            what = f"the manifest was not made from {row['sampled_file']}"
            yield Finding(Kind.BROKEN, record_file(SAMPLED_MANIFEST), what, (row["video"],))
    for path in sorted(set(lineage.artefacts) - starts):
        yield Finding(
            Kind.BROKEN, record_file(path), "no clip depends on the file that it describes"
        )


def _configuration(lineage: Lineage) -> Iterator[Finding]:
    """Records against the configuration and the sources that the release carries."""
    contents = lineage.contents
    sources = contents.folder / SOURCES
    for artefact in _ours(lineage):
        where, clips = record_file(artefact.path), lineage.clips(artefact.path)
        changes = (
            config_changes(artefact, contents.config, contents.calibrated)
            if contents.config
            else []
        )
        if changes:
            what = f"made with a configuration that differs from records/config.json: {changes[0]}"
            yield Finding(Kind.BROKEN, where, what, clips)
        digest = artefact.record.get("code_digest")
        versions = artefact.versions
        if sources.is_dir() and digest != current_digest(artefact.stage, sources, versions):
            what = f"its code digest is not that of {artefact.stage} in code/src at its versions"
            yield Finding(Kind.BROKEN, where, what, clips)
        for name, digest in recorded_entries(artefact).get("fabrics", {}).items():
            if sources.is_dir() and digest != _carried_fabric(sources, name):
                what = f"was made with a fabric {name} that differs from code/src"
                yield Finding(Kind.BROKEN, where, what, clips)


def _carried_fabric(sources: Path, name: str) -> str | None:
    """Digest of a fabric as the release's own sources have it; None if they do not."""
    try:
        return fabric_digest(name, sources / "slipstitch/config" / FABRICS_FILE.name)
    except BadInput:
        return None


def _sampled(lineage: Lineage) -> Iterator[Finding]:
    """The manifest against the digest that the sampling stage noted of its rows."""
    contents = lineage.contents
    record = lineage.artefacts.get(SAMPLED_MANIFEST)
    try:
        digest = dataset_digest(sampled_rows(contents.rows, contents.notes["sampled_columns"]))
    except (KeyError, TypeError):
        digest = None
    if record is not None and digest != record.metadata.get("dataset_digest"):
        what = "labels, splits or pixel digests differ from those of the sampling stage"
        yield Finding(Kind.BROKEN, MANIFEST, f"{what} ({record_file(SAMPLED_MANIFEST)})")
    if dataset_digest(contents.rows) != contents.notes.get("dataset_digest"):
        yield Finding(Kind.BROKEN, MANIFEST, "its rows do not match their digest")


def _release_record(contents: Contents) -> Iterator[Finding]:
    """The release's own record against SHA256SUMS, configuration and carried sources."""
    stated = contents.release.get("files", {})
    if contents.release:
        digest = contents.release["provenance"].get("code_digest")
        sources = contents.folder / SOURCES
        if sources.is_dir() and digest != current_digest("release", sources):
            what = "its code digest differs from that of release in code/src"
            yield Finding(Kind.BROKEN, RELEASE_RECORD, what)
        for name in sorted(set(stated) - set(contents.sums)):
            yield Finding(
                Kind.BROKEN, name, "listed in records/release.json, but not in SHA256SUMS"
            )
        for name in sorted(set(contents.sums) - set(stated) - {RELEASE_RECORD}):
            yield Finding(
                Kind.BROKEN, name, "listed in SHA256SUMS, but not in records/release.json"
            )


def _recomputed(
    lineage: Lineage, config: Config, shards: Mapping[str, Shard], stale: Collection[str]
) -> Iterator[Finding]:
    """Everything determined by configuration and seed, recomputed by unchanged code."""
    contents = lineage.contents
    expected = _labels(config)
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    times_s = frames / config.simulation.frame_rate_hz
    x_m, _ = StagePath(**dict(config.simulation.stage)).position_m(times_s)
    for row in contents.rows:
        video = row["video"]
        if video not in expected:
            yield Finding(Kind.BROKEN, MANIFEST, f"{video}: not in the configured grid", (video,))
            continue
        for name, value in expected[video].items():
            if row.get(name) != value:
                what = f"{name} is {row.get(name)!r}, the configuration gives {value!r}"
                yield Finding(Kind.BROKEN, MANIFEST, f"{video}: {what}", (video,))
        shard = shards.get(row["shard"])
        columns = shard.columns.get(video) if shard else None
        problem = _times(columns, frames, times_s, x_m) if columns else None
        if problem:
            yield Finding(Kind.BROKEN, row["shard"], f"{video}: {problem}", (video,))
        if not lineage.of_stage(row, "render") or not lineage.of_stage(row, "simulate"):
            what = f"{video}: its rendering or simulation is missing"
            yield Finding(Kind.BROKEN, MANIFEST, what, (video,))
        for record in lineage.of_stage(row, "render"):
            pose = record.metadata.get("pose")
            if pose != {n[5:]: value for n, value in row.items() if n.startswith("pose_")}:
                what = f"{video}: its pose is not the one its images were rendered from"
                yield Finding(Kind.BROKEN, MANIFEST, what, (video,))
        if "render" not in stale:
            yield from _drawn(config, row)
    missing = sorted(set(expected) - set(contents.clips))
    if missing:
        what = f"the clip {missing[0]} of the grid is missing ({len(missing)} are missing)"
        yield Finding(Kind.BROKEN, MANIFEST, what)
    if "sample" not in stale:
        yield from _sides(contents, config)


def _labels(config: Config) -> dict[str, dict[str, Any]]:
    """Video -> its labels, as far as the grid gives them."""
    calibrated = VIEWPOINTS["calibrated"].azimuth_deg
    shown, between = films(config), interpolations(config)
    return {
        f"{simulation.id}_{texture['id']}_{view['id']}": {
            "simulation": simulation.id,
            **{
                key: value for key, value in asdict(simulation).items() if key not in ("id", "seed")
            },
            "friction": filmed_friction(simulation, between.get((simulation.id, view["id"]))),
            "interpolated": (simulation.id, view["id"]) in between,
            **{f"texture{part}": texture[key] for part, key in _PARTS.items()},
            **{f"viewpoint{part}": view[key] for part, key in _PARTS.items()},
            "floor_role": view["floor_role"],
            "viewpoint_turn_deg": VIEWPOINTS[view["name"]].azimuth_deg - calibrated,
            "frames": config.sample.frames_kept,
            "pixels": config.render.pixels,
            f"{SAMPLED}file": f"{simulation.id}.parquet",
        }
        for simulation in simulations(config)
        for texture in textures(config)
        for view in viewpoints(config)
        if texture["id"] in shown.get((simulation.id, view["id"]), ())
    }


_PARTS = {"": "name", "_id": "id", "_role": "role"}


def _times(
    columns: Mapping[str, list], frames: np.ndarray, times_s: np.ndarray, x_m: np.ndarray
) -> str | None:
    """Errors in frame numbers, times and stage positions of a clip."""
    if columns.get("frame") != frames.tolist():
        return "its frames are not the sampled ones"
    for name, expected in (("time_s", times_s), ("stage_x_m", x_m)):
        found = columns.get(name)
        if found is None:
            continue
        if None in found or np.abs(np.array(found) - expected).max() > _STAGE_TOLERANCE_M:
            return f"{name} differs from the protocol"
    return None


def _drawn(config: Config, row: Mapping[str, Any]) -> Iterator[Finding]:
    """The labels of a clip's floor against what the seed draws."""
    from slipstitch.images.surroundings import draw_surroundings

    drawn = draw_surroundings(config.render, config.seed, row["simulation"], row["viewpoint_id"])
    labels = {
        "floor": drawn.floor,
        "floor_reflectance": drawn.reflectance,
        "floor_roughness": drawn.roughness,
    }
    for name, value in labels.items():
        if row.get(name) != value:
            what = f"{row['video']}: {name} is {row.get(name)!r}, the seed draws {value!r}"
            yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))


def _sides(contents: Contents, config: Config) -> Iterator[Finding]:
    """Splits, redrawn."""
    try:
        expected = manifest_sides(config)
    except BadInput as error:
        yield Finding(Kind.BROKEN, "records/config.json", f"the splits cannot be drawn: {error}")
        return
    try:
        sampled = sampled_rows(contents.rows, contents.notes.get("sampled_columns") or [])
    except (KeyError, TypeError):  # said above: its rows have another digest
        return
    for row in sampled:
        found = row.get("split_by_video"), row.get("split_by_simulation")
        if row["video"] in expected and found != expected[row["video"]]:
            what = f"{row['video']}: its sides are {found}, redrawn {expected[row['video']]}"
            yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))
    splits = split_columns(sampled, config)
    for name, sides in splits.items():
        yield from _differing(contents.rows, PREFIX + name, sides)
    yield from _differing(contents.rows, "part", parts(splits))


def _differing(rows: Iterable[Mapping[str, Any]], column: str, expected: list) -> Iterator[Finding]:
    for row, value in zip(rows, expected, strict=True):
        if row.get(column) != value:
            what = f"{row['video']}: {column} is {row.get(column)!r}, redrawn {value!r}"
            yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))
