"""A testing machine's export as the trace of a case."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.base.errors import BadInput
from slipstitch.base.progress import note
from slipstitch.base.provenance import provenance_record, start_clock, write_text
from slipstitch.base.tables import NUMBER, as_number, read_cells, unit_of
from slipstitch.physics import GRAVITY_M_S2

# What may be read, the column of a trace, and what a unit is worth there.
_FORCES = {
    "mN": 1.0,
    "N": 1e3,
    "kN": 1e6,
    "cN": 10.0,
    "gf": GRAVITY_M_S2,
    "kgf": 1e3 * GRAVITY_M_S2,
    "lbf": 4448.2216,
}
_LENGTHS = {"mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1e3, "in": 25.4}
QUANTITIES = {
    "time": ("t_s", {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}),
    "extension": ("x_stage_mm", _LENGTHS),
    "force": ("force_mN", _FORCES),
    "force_x": ("force_x_mN", _FORCES),
    "force_y": ("force_y_mN", _FORCES),
}
USUAL_UNITS = {"time": "s", "extension": "mm"}
BYTES_MAX = 512 * 2**20


def import_trace(path: Path, columns: Mapping[str, str], units: tuple[str, ...], out: Path) -> str:
    """Write the trace of one run from a testing machine's export, and say what was read.

    Title lines, a row of units, quotation marks, separators and decimal marks are found by
    themselves. With an extension, strokes are told by its furthest point.

    Parameters
    ----------
    columns : of :data:`QUANTITIES` to the names of columns in the file.
    units : of the force, and of time and extension where they are not s and mm.
    out : CSV, for a case's folder of traces.

    Raises
    ------
    BadInput
        If a column or the unit of the force is missing, or the file says another unit.
    """
    started = start_clock()
    _check_names(columns, units)
    table = read_cells(path, columns.values(), BYTES_MAX)
    rows, said = list(table.rows), dict(zip(table.header, table.units, strict=True))
    for name in columns.values():
        if name not in table.header:
            raise BadInput(f"{path}: no column {name!r}; there are: {', '.join(table.header)}")
    places = {quantity: table.header.index(name) for quantity, name in columns.items()}
    lines = table.lines
    if rows and not any(NUMBER.fullmatch(rows[0][place].strip()) for place in places.values()):
        said = dict(zip(table.header, map(unit_of, rows[0]), strict=True))
        rows, lines = rows[1:], lines[1:]
    if not rows:
        raise BadInput(f"{path}: no rows below the names of the columns")
    trace = {}
    for quantity, place in places.items():
        column, worth = QUANTITIES[quantity]
        unit = _unit(path, quantity, said.get(columns[quantity], ""), units)
        trace[column] = worth[unit] * _numbers(path, columns[quantity], place, rows, lines)
    notes = list(_of_clock(path, np.diff(trace.get("t_s", np.zeros(0)))))
    content = _with_strokes(pd.DataFrame(trace))
    record = provenance_record("capture", inputs=[path], started=started)
    write_text(out, content.to_csv(index=False, float_format="%.9g"), record)
    note(*table.notes, *notes)
    return f"{len(content)} readings of {', '.join(columns)}"


def _of_clock(path: Path, steps_s: np.ndarray) -> Iterator[str]:
    """What a clock leaves open, a line each; `criticise` reads the parts and says what it did."""
    back, equal = int((steps_s < 0).sum()), int((steps_s == 0).sum())
    if back:
        yield f"{path}: its clock steps back {back} time(s), as where parts were joined"
    if equal:
        yield f"{path}: {equal} of {len(steps_s) + 1} readings are at the time of the one before"


def _check_names(columns: Mapping[str, str], units: tuple[str, ...]) -> None:
    for name in columns:
        if name not in QUANTITIES:
            raise BadInput(f"--columns: {name}: unknown; known: {', '.join(QUANTITIES)}")
    if not any(name.startswith("force") for name in columns) or not {"time", "extension"} & set(
        columns
    ):
        raise BadInput("--columns: a force and a time (or an extension) are needed")
    known = {unit for _, worth in QUANTITIES.values() for unit in worth}
    for unit in units:
        if unit not in known:
            raise BadInput(f"--units: {unit}: unknown; known: {', '.join(sorted(known))}")


def _unit(path: Path, quantity: str, said: str, units: tuple[str, ...]) -> str:
    worth = QUANTITIES[quantity][1]
    given = next((unit for unit in units if unit in worth), None)
    if said in worth and given not in (None, said):
        raise BadInput(f"{path}: {quantity} in {said} by its row of units, not in {given}")
    unit = given or (said if said in worth else USUAL_UNITS.get(quantity))
    if unit is None:
        raise BadInput(f"{path}: --units: the unit of {quantity} is needed: {', '.join(worth)}")
    return unit


def _numbers(path: Path, name: str, place: int, rows: list, lines: list[int]) -> np.ndarray:
    values = np.empty(len(rows))
    for i, (line, cells) in enumerate(zip(lines, rows, strict=True)):
        try:
            values[i] = as_number(cells[place])
        except ValueError as problem:
            raise BadInput(f"{path} line {line}, {name}: {cells[place]!r}; {problem}") from None
    return values


def _with_strokes(trace: pd.DataFrame) -> pd.DataFrame:
    """A trace with the columns that a drag has, if it has an extension."""
    if "x_stage_mm" not in trace:
        return trace
    way = (trace["x_stage_mm"] - trace["x_stage_mm"].iloc[0]).to_numpy()
    furthest = int(np.argmax(np.abs(way)))
    trace.insert(0, "stroke", (np.arange(len(trace)) > furthest).astype(int))
    if "t_s" not in trace:
        trace["t_s"] = np.nan
    trace["v_mm_s"] = np.nan
    return trace
