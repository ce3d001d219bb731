"""Tables filled in by users: every cell is checked, errors are reported in one line."""

import difflib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import shortened
from slipstitch.base.progress import note
from slipstitch.base.tables import as_number, read_cells

_LARGEST_BYTES = 20_000_000
_LONGEST_NAME = 80
#: What a spreadsheet takes for a formula when it opens the file.
FORMULA = ("=", "+", "@", "\t", "\r")


@dataclass(frozen=True)
class TableColumn:
    """A column of a table."""

    name: str
    # A cell's text -> its value; raises ValueError saying what is allowed
    read: Callable[[str], Any]
    needed: bool = True  # whether the table must have it
    may_be_empty: bool = False  # whether single cells may be empty: their value is None


def name(cell: str) -> str:
    """A name: printable, not long."""
    if len(cell) > _LONGEST_NAME or not cell.isprintable():
        raise ValueError(f"must be a printable name of at most {_LONGEST_NAME} characters")
    return cell


def number(
    low: float = -math.inf, high: float = math.inf, open_ends: bool = False
) -> Callable[[str], float]:
    """Reader of numbers between two bounds, which belong to the range unless `open_ends`."""
    allowed = "must be a number"
    if math.isfinite(low):
        allowed += f" {'above' if open_ends else 'from'} {low:g}"
    if math.isfinite(high):
        allowed += f" {'and below' if open_ends else 'to'} {high:g}"

    def read(cell: str) -> float:
        try:
            value = as_number(cell)
        except ValueError:
            raise ValueError(allowed) from None
        inside = low < value < high if open_ends else low <= value <= high
        if not (math.isfinite(value) and inside):
            raise ValueError(allowed)
        return value

    return read


def whole_number(high: int) -> Callable[[str], int]:
    """Reader of whole numbers from 0 to `high`."""

    def read(cell: str) -> int:
        if not (cell.isascii() and cell.isdigit() and len(cell) < 10 and int(cell) <= high):
            raise ValueError(f"must be a whole number from 0 to {high}")
        return int(cell)

    return read


def yes_or_no(cell: str) -> bool:
    """yes or no."""
    if cell.lower() not in ("yes", "no"):
        raise ValueError("must be yes or no")
    return cell.lower() == "yes"


def file_below(folder: str | Path) -> Callable[[str], Path]:
    """Reader of names of files in a folder, or below; no path leads out of it."""

    def read(cell: str) -> Path:
        path = Path(cell)
        if path.is_absolute() or ".." in path.parts or not cell.isprintable():
            raise ValueError(f"must be a path below {folder}, without ..")
        whole = Path(folder) / path
        if not whole.is_file():
            raise ValueError(f"no such file below {folder}")
        if not whole.resolve().is_relative_to(Path(folder).resolve()):
            raise ValueError(f"must not be a link to outside {folder}")
        return whole

    return read


def read_table(path: str | Path, columns: Sequence[TableColumn]) -> list[dict[str, Any]]:
    """Read the rows of a CSV file that may have these columns, in whichever dialect it is written.

    Column -> value; ``line`` is the row's number in the file. A column that is not there is
    None in all rows. BadInput if the file is missing, not CSV, lacks a column or has another,
    or a cell cannot be read or begins like a formula.
    """
    known = {column.name: column for column in columns}
    table = read_cells(path, known, _LARGEST_BYTES)
    for cell in table.header:
        if cell not in known:
            close = difflib.get_close_matches(cell, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
            raise BadInput(f"{path}: unknown column {cell[:40]!r}; {hint}")
    for column in columns:
        if column.needed and column.name not in table.header:
            raise BadInput(
                f"{path}: no column {column.name!r}; required: "
                f"{', '.join(known.name for known in columns if known.needed)}"
            )
    read = []
    for line, cells in zip(table.lines, table.rows, strict=True):
        row: dict[str, Any] = dict.fromkeys(known)
        for title, cell in zip(table.header, cells, strict=True):
            row[title] = _value(known[title], cell.strip(" "), f"{path} line {line}, {title}")
        read.append({"line": line, **row})
    if not read:
        raise BadInput(f"{path}: contains no rows")
    note(*table.notes)
    return read


def _value(column: TableColumn, cell: str, where: str) -> Any:
    if not cell:
        if column.may_be_empty:
            return None
        raise BadInput(f"{where}: empty")
    shown = shortened(cell, 60)
    if cell.startswith(FORMULA):
        raise BadInput(f"{where}: {shown!r} looks like a formula; must be a plain value")
    try:
        return column.read(cell)
    except ValueError as problem:
        raise BadInput(f"{where}: {shown!r}; {problem}") from None
