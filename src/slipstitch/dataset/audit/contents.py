"""The contents of a release, read as far as possible, and the lineage of its clips."""

import contextlib
import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import file_digest, read_metadata
from slipstitch.config import Config, load_config
from slipstitch.dataset.audit.admission import (
    UNUSABLE,
    Harmful,
    check_entries,
    check_nesting,
    check_parquet,
    short_texts,
    text_columns,
)
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.release.checksums import SUMS, read_sums
from slipstitch.dataset.release.currency import calibrated_by
from slipstitch.dataset.release.manifest import MANIFEST
from slipstitch.dataset.release.records import (
    CONFIG,
    RECORD_SUFFIX,
    RECORDS,
    RELEASE_RECORD,
    VERIFICATION,
    Artefact,
    carried_file,
    read_record,
    record_file,
)

FRAMES_MAX = 1_000_000


@dataclass
class Contents:
    """A release in a folder; what cannot be read is empty here and a finding there."""

    folder: Path
    sums: dict[str, str]
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)
    artefacts: dict[str, Artefact] = field(default_factory=dict)
    release: dict[str, Any] = field(default_factory=dict)
    schema: pa.Schema | None = None
    config: Config | None = None
    findings: list[Finding] = field(default_factory=list)

    @cached_property
    def clips(self) -> list[str]:
        """Ids of all videos."""
        return [row["video"] for row in self.rows]

    @cached_property
    def row_of(self) -> dict[str, dict[str, Any]]:
        """Video -> its row of the manifest."""
        return {row["video"]: row for row in self.rows}

    @cached_property
    def calibrated(self) -> dict[str, dict[str, Any]]:
        """Settings that the calibrations chose, by path; nothing of one that cannot be read."""
        settings: dict[str, dict[str, Any]] = {}
        for path in self.artefacts:
            with contextlib.suppress(BadInput):
                settings |= calibrated_by([path], lambda name: self.folder / carried_file(name))
        return settings

    def as_listed(self, name: str) -> bool:
        """Whether a file has the digest that ``SHA256SUMS`` names: then nobody damaged it."""
        return file_digest(self.folder / name) == self.sums.get(name)

    @property
    def name(self) -> str:
        """Name and version."""
        facts = self.release.get("facts", {})
        return f"{facts.get('name', 'unnamed')} {facts.get('version', '')}".strip()

    @property
    def sums_sha256(self) -> str:
        """SHA-256 of ``SHA256SUMS``."""
        return hashlib.sha256((self.folder / SUMS).read_bytes()).hexdigest()


NEEDED_COLUMNS = {
    "video": pa.string(),
    "simulation": pa.string(),
    "material": pa.string(),
    "friction": pa.float64(),
    "frames": pa.int32(),
    "pixels_sha256": pa.string(),
    "sampled_file": pa.string(),
    "shard": pa.string(),
    "first_row": pa.int64(),
    "part": pa.string(),
}


_OF_AN_INSTRUMENT = (
    "; the chain from the instrument that comes with Slipstitch to its simulations is in "
    "results/published/instrument of the repository: audit that folder"
)


def read_contents(folder: Path) -> Contents:
    """Read a release.

    BadInput if the folder is not there or no release: a foreign folder, one half written, or one
    that cannot be read without harm.
    """
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder")
    if os.path.lexists(folder / SUMS):
        check_entries(folder)
        check_nesting(folder)
    contents = Contents(folder, dict(read_sums(folder)))
    for name in (MANIFEST, RELEASE_RECORD, CONFIG):
        if name not in contents.sums:
            hint = _OF_AN_INSTRUMENT if "instrument.safetensors" in contents.sums else ""
            raise BadInput(f"{folder}: not a release of Slipstitch: {SUMS} names no {name}{hint}")
    _read(contents, MANIFEST, _read_manifest)
    _read(contents, RELEASE_RECORD, _read_release)
    _read(contents, CONFIG, _read_config)
    for name in sorted(contents.sums):
        if name.startswith(f"{RECORDS}/") and name.endswith(RECORD_SUFFIX):
            _read(contents, name, _read_artefact)
    return contents


def _read(contents: Contents, name: str, read) -> None:
    """Call `read`; what goes wrong becomes a finding."""
    if not (contents.folder / name).is_file():
        return  # the files' own check says so
    try:
        read(contents, contents.folder / name)
    except BadInput as error:
        if isinstance(error, Harmful) and contents.as_listed(name):
            raise
        what = str(error).removeprefix(f"{contents.folder}/")
        contents.findings.append(Finding(Kind.BROKEN, name, what))
    except RecursionError:
        raise BadInput(f"{contents.folder / name}: nested too deeply; not read") from None
    except UNUSABLE as error:
        what = f"cannot be read: {first_line(error)}"
        contents.findings.append(Finding(Kind.BROKEN, name, what))


def _read_manifest(contents: Contents, path: Path) -> None:
    odd = check_parquet(path, images=False)
    if odd:
        contents.findings.append(Finding(Kind.BROKEN, MANIFEST, odd))
    schema = pq.read_schema(path)
    for column, kind in NEEDED_COLUMNS.items():
        if column not in schema.names or schema.field(column).type != kind:
            raise ValueError(f"no column {column!r} of type {kind}")
    contents.schema = schema
    contents.notes = read_metadata(schema)
    table = pq.read_table(path, read_dictionary=text_columns(path))
    short_texts(table, path)
    rows = table.to_pylist()
    if any(row[column] is None for row in rows for column in NEEDED_COLUMNS):
        raise ValueError("missing value")
    if any(not 0 < row["frames"] <= FRAMES_MAX for row in rows):
        raise ValueError(f"a video without images, or with more than {FRAMES_MAX}")
    if len({row["video"] for row in rows}) != len(rows):
        raise ValueError("duplicate video")
    contents.rows = rows


def _read_release(contents: Contents, path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    if not all(isinstance(content[key], dict) for key in ("facts", "files", "provenance")):
        raise ValueError("facts, files or provenance is not a mapping")
    contents.release = content


def _read_config(contents: Contents, path: Path) -> None:
    contents.config = load_config(path)


def _read_artefact(contents: Contents, path: Path) -> None:
    artefact = read_record(path)
    name = path.relative_to(contents.folder).as_posix()
    if record_file(artefact.path) != name:
        raise ValueError(f"the record is of {artefact.path}")
    contents.artefacts[artefact.path] = artefact


SAMPLED_MANIFEST = f"results/sample/{MANIFEST}"


class Lineage:
    """The records of a release and what each clip comes from."""

    def __init__(self, contents: Contents):
        self.contents = contents
        self.artefacts = contents.artefacts
        self._behind: dict[tuple[str, str | None], tuple[str, ...]] = {}

    def inputs(self, path: str, viewpoint: str | None) -> list[str]:
        """Paths of what `path` was made from, as far as a clip of `viewpoint` is concerned."""
        artefact = self.artefacts.get(path)
        wanted = []
        for name in artefact.inputs if artefact else ():
            behind = self.artefacts.get(name)
            of_view = behind.metadata.get("viewpoint") if behind else None
            other = isinstance(of_view, dict) and of_view.get("id") not in (None, viewpoint)
            if viewpoint is None or not other:
                wanted.append(name)
        return wanted

    def behind(self, row: Mapping[str, Any]) -> tuple[str, ...]:
        """Artefacts behind a clip, the nearest first; also those that have no record."""
        start = f"results/sample/{row['sampled_file']}"
        key = start, row.get("viewpoint_id")
        if key not in self._behind:
            found: dict[str, None] = {}
            waiting = [start]
            while waiting:
                path = waiting.pop(0)
                if path not in found:
                    found[path] = None
                    waiting += self.inputs(path, key[1])
            self._behind[key] = tuple(found)
        return self._behind[key]

    def of_stage(self, row: Mapping[str, Any], stage: str) -> list[Artefact]:
        """Records of one stage behind a clip."""
        records = (self.artefacts.get(path) for path in self.behind(row))
        return [record for record in records if record is not None and record.stage == stage]

    @cached_property
    def clips_after(self) -> dict[str, tuple[str, ...]]:
        """Artefact -> clips that were made from it."""
        found: dict[str, list[str]] = defaultdict(list)
        for row in self.contents.rows:
            for path in self.behind(row):
                found[path].append(row["video"])
        return {path: tuple(clips) for path, clips in found.items()}

    def clips(self, path: str) -> tuple[str, ...]:
        """Clips that were made from the artefact; manifest and verification concern all."""
        if path in (SAMPLED_MANIFEST, VERIFICATION):
            return tuple(self.contents.clips)
        return self.clips_after.get(path, ())

    @cached_property
    def _carried(self) -> dict[str, str]:
        """Path of an artefact in a release -> the artefact."""
        known = {*self.artefacts, *self.clips_after}
        records = {record_file(path): path for path in known}
        return records | {carried_file(path): path for path in known}

    def clips_of_file(self, name: str) -> tuple[str, ...]:
        """Clips that a file of the release is about: their images, or a record behind them."""
        if artefact := self._carried.get(name):
            return self.clips(artefact)
        return self._in_shard.get(name, ())

    @cached_property
    def _in_shard(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, list[str]] = defaultdict(list)
        for row in self.contents.rows:
            found[row["shard"]].append(row["video"])
        return {shard: tuple(clips) for shard, clips in found.items()}
