"""Tracing every clip to its origin, and recomputing its labels.

Records are compared with each other: what a file was made from must be the file that the next
record is about. Labels, times, stage positions and splits follow from configuration and seed, and
are recomputed. Both find what went wrong or was changed carelessly; only a signature finds a
release whose records were all rewritten to agree.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest
from slipstitch.config import Config
from slipstitch.config.catalogue import FABRICS_FILE
from slipstitch.dataset.audit.contents import SAMPLED_MANIFEST, Contents, Lineage
from slipstitch.dataset.audit.files import Shard
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.manifest import dataset_digest, video_labels
from slipstitch.dataset.release.currency import (
    PACKAGE_SOURCES,
    SOURCES,
    catalogue_changes,
    config_changes,
    current_digest,
    recorded_entries,
)
from slipstitch.dataset.release.manifest import MANIFEST, PREFIX, parts, sampled_rows, split_columns
from slipstitch.dataset.release.records import (
    RELEASE_RECORD,
    VERIFICATION,
    Artefact,
    carried_file,
    is_carried,
    is_ours,
    record_file,
)
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.fabric import fabric_digest

_STAGE_TOLERANCE_M = 1e-9


def check_lineage(
    contents: Contents, shards: Mapping[str, Shard]
) -> tuple[list[Finding], list[str]]:
    """Follow every clip.

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
    findings = [*_links(lineage), *_sampled(lineage), *_release_record(contents)]
    notes = []
    sources = contents.folder / SOURCES
    if (contents.folder / PACKAGE_SOURCES / "dataset").is_dir():
        findings += _sources(lineage, sources)
    elif sources.is_dir():
        notes.append("code/src is of an older version of Slipstitch: code digests not compared")
    if contents.config is not None:
        findings += _configuration(lineage, contents.config)
        stale = sorted({artefact.stage for artefact in _ours(lineage) if _is_stale(artefact)})
        if stale:
            notes.append(
                "labels, times, stage positions and splits are checked with code that has changed "
                f"since ({', '.join(stale)})"
            )
        findings += _recomputed(lineage, contents.config, shards, stale)
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
    manifest = lineage.artefacts.get(SAMPLED_MANIFEST)
    for row in lineage.contents.rows:
        if manifest and f"results/sample/{row['sampled_file']}" not in manifest.inputs:
            what = f"the manifest was not made from {row['sampled_file']}"
            yield Finding(Kind.BROKEN, record_file(SAMPLED_MANIFEST), what, (row["video"],))
        stages = {one.stage for one in map(lineage.artefacts.get, lineage.behind(row)) if one}
        if not {"simulate", "render"} <= stages:
            what = f"{row['video']}: its rendering or simulation is missing"
            yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))
    for path in sorted(set(lineage.artefacts) - starts):
        what = "no clip depends on the file that it describes"
        yield Finding(Kind.BROKEN, record_file(path), what)


def _configuration(lineage: Lineage, config: Config) -> Iterator[Finding]:
    """Records against the configuration that the release carries."""
    for artefact in _ours(lineage):
        if changes := config_changes(artefact, config, lineage.contents.calibrated):
            what = f"made with a configuration that differs from records/config.json: {changes[0]}"
            clips = lineage.clips(artefact.path)
            yield Finding(Kind.BROKEN, record_file(artefact.path), what, clips)


def _sources(lineage: Lineage, sources: Path) -> Iterator[Finding]:
    """Records against the sources that the release carries."""
    for artefact in _ours(lineage):
        where, clips = record_file(artefact.path), lineage.clips(artefact.path)
        digest = artefact.record.get("code_digest")
        if digest != current_digest(artefact.stage, sources, artefact.versions):
            what = f"its code digest is not that of {artefact.stage} in code/src at its versions"
            yield Finding(Kind.BROKEN, where, what, clips)
        for name, digest in recorded_entries(artefact).get("fabrics", {}).items():
            if digest != _carried_fabric(sources, name):
                what = f"was made with a fabric {name} that differs from code/src"
                yield Finding(Kind.BROKEN, where, what, clips)
    digest = lineage.contents.release.get("provenance", {}).get("code_digest")
    if lineage.contents.release and digest != current_digest("release", sources):
        what = "its code digest differs from that of release in code/src"
        yield Finding(Kind.BROKEN, RELEASE_RECORD, what)


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
    rows = _sampled_rows(contents)
    noted = record and record.metadata.get("dataset_digest")
    if record is not None and rows and dataset_digest(rows) != noted:
        what = "labels, splits or pixel digests differ from those of the sampling stage"
        yield Finding(Kind.BROKEN, MANIFEST, f"{what} ({record_file(SAMPLED_MANIFEST)})")
    if not rows or dataset_digest(contents.rows) != contents.notes.get("dataset_digest"):
        yield Finding(Kind.BROKEN, MANIFEST, "its rows do not match their digest")


def _sampled_rows(contents: Contents) -> list[dict[str, Any]]:
    """The sampling stage's rows; none where the manifest does not have its columns."""
    try:
        return sampled_rows(contents.rows, contents.notes["sampled_columns"])
    except (KeyError, TypeError):
        return []


def _release_record(contents: Contents) -> Iterator[Finding]:
    """The release's own list of files against SHA256SUMS."""
    stated, sums = set(contents.release.get("files", {})), set(contents.sums) - {RELEASE_RECORD}
    if contents.release:
        for name in sorted(stated ^ sums):
            lists = ("records/release.json", "SHA256SUMS")
            there, lacking = lists if name in stated else lists[::-1]
            yield Finding(Kind.BROKEN, name, f"listed in {there}, but not in {lacking}")


def _recomputed(
    lineage: Lineage, config: Config, shards: Mapping[str, Shard], stale: Collection[str]
) -> Iterator[Finding]:
    """Everything determined by configuration and seed, recomputed."""
    contents = lineage.contents
    try:
        expected = video_labels(config)
    except BadInput as error:
        yield Finding(Kind.BROKEN, "records/config.json", f"the splits cannot be drawn: {error}")
        return
    rows = _sampled_rows(contents)
    for row in rows:
        for name, value in expected.get(row["video"], {}).items():
            if name.startswith(PREFIX) and "sample" in stale:
                continue
            if name in row and row[name] != value:
                what = f"{name} is {row[name]!r}, the configuration gives {value!r}"
                yield Finding(Kind.BROKEN, MANIFEST, f"{row['video']}: {what}", (row["video"],))
    odd = sorted(set(expected) ^ set(contents.clips))
    if odd:
        what = f"{odd[0]}: not in the configured grid"
        if odd[0] in expected:
            what = f"the clip {odd[0]} of the grid is missing ({len(odd)} differ from the grid)"
        yield Finding(Kind.BROKEN, MANIFEST, what, tuple(set(odd) & set(contents.clips)))
    yield from _timed(contents, config, shards)
    for row in contents.rows:
        yield from _rendered(lineage, row)
    if rows and "sample" not in stale:
        splits = split_columns(rows, config)
        for name, sides in splits.items():
            yield from _differing(contents.rows, PREFIX + name, sides)
        yield from _differing(contents.rows, "part", parts(splits))


def _timed(contents: Contents, config: Config, shards: Mapping[str, Shard]) -> Iterator[Finding]:
    """Errors in frame numbers, times and stage positions of the clips' images."""
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    times_s = frames / config.simulation.frame_rate_hz
    x_m, _ = StagePath(**dict(config.simulation.stage)).position_m(times_s)
    protocol = {"frame": frames, "time_s": times_s, "stage_x_m": x_m}
    for row in contents.rows:
        shard = shards.get(row["shard"])
        columns = (shard and shard.columns.get(row["video"])) or {}
        for name, values in protocol.items() if columns else ():
            found = np.array(columns.get(name), np.float64)
            same = found.shape == values.shape
            if not same or not (np.abs(found - values) <= _STAGE_TOLERANCE_M).all():
                what = f"{row['video']}: {name} differs from the protocol"
                yield Finding(Kind.BROKEN, row["shard"], what, (row["video"],))


def _rendered(lineage: Lineage, row: Mapping[str, Any]) -> Iterator[Finding]:
    """A clip's pose and floor against what its images were rendered with."""
    for record in lineage.of_stage(row, "render"):
        pose, floor = record.metadata.get("pose"), record.metadata.get("surroundings")
        told = {f"pose_{name}": value for name, value in (pose or {}).items()}
        if isinstance(floor, Mapping):
            told["floor"] = floor.get("floor")
            told |= {f"floor_{name}": floor.get(name) for name in ("reflectance", "roughness")}
        for name, value in told.items():
            if row.get(name) != value:
                what = f"{row['video']}: {name} is {row.get(name)!r}, rendered with {value!r}"
                yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))


def _differing(rows: Iterable[Mapping[str, Any]], column: str, expected: list) -> Iterator[Finding]:
    for row, value in zip(rows, expected, strict=True):
        if row.get(column) != value:
            what = f"{row['video']}: {column} is {row.get(column)!r}, redrawn {value!r}"
            yield Finding(Kind.BROKEN, MANIFEST, what, (row["video"],))
