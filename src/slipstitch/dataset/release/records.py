"""The records of all artefacts that a dataset depends on."""

import hashlib
import json
import os
import posixpath
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_metadata, read_parquet, read_provenance
from slipstitch.dataset.manifest import MANIFEST

RECORDS = "records"
#: Where `slipstitch.physics.simulation.simulation_files` looks for the simulations of a release.
SIMULATIONS = "simulations"
SAMPLED_MANIFEST = f"results/sample/{MANIFEST}"
#: Written beside the dataset: a sample of its images against direct renders.
VERIFICATION = "results/render/verification.json"
CONFIG = f"{RECORDS}/config.json"
GRID = f"{RECORDS}/grid.parquet"
RELEASE_RECORD = f"{RECORDS}/release.json"
CROISSANT = "croissant.json"
CRATE = "ro-crate-metadata.json"
RECORD_SUFFIX = ".record.json"
_SIMULATE = "results/simulate/"
_AGAIN = "snakemake --cores 2 sample"
# Of a trajectory: the mesh follows from the settings and would be most of the record.
NOT_RECORDED = ("provenance", "mesh")


@dataclass(frozen=True)
class Artefact:
    """One file that a stage wrote, or a file from outside, as its record tells."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    path: str  # as the records call it, such as ``results/render/m05_f0300_r00_v00.parquet``
    sha256: str  # of the file's bytes
    # Of a Parquet file's rows alone: the same whenever the same rows are made again, while the
    # bytes also hold the times of the job
    rows_sha256: str | None = None
    metadata: dict[str, Any] = field(default_factory=dict)  # what else the file says about itself
    provenance: dict[str, Any] | None = None  # its record; None for a file that no stage wrote

    @property
    def record(self) -> dict[str, Any]:
        """Its record; empty for a file that no stage wrote."""
        return self.provenance or {}

    @property
    def inputs(self) -> dict[str, str]:
        """Path -> SHA-256 of what it was made from, but for data behind an extended model."""
        return {} if self.stage == "criticise" else self.record.get("inputs", {})

    @property
    def versions(self) -> dict[str, str]:
        """Package -> version that it was made with; what is no text is left out."""
        versions = self.record.get("versions")
        found = versions.items() if isinstance(versions, Mapping) else ()
        return {package: version for package, version in found if isinstance(version, str)}

    @property
    def stage(self) -> str:
        """Name of the stage that wrote it; empty if none did."""
        return self.record.get("stage") or ""


def rows_digest(path: str | os.PathLike) -> str:
    """SHA-256 of a Parquet file's rows, whatever its metadata, row groups and compression."""
    table = read_parquet(path).replace_schema_metadata(None)
    sink = hashlib.sha256(table.schema.to_string().encode())
    for column in table.columns:
        # An IPC stream of a freshly combined column does not depend on how the file was chunked.
        chunks = column.chunks or [pa.array([], column.type)]
        batch = pa.record_batch([pa.concat_arrays(chunks)], names=["column"])
        stream = pa.BufferOutputStream()
        with pa.ipc.new_stream(stream, batch.schema) as writer:
            writer.write_batch(batch)
        sink.update(stream.getvalue())
    return sink.hexdigest()


def read_artefact(path: str, place: Path) -> Artefact:
    """The record of the file at `place`, which records call `path`; BadInput if it has none."""
    if not place.is_file():
        raise BadInput(f"{path}: no such file; make it with: {_AGAIN}")
    parquet = place.suffix == ".parquet"
    metadata = read_metadata(place) if parquet else {}
    rows = rows_digest(place) if parquet else None
    try:
        # What a file from outside was made from is not followed: photographs of a board, say.
        provenance = read_provenance(place) if is_ours(path) else None
    except FileNotFoundError:
        raise BadInput(f"{path}: no provenance record; regenerate it with: {_AGAIN}") from None
    kept = {key: value for key, value in metadata.items() if key not in NOT_RECORDED}
    return Artefact(path, file_digest(place), rows, kept, provenance)


def is_ours(path: str) -> bool:
    """Whether a stage of the workflow wrote the file; a camera file, say, comes from outside."""
    return path.startswith("results/")


def recorded_name(configured: str, paths: Iterable[str]) -> str | None:
    """Which of these paths of records, or names, is the file that the configuration names."""
    whole = f"/{posixpath.normpath(configured)}"
    return max((path for path in paths if whole.endswith(f"/{path}")), key=len, default=None)


def locate(path: str, root: Path, outside: Mapping[str, Path]) -> Path:
    """The location of the file called `path` in the records."""
    place = root / path
    return place if place.exists() else outside.get(path, place)


def collect(start: Iterable[str], root: Path, outside: Mapping[str, Path]) -> dict[str, Artefact]:
    """Records of the artefacts `start` and of everything behind them, by path, inputs first.

    `outside` says where files are that are not below `root`; BadInput if one is another one now.
    """
    found: dict[str, Artefact] = {}

    def visit(path: str) -> Artefact:
        if path not in found:
            artefact = read_artefact(path, locate(path, root, outside))
            for name, digest in artefact.inputs.items():
                if visit(name).sha256 != digest:
                    other = f"{name}: not the file that {path} was made from"
                    raise BadInput(f"{other}; update the results with: {_AGAIN}")
            found[path] = artefact
        return found[path]

    for path in start:
        visit(path)
    return found


def carried_file(path: str) -> str:
    """Location of the artefact `path` in a release, if included."""
    if path.startswith(_SIMULATE):
        return f"{SIMULATIONS}/{path.removeprefix(_SIMULATE)}"
    return f"{RECORDS}/{path.removeprefix('results/')}"


def record_file(path: str) -> str:
    """Location of the record of the artefact `path` in a release."""
    return f"{RECORDS}/{path.removeprefix('results/')}{RECORD_SUFFIX}"


def is_carried(artefact: Artefact) -> bool:
    """Whether a release carries the artefact whole: simulations, small text, files from outside."""
    path = artefact.path
    return not is_ours(path) or path.startswith(_SIMULATE) or path.endswith((".json", ".yaml"))


def is_calibration(path: str) -> bool:
    """Whether an artefact is a calibration, whose settings simulations were made with."""
    return path.rpartition("/")[2] == "calibration.json"


def write_record(artefact: Artefact, folder: Path) -> None:
    """Write the record into a release."""
    target = folder / record_file(artefact.path)
    target.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(asdict(artefact), indent=1, sort_keys=True, allow_nan=False)
    target.write_text(text + "\n", encoding="utf-8")


class _Provenance(BaseModel):
    """What every record of a stage has; other entries as they are."""

    stage: str
    inputs: dict[str, Any]
    config: dict[str, Any]
    code_digest: str


_RECORD = TypeAdapter(Artefact)


def read_record(path: Path) -> Artefact:
    """A record of a release; ValueError if it is no record; the message says why."""
    try:
        artefact = _RECORD.validate_python(json.loads(path.read_text(encoding="utf-8")))
        if artefact.provenance is not None:
            _Provenance.model_validate(artefact.provenance)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(map(str, problem["loc"])) or "content"
        raise ValueError(f"not a record: {where}: {problem['msg']}") from None
    return artefact
