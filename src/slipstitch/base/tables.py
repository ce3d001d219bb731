"""Tables as spreadsheets and instruments write them: one reader of every dialect.

Read is what can mean one thing only, and a note says what was assumed; what is ambiguous is refused
in one line that says how to export it.
"""

import csv
import io
import os
import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipstitch.base.errors import BadInput

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
# No cloth slips at a lesser slope; a right angle is 1.57 rad.
SMALLEST_SLIP_ANGLE_DEG = 2.0
_TITLE_LINES = 40  # before the names, at most
_EXPORT = "export as CSV in UTF-8, with decimal points and a separator that stands in no cell"
# What stands in a row of units, as names of columns end.
_UNIT_WORDS = (
    "deg rad pct s ms min h Hz g kg mg mm cm m um cm2 mm2 m2 mm_s m_s cm_s mm_min N mN kN cN gf "
    "kgf lbf N_m N_mm kg_m2 g_m2 1"
)
UNITS = frozenset(_UNIT_WORDS.split())


class Cells(NamedTuple):
    """The cells of a table as text, without what is empty."""

    header: list[str]
    rows: list[list[str]]
    lines: list[int]  # number of each row's line in the file
    units: list[str]  # of each column, '' where no row of units says any
    notes: tuple[str, ...] = ()  # what was assumed


def as_number(text: str) -> float:
    """Return a number that is written as people write numbers; ValueError for anything else."""
    if not NUMBER.fullmatch(text.strip()):
        raise ValueError("must be a number")
    return float(text)


def read_cells(path: str | os.PathLike, known: Collection[str], most_bytes: float) -> Cells:
    """Read a table in whichever dialect it is written; BadInput if it may be read in two ways.

    `known` names columns that it may have: they tell the header from titles, and the separator.
    """
    text, notes = _decoded(path, most_bytes)
    separator, start, first = _separator(text, known)
    if separator != ",":
        notes.append(f"read with {_SEPARATORS.get(separator, separator)} between cells")
    raw = _split(path, text[start:], separator, text.count("\n", 0, start))
    if first:
        notes.append(f"left out {first} line(s) above the names of the columns")
    if len(raw) <= first:
        raise BadInput(f"{path}: empty; must begin with a line of column names")
    header, rows = [cell.strip() for cell in raw[first][1]], raw[first + 1 :]
    header, rows = _without_unnamed(path, header, rows, separator)
    repeated = next((name for name in header if header.count(name) > 1), None)
    if repeated is not None:
        raise BadInput(f"{path}: column {repeated}: given twice")
    units = [""] * len(header)
    if rows and (found := _units(path, header, *rows[0])):
        notes.append(f"line {rows[0][0]}: a row of units, not of values")
        units, rows = found, rows[1:]
    body = [cells for _, cells in rows]
    if _decimal_commas(path, body, separator):
        notes.append("read with decimal commas")
        numbers = _COMMA_NUMBER.fullmatch
        body = [[c.replace(",", ".") if numbers(c.strip()) else c for c in cells] for cells in body]
    lines = [line for line, _ in rows]
    return Cells(header, body, lines, units, tuple(f"{path}: {note}" for note in notes))


def _decoded(path: str | os.PathLike, most_bytes: float) -> tuple[str, list[str]]:
    path = Path(path)
    if path.exists() and not path.is_file():
        raise BadInput(f"{path}: not a file; a pipe, a device or a folder is not read")
    try:
        if path.stat().st_size > most_bytes:
            raise BadInput(f"{path}: larger than {most_bytes / 2**20:.4g} MiB, which is not read")
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    encoding = next((e for mark, e in _BYTE_ORDER_MARKS.items() if content.startswith(mark)), None)
    if encoding != "utf-16" and b"\0" in content:
        raise BadInput(f"{path}: holds NUL bytes; text in UTF-8 is needed")
    try:
        return content.decode(encoding or "utf-8"), []
    except UnicodeDecodeError:
        pass
    # Western spreadsheets write Windows-1252, of which Latin-1's letters are a part.
    text = content.decode("cp1252", errors="replace")
    foreign = [character for character in text if not character.isascii()]
    words = all(character.isalpha() or character in "°µ²³±·§–€" for character in foreign)
    if encoding or not words or len(foreign) > 0.2 * len(text):
        raise BadInput(f"{path}: the encoding is not UTF-8; {_EXPORT}")
    return text, ["not in UTF-8: read as Windows-1252 (Latin-1)"]


def _separator(text: str, known: Collection[str]) -> tuple[str, int, int]:
    """Separator, where the table starts in the text, and how many of its lines are titles."""
    declared = re.match(r"\ufeff?\"?sep=(.)\"?\r?\n", text)
    if declared:
        text = text[declared.end() :]
    lines = [line for line in text[:100_000].splitlines() if line.strip(' \t,;|"')]
    best = (0, 0, 0, ",")
    for separator in declared[1] if declared else _SEPARATORS:
        for i, line in enumerate(lines[:_TITLE_LINES]):
            names = [cell.strip().strip('"') for cell in line.split(separator)]
            found = len(set(names) & set(known))
            if (found, -i, len(names)) > best[:3] and (found or not i):
                best = (found, -i, len(names), separator)
    return best[3], declared.end() if declared else 0, -best[1]


def _split(path, text: str, separator: str, before: int) -> list[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        rows = [(before + reader.line_num, cells) for cells in reader]
    except csv.Error:
        raise BadInput(
            f"{path} line {before + reader.line_num}: not CSV: a quotation mark is not closed or "
            "followed by text, or a cell is endless"
        ) from None
    return [(line, cells) for line, cells in rows if any(cell.strip() for cell in cells)]


def _without_unnamed(path, header: list[str], rows: list, separator: str):
    """Header and rows without columns that have no name, which must be empty."""
    count = len(header)
    kept = [i for i, name in enumerate(header) if name]
    result = []
    for line, cells in rows:
        if len(cells) < count or any(cell.strip() for cell in cells[count:]):
            more = separator == "," and len(cells) > count
            why = f"; commas between cells and in numbers? {_EXPORT}" if more else ""
            raise BadInput(f"{path} line {line}: {len(cells)} cells, the header has {count}{why}")
        if any(cell.strip() for name, cell in zip(header, cells, strict=False) if not name):
            raise BadInput(f"{path} line {line}: a value below no name of a column")
        result.append((line, [cells[i] for i in kept]))
    return [header[i] for i in kept], result


def unit_of(text: str) -> str:
    """Return a unit as names of columns end: mm/s as mm_s, ° as deg; '' for none."""
    unit = text.strip().strip("[]()").strip()
    unit = {"-": "", "°": "deg", "%": "pct", "sec": "s", "µm": "um", "gram": "g"}.get(unit, unit)
    return unit.replace("²", "2").replace("/", "_").replace("·", "_").replace("^", "")


def _units(path, header: list[str], line: int, cells: list[str]) -> list[str]:
    """Units of the columns if a row says them; empty if it does not."""
    units = [unit_of(cell) for cell in cells]
    if not any(units) or any(unit and unit not in UNITS for unit in units):
        return []
    if all(not unit or NUMBER.fullmatch(unit) for unit in units):
        return []
    for name, unit, cell in zip(header, units, cells, strict=True):
        ends = (name[i + 1 :] for i, character in enumerate(name) if character == "_")
        own = next((end for end in ends if end in UNITS), None)
        if unit and own not in (None, unit):
            raise BadInput(f"{path} line {line}: column {name}: in {cell.strip()} by its unit")
    return units


def _decimal_commas(path, body: list[list[str]], separator: str) -> bool:
    """Are the numbers written with decimal commas?"""
    columns = list(zip(*body, strict=True))
    if not any("," in "".join(column) for column in columns):
        return False
    comma, point = None, None
    certain = separator == ";"
    for column in columns:
        commas = [cell.strip() for cell in column if "," in cell]
        points = [cell.strip() for cell in column if "." in cell]
        if not all(map(_COMMA_NUMBER.fullmatch, commas)) or not all(map(NUMBER.fullmatch, points)):
            continue
        comma, point = comma or next(iter(commas), None), point or next(iter(points), None)
        for cell in commas:
            whole, decimals = re.split("[eE]", cell.lstrip("+-"))[0].split(",")
            certain = certain or len(decimals) != 3 or whole in ("", "0")
    if comma is None:
        return False
    if point is not None:
        raise BadInput(f"{path}: decimal commas ({comma}) and decimal points ({point}); {_EXPORT}")
    if not certain:
        raise BadInput(f"{path}: {comma} may have a decimal comma or thousands; {_EXPORT}")
    return True


def in_radians(slip_angles: Iterable[float]) -> bool:
    """Say whether slip angles, stated in degrees, must be radians: none reaches 2."""
    angles = np.abs(np.asarray(list(slip_angles), float))
    return bool(np.isfinite(angles).any() and np.nanmax(angles) < SMALLEST_SLIP_ANGLE_DEG)


def directions_in_radians(directions: Iterable[float]) -> bool:
    """Say whether directions, stated in degrees, must be radians: multiples of 45 degrees."""
    angles = np.abs(np.asarray(list(directions), float))
    turned = angles[np.isfinite(angles) & (angles > 0)]
    if not len(turned) or turned.max() > 2 * np.pi + 0.01:
        return False
    eighths = turned / (np.pi / 4)
    return bool(np.all(np.abs(eighths - np.round(eighths)) < 0.02) and np.all(eighths > 0.9))
