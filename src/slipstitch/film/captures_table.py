"""The table of captures: content and reference friction of each video."""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest
from slipstitch.base.tables import read_cells
from slipstitch.film.csv_table import (
    TableColumn,
    file_below,
    name,
    number,
    read_table,
    whole_number,
    yes_or_no,
)

LARGEST_FRICTION = 10.0
REFERENCE = ("mu_ref", "mu_ref_error")
#: Of a table of references, of which the first four are read.
REFERENCE_COLUMNS = (
    *("material", "substrate", "mu", "error", "standard_error", "position_sd", "bench_error"),
    *("positions", "orientations", "measurements", "position_p", "orientation_p"),
)
#: What a table says of a pair.
LABELS = ("material", "substrate", *REFERENCE)
#: What `slipstitch measure` can be told of a capture.
TOLD = ("clamp_height_mm", "clamp_height_error_mm", "areal_density_g_m2", "bending_length_mm")


@dataclass(frozen=True)
class Capture:
    """One video of one pair of fabric and substrate."""

    id: str  # ``c00_r01``: the pair's number in the table and the repeat
    video: Path
    camera: Path
    material: str
    substrate: str
    repeat: int
    # friction measured by other means, and half the width of its interval; None: not measured
    mu_ref: float | None
    mu_ref_error: float | None
    reflective: bool  # whether the substrate is reflective
    # time in the video at which the stage starts; found in the frames if None
    start_s: float | None = None
    # of the camera, where the file's own times are wrong; None: those are taken
    frame_rate_hz: float | None = None
    surrogate: bool = False  # true for simulated videos, which are never called real
    # what a reading can be told; None: not measured
    clamp_height_mm: float | None = None
    clamp_height_error_mm: float | None = None  # standard deviation
    areal_density_g_m2: float | None = None
    bending_length_mm: float | None = None
    line: int = 0  # of the table

    @property
    def pair(self) -> str:
        """Id of the pair."""
        return self.id.split("_")[0]

    @property
    def labels(self) -> dict[str, Any]:
        """What is said of the pair, by `LABELS`."""
        return {name: getattr(self, name) for name in LABELS}

    @property
    def title(self) -> str:
        """Name of the pair."""
        return f"{self.material} on {self.substrate}"

    @property
    def reference(self) -> str:
        """Friction measured by other means, in words; empty where it was not."""
        return "" if self.mu_ref is None else f"{self.mu_ref:.3f} ± {self.mu_ref_error:.3f}"


def read_references(path: str | Path) -> dict[tuple[str, str], tuple[float, float]]:
    """(material, substrate) -> (mu, error) of what `slipstitch capture reference` wrote as CSV."""
    columns = [TableColumn(title, name) for title in REFERENCE_COLUMNS[:2]]
    friction = number(0, LARGEST_FRICTION)
    columns += [TableColumn(title, friction) for title in REFERENCE_COLUMNS[2:4]]
    columns += [TableColumn(title, number(), False, True) for title in REFERENCE_COLUMNS[4:]]
    found = {}
    for row in read_table(path, columns):
        key = (row["material"], row["substrate"])
        if key in found:
            raise BadInput(f"{path} line {row['line']}: {' on '.join(key)} is duplicated")
        found[key] = (row["mu"], row["error"])
    return found


def read_captures(
    path: str | Path, reference: str | Path | None = None, referenced: bool = True
) -> list[Capture]:
    """The captures of a table, in its order.

    Paths in it are relative to its folder and stay below it. Empty cells of mu_ref and its
    error are filled from `reference`, which `slipstitch capture reference` wrote; they stay empty
    if the captures need not be `referenced`. BadInput if a cell is wrong, a file is missing, a
    repeat or a video is duplicated, or the rows of a pair contradict one another.
    """
    below = file_below(Path(path).parent)
    friction = number(0, LARGEST_FRICTION)
    may_be_empty = reference is not None or not referenced
    rows = read_table(
        path,
        [
            TableColumn("video", below),
            TableColumn("material", name),
            TableColumn("substrate", name),
            TableColumn("repeat", whole_number(99)),
            *(TableColumn(title, friction, referenced, may_be_empty) for title in REFERENCE),
            TableColumn("reflective", yes_or_no),
            TableColumn("camera", below),
            TableColumn("start_s", number(0, 86400), needed=False, may_be_empty=True),
            TableColumn("frame_rate_hz", number(0, 1000, open_ends=True), False, True),
            TableColumn("surrogate", yes_or_no, needed=False),
            *(TableColumn(title, number(0, open_ends=True), False, True) for title in TOLD),
        ],
    )
    known = read_references(reference) if reference else {}
    pairs: dict[tuple[str, str], str] = {}
    captures: list[Capture] = []
    for row in rows:
        key = (row["material"], row["substrate"])
        if referenced or row["mu_ref"] is not None or row["mu_ref_error"] is not None:
            _fill(row, known, path, reference)
        pair = pairs.setdefault(key, f"c{len(pairs):02d}")
        fields = row | {"surrogate": bool(row["surrogate"])}
        captures.append(Capture(id=f"{pair}_r{row['repeat']:02d}", **fields))
    _check_rows(path, captures)
    if len({capture.surrogate for capture in captures}) > 1:
        raise BadInput(f"{path}: must not mix surrogate and real captures")
    return captures


def files_named(path: str | Path) -> list[str]:
    """Videos and camera files of a table that are there; what is wrong, `read_captures` says."""
    try:
        table = read_cells(path, ("video", "camera", "material"), math.inf)
    except BadInput:
        return []
    cells = {
        cell.strip()
        for row in table.rows
        for title, cell in zip(table.header, row, strict=True)
        if title in ("video", "camera")
    }
    named = {str(Path(path).parent / cell) for cell in cells}
    return sorted(file for file in named if os.path.isfile(file))


def _fill(row: dict[str, Any], known, path, reference) -> None:
    where, key = f"{path} line {row['line']}", (row["material"], row["substrate"])
    if (row["mu_ref"] is None) != (row["mu_ref_error"] is None):
        raise BadInput(f"{where}: mu_ref and mu_ref_error must be given together")
    if row["mu_ref"] is None:
        if key not in known:
            raise BadInput(f"{where}, mu_ref: empty, and {reference} has no {' on '.join(key)}")
        row["mu_ref"], row["mu_ref_error"] = known[key]


def _check_rows(path, captures: list[Capture]) -> None:
    """Refuse a repeat or a video given twice, and rows of a pair that contradict one another."""
    seen: dict[Any, int] = {}
    references: dict[str, tuple[int, tuple]] = {}
    for capture in captures:
        line, pair = capture.line, capture.title
        digest = file_digest(capture.video)
        if capture.id in seen:
            raise BadInput(
                f"{path} line {line}: repeat {capture.repeat} of {pair} duplicates line "
                f"{seen[capture.id]}"
            )
        if digest in seen:
            raise BadInput(f"{path} line {line}, video: the same content as in line {seen[digest]}")
        seen[capture.id] = seen[digest] = line
        reference = (capture.mu_ref, capture.mu_ref_error, capture.reflective)
        first, before = references.setdefault(capture.pair, (line, reference))
        if reference != before:
            raise BadInput(
                f"{path} line {line}: {pair} differs in mu_ref, mu_ref_error or reflective from "
                f"line {first}"
            )
