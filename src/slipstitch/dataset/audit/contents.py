"""The contents of a release, read as far as possible; what its clips come from; what is found."""

import contextlib
import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import file_digest, read_metadata
from slipstitch.config import Config, load_config
from slipstitch.config.load import calibrated_settings
from slipstitch.dataset.audit import admission
from slipstitch.dataset.audit.findings import Finding, Kind
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.release import records
from slipstitch.dataset.release.checksums import SUMS, read_sums

FRAMES_MAX = 1_000_000
_TEXTS = ("video", "simulation", "material", "pixels_sha256", "sampled_file", "shard", "part")
NEEDED_COLUMNS = {
    **dict.fromkeys(_TEXTS, pa.string()),
    **{"friction": pa.float64(), "frames": pa.int32(), "first_row": pa.int64()},
}
_OF_AN_INSTRUMENT = (
    "; the chain from the instrument that comes with Slipstitch to its simulations is in "
    "results/published/instrument of the repository: audit that folder"
)


@dataclass
class Contents:
    """A release in a folder, and what is found of it; what cannot be read is empty and a finding.

    `notes` is what the manifest says of itself, `remarks` what is no damage.
    """

    folder: Path
    sums: dict[str, str]
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)
    artefacts: dict[str, records.Artefact] = field(default_factory=dict)
    release: dict[str, Any] = field(default_factory=dict)
    config: Config | None = None
    findings: list[Finding] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    _chains: dict[tuple[str, str | None], tuple[str, ...]] = field(default_factory=dict)

    def find(self, kind: Kind, where: str, what: str, clips: Iterable[str] = ()) -> None:
        """Note a finding; arguments as of `Finding`."""
        self.findings.append(Finding(kind, where, what, tuple(clips)))

    def broken(self, where: str, what: str, clips: Iterable[str] = ()) -> None:
        """Note that the chain of the clips is broken."""
        self.find(Kind.BROKEN, where, what, clips)

    @cached_property
    def row_of(self) -> dict[str, dict[str, Any]]:
        """Video -> its row of the manifest."""
        return {row["video"]: row for row in self.rows}

    @cached_property
    def clips(self) -> list[str]:
        """Ids of all videos."""
        return list(self.row_of)

    @cached_property
    def calibrated(self) -> dict[str, dict[str, Any]]:
        """Settings that the calibrations chose, by path; nothing of one that cannot be read."""
        settings: dict[str, dict[str, Any]] = {}
        for path in self.artefacts:
            if records.is_calibration(path):
                with contextlib.suppress(BadInput):
                    settings[path] = calibrated_settings(self.folder / records.carried_file(path))
        return settings

    @property
    def name(self) -> str:
        """Name and version."""
        facts = self.release.get("facts", {})
        return f"{facts.get('name', 'unnamed')} {facts.get('version', '')}".strip()

    @property
    def sums_sha256(self) -> str:
        """SHA-256 of ``SHA256SUMS``."""
        return hashlib.sha256((self.folder / SUMS).read_bytes()).hexdigest()

    def made(self) -> Iterator[records.Artefact]:
        """The artefacts that stages wrote."""
        return (
            one for path, one in self.artefacts.items() if records.is_ours(path) and one.provenance
        )

    def inputs(self, path: str, viewpoint: str | None) -> list[str]:
        """Paths of what `path` was made from, as far as a clip of `viewpoint` is concerned."""
        artefact = self.artefacts.get(path)
        wanted = []
        for name in artefact.inputs if artefact else ():
            behind = self.artefacts.get(name)
            of_view = behind.metadata.get("viewpoint") if behind else None
            shown = of_view.get("id") if isinstance(of_view, dict) else None
            if viewpoint is None or shown in (None, viewpoint):
                wanted.append(name)
        return wanted

    def behind(self, row: Mapping[str, Any]) -> tuple[str, ...]:
        """Artefacts behind a clip, the nearest first; also those that have no record."""
        key = f"results/sample/{row['sampled_file']}", row.get("viewpoint_id")
        if key not in self._chains:
            found = [key[0]]
            for path in found:  # grows
                found += [name for name in self.inputs(path, key[1]) if name not in found]
            self._chains[key] = tuple(found)
        return self._chains[key]

    def of_stage(self, row: Mapping[str, Any], stage: str) -> list[records.Artefact]:
        """Records of one stage behind a clip."""
        found = map(self.artefacts.get, self.behind(row))
        return [one for one in found if one is not None and one.stage == stage]

    @cached_property
    def _clips_of(self) -> dict[str, tuple[str, ...]]:
        """Artefact, or file of the release -> clips that come from it."""
        found: dict[str, list[str]] = defaultdict(list)
        shards: dict[str, list[str]] = defaultdict(list)
        for row in self.rows:
            shards[row["shard"]].append(row["video"])
            for path in self.behind(row):
                found[path].append(row["video"])
        known = {*self.artefacts, *found}
        found |= dict.fromkeys((records.SAMPLED_MANIFEST, records.VERIFICATION), self.clips)
        for path in known:
            found[records.record_file(path)] = found[records.carried_file(path)] = found[path]
        return {path: tuple(clips) for path, clips in (shards | found).items()}

    def clips_of(self, name: str) -> tuple[str, ...]:
        """Clips that come from an artefact, or that a file of the release is about."""
        return self._clips_of.get(name, ())


def read_contents(folder: Path) -> Contents:
    """Read a release; BadInput if the folder is none, or cannot be read without harm."""
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder")
    if os.path.lexists(folder / SUMS):
        admission.check_entries(folder)
        admission.check_nesting(folder)
    contents = Contents(folder, dict(read_sums(folder)))
    readers = {
        MANIFEST: _read_manifest,
        records.RELEASE_RECORD: _read_release,
        records.CONFIG: _read_config,
    }
    for name in readers:
        if name not in contents.sums:
            hint = _OF_AN_INSTRUMENT if "instrument.safetensors" in contents.sums else ""
            raise BadInput(f"{folder}: not a release of Slipstitch: {SUMS} names no {name}{hint}")
    for name in sorted(contents.sums):
        if name.startswith(f"{records.RECORDS}/") and name.endswith(records.RECORD_SUFFIX):
            readers[name] = _read_artefact
    for name, read in readers.items():
        if (folder / name).is_file():  # else the files' own check says so
            _read(contents, name, read)
    return contents


def _read(contents: Contents, name: str, read) -> None:
    """Call `read`; what goes wrong becomes a finding."""
    path = contents.folder / name
    try:
        read(contents, path)
    except BadInput as error:
        # With the digest that is listed it was made so, and not damaged since.
        if isinstance(error, admission.Harmful) and file_digest(path) == contents.sums[name]:
            raise
        contents.broken(name, str(error).removeprefix(f"{contents.folder}/"))
    except RecursionError:
        raise BadInput(f"{path}: nested too deeply; not read") from None
    except admission.UNUSABLE as error:
        contents.broken(name, f"cannot be read: {first_line(error)}")


def _read_manifest(contents: Contents, path: Path) -> None:
    if odd := admission.check_parquet(path, images=False):
        contents.broken(MANIFEST, odd)
    schema = pq.read_schema(path)
    for column, kind in NEEDED_COLUMNS.items():
        if column not in schema.names or schema.field(column).type != kind:
            raise ValueError(f"no column {column!r} of type {kind}")
    contents.notes = read_metadata(schema)
    rows = [row for batch in admission.batches(path) for row in batch.to_pylist()]
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
    artefact = records.read_record(path)
    if records.record_file(artefact.path) != path.relative_to(contents.folder).as_posix():
        raise ValueError(f"the record is of {artefact.path}")
    contents.artefacts[artefact.path] = artefact
