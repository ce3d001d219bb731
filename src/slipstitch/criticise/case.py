"""Read a case folder; every fault is one line that names file, row and column."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import read_parquet
from slipstitch.base.tables import read_cells
from slipstitch.criticise.causes import DataFinding
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.protocols.protocol import Column, Protocol
from slipstitch.criticise.traces import prepared

TABLE_BYTES_MAX = 512 * 2**20
ENDINGS = (".csv", ".parquet")


@dataclass(frozen=True)
class Case:
    """One fabric-substrate pair measured in one campaign.

    ``tables`` maps a table's name to its checked rows: numbers as float64 with NaN where a cell
    is empty, text as str with '' where it is. ``files`` are those that were read, ``findings``
    what is wrong with the data, ``notes`` what was assumed of the files, a line each.
    """

    name: str
    meta: dict
    nominal: dict[str, float]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    ignored_files: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    findings: tuple[DataFinding, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def protocols(self) -> tuple[str, ...]:
        """Protocols that have data, in the order of the format."""
        return tuple(name for name, p in PROTOCOLS.items() if set(p.tables) <= set(self.tables))

    @property
    def protocols_of_runs(self) -> tuple[str, ...]:
        """Protocols that have a table of runs, with traces or without."""
        return tuple(name for name, p in PROTOCOLS.items() if p.runs_table in self.tables)


def read_case(folder: Path | str, with_measurements: bool = True) -> Case:
    """Read and check a case: meta.json and at least one protocol's tables, as CSV or Parquet.

    Parameters
    ----------
    with_measurements : False reads run tables only (a design whose outcome is to be predicted):
        traces may be absent and measured values empty.

    Raises
    ------
    BadInput
        For any violation of the format.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such case folder")
    meta = _read_meta(folder / "meta.json")
    read = _Reading(folder, with_measurements, [folder / "meta.json"])
    tables: dict[str, pd.DataFrame] = {}
    for protocol in PROTOCOLS.values():
        tables |= read.protocol(protocol)
    if not tables:
        names = " ".join(f"{table}.csv" for p in PROTOCOLS.values() for table in p.tables)
        raise BadInput(f"{folder}: no table of any protocol; known: {names}")
    _check_declared(folder / "meta.json", meta, tables, with_measurements)
    nominal = _nominal(folder / "meta.json", meta, tables)
    others = sorted(
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in ENDINGS and path not in read.files
    )
    return Case(
        str(meta.get("case") or meta.get("case_id") or folder.resolve().name),
        meta,
        nominal,
        tables,
        tuple(others),
        tuple(read.files),
        tuple(read.findings),
        tuple(read.notes),
    )


@dataclass
class _Reading:
    """Tables of a folder as they are read, with the files, and what was found and assumed."""

    folder: Path
    with_measurements: bool
    files: list[Path]
    findings: list[DataFinding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def protocol(self, protocol: Protocol) -> dict[str, pd.DataFrame]:
        """Tables of a protocol that are there; traces in order and without glitches."""
        folder, found, path = self.folder, {}, self.folder
        for table, columns in protocol.tables.items():
            paths = [p for p in sorted(folder.glob(f"{table}.*")) if p.suffix.lower() in ENDINGS]
            if table != protocol.runs_table and (folder / table).is_dir():  # one file a run
                paths.append(folder / table)
            if len(paths) > 1:
                names = " and ".join(path.name for path in paths)
                raise BadInput(f"{folder}: both {names}; only one is allowed")
            for path in paths:
                found[table] = (self.table if path.suffix else self.traces)(path, columns)
        missing = [table for table in protocol.tables if table not in found]
        if found and missing and (self.with_measurements or missing[0] == protocol.runs_table):
            have, want = ", ".join(f"{t}.csv" for t in found), f"{missing[0]}.csv"
            raise BadInput(
                f"{folder}: {have} without {want}; the {protocol.name} protocol requires both"
            )
        if len(found) == 2:
            _check_traces(folder, *found.items())
            runs, traces = found
            found[traces], findings = prepared(
                protocol.name, found[runs], found[traces], protocol.signals, str(path)
            )
            self.findings += findings
        return found

    def traces(self, path: Path, columns: tuple[Column, ...]) -> pd.DataFrame:
        """The traces of a folder with one file a run, which the file is called after."""
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in ENDINGS)
        if not files:
            raise BadInput(f"{path}: no file; RUN_ID.csv or RUN_ID.parquet for each run is needed")
        columns = tuple(column for column in columns if column.name != "run_id")
        parts = {file.stem: self.table(file, columns) for file in files}
        if len(parts) < len(files):
            raise BadInput(f"{path}: a run as CSV and as Parquet; give one of them")
        names = np.repeat(list(parts), [len(part) for part in parts.values()])
        table = pd.concat(parts.values(), ignore_index=True)
        table.insert(0, "run_id", names.astype(object))
        return table

    def table(self, path: Path, columns: tuple[Column, ...]) -> pd.DataFrame:
        """The checked rows of a file."""
        self.files.append(path)
        raw, lines = self.raw(path, columns)
        if len(raw) == 0:
            raise BadInput(f"{path}: no rows; at least one is required")
        table = {}
        for column in columns:
            measured = column.measured and not self.with_measurements
            if column.name not in raw.columns:
                if measured:
                    continue
                raise BadInput(f"{path}: column {column.name}: missing")
            check = _text_column if column.text else _number_column
            table[column.name] = check(path, column, raw[column.name], lines, measured)
        result = pd.DataFrame(table)
        if "specimen_id" in table:  # one row a trial or run
            again = result["run_id"].duplicated()
            if again.any():
                row = lines[int(np.argmax(again.to_numpy()))]
                name = result["run_id"][again].iloc[0]
                raise BadInput(f"{path}: row {row}: column run_id: '{name}' is duplicated")
        return result

    def raw(self, path: Path, columns: tuple[Column, ...]) -> tuple[pd.DataFrame, np.ndarray]:
        """The unchecked rows of a file, and their lines in it."""
        if path.suffix.lower() == ".csv":
            cells = read_cells(path, [column.name for column in columns], TABLE_BYTES_MAX)
            self.notes += cells.notes
            rows = pd.DataFrame(cells.rows, columns=cells.header, dtype=object)
            return rows, np.array(cells.lines, int)
        _refuse_no_file(path)
        try:
            raw = read_parquet(path).to_pandas(ignore_metadata=True)
        except (OSError, ValueError) as error:
            raise BadInput(f"{path}: cannot be read: {first_line(error)}") from None
        raw.columns = [str(name).strip() for name in raw.columns]
        repeated = raw.columns[raw.columns.duplicated()]
        if len(repeated):
            raise BadInput(f"{path}: column {repeated[0]}: given twice")
        return raw, np.arange(1, len(raw) + 1)


def _check_declared(path: Path, meta: dict, tables: dict, with_measurements: bool) -> None:
    """Refuse protocols of meta.json that are unknown or have no table."""
    declared = meta.get("protocols") or []
    for name in declared if isinstance(declared, list) else []:
        wanted = PROTOCOLS.get(_protocol_name(name))
        if wanted is None:
            raise BadInput(
                f"{path}: protocols: unknown protocol {name!r}; known: {' '.join(PROTOCOLS)}"
            )
        absent = [table for table in wanted.tables if table not in tables]
        if absent and with_measurements:
            raise BadInput(f"{path}: protocols: {name} has no {absent[0]}.csv")


def has_measurements(folder: Path | str) -> bool:
    """Does a case hold measured values, or the run tables of a design alone?"""
    design = read_case(folder, with_measurements=False)
    for name in design.protocols_of_runs:
        protocol = PROTOCOLS[name]
        own = [column.name for column in protocol.tables[protocol.runs_table] if column.measured]
        table = design.tables[protocol.runs_table]
        if len(protocol.tables) > 1 and set(protocol.tables) <= set(design.tables):
            return True
        if own and set(own) <= set(table.columns) and table[own[0]].notna().any():
            return True
    return False


def _protocol_name(text) -> str:
    by_letter = {protocol.letter: name for name, protocol in PROTOCOLS.items()}
    text = str(text).strip().lower().replace("-", "_")
    return by_letter.get(text.strip("()"), text)


def _refuse_no_file(path: Path) -> None:
    """Refuse a pipe, which would be waited for, and what no table is as large as."""
    if not path.is_file():
        raise BadInput(f"{path}: not a file; a pipe, a device or a folder is not read")
    if path.stat().st_size > TABLE_BYTES_MAX:
        raise BadInput(f"{path}: larger than {TABLE_BYTES_MAX // 2**20} MiB, which is not read")


def _read_meta(path: Path) -> dict:
    if not path.exists():
        raise BadInput(f"{path.parent}: no meta.json; a case folder requires one")
    _refuse_no_file(path)
    try:
        meta = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not valid JSON: {error}") from None
    if not isinstance(meta, dict) or not isinstance(meta.get("nominal"), dict):
        raise BadInput(f"{path}: nominal: missing; must be a mapping of the nominal values")
    return meta


def is_number(value: object) -> bool:
    """Whether a value of a JSON file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _nominal(path: Path, meta: dict, tables: dict) -> dict[str, float]:
    given = meta["nominal"]
    for protocol in PROTOCOLS.values():
        for key in protocol.nominal:
            # What no table here needs may stand there too, but not wrongly: others use it.
            if key not in given and not set(protocol.tables) & set(tables):
                continue
            value = given.get(key)
            if value is None:
                raise BadInput(f"{path}: nominal.{key}: missing; {protocol.name} needs it")
            if not is_number(value) or (value <= 0 and key != "ply_exponent"):
                raise BadInput(f"{path}: nominal.{key}: {value!r}; must be a positive number")
    values = {key: float(value) for key, value in given.items() if is_number(value)}
    dwell = meta.get("reversal_dwell_s", given.get("reversal_dwell_s"))
    if dwell is not None:
        if not is_number(dwell) or dwell < 0:
            raise BadInput(f"{path}: reversal_dwell_s: {dwell!r}; must be a number of at least 0")
        values["reversal_dwell_s"] = float(dwell)
    return values


def _text_column(path, column, values, lines, measured) -> np.ndarray:
    try:
        codes, found = pd.factorize(values, use_na_sentinel=False)
    except TypeError:  # lists of a nested column
        raise BadInput(f"{path}: column {column.name}: not text") from None
    texts = []
    for code, value in enumerate(found):
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        text = "" if value is None or value != value else str(value).strip()
        where = f"{path}: row {lines[int(np.argmax(codes == code))]}: column {column.name}"
        if not text and not column.may_be_empty and not measured:
            raise BadInput(f"{where}: empty")
        if text and column.choices and text not in column.choices:
            raise BadInput(f"{where}: '{text}'; allowed: {column.allowed}")
        texts.append(text)
    return np.array(texts, dtype=object)[codes]


def _as_numbers(values: pd.Series) -> np.ndarray:
    return pd.to_numeric(values, errors="coerce").to_numpy(float, na_value=np.nan).copy()


def _number_column(path, column, values, lines, measured) -> np.ndarray:
    def refuse(row: int, words: str):
        raise BadInput(f"{path}: row {lines[row]}: column {column.name}: {words}{column.allowed}")

    if values.dtype == object or not pd.api.types.is_numeric_dtype(values):
        plain = values if values.dtype == object else values.astype("string")  # dates are none
        numbers = _as_numbers(plain)
        odd = np.flatnonzero(~np.isfinite(numbers))  # empty, padded with blanks, or bad
        texts = values.iloc[odd].astype("string").fillna("").str.strip()
        given = (texts != "").to_numpy()
        numbers[odd] = _as_numbers(texts)
        empty = np.isin(np.arange(len(numbers)), odd[~given])
        for i in np.flatnonzero(given & ~np.isfinite(numbers[odd])):
            spelled_nan = texts.iloc[i].lower() in ("nan", "na", "none", "null")
            hint = "leave the cell empty if it was not recorded; " if spelled_nan else ""
            refuse(odd[i], f"'{texts.iloc[i]}'; {hint}allowed: ")
    else:
        numbers = values.to_numpy(float)
        empty = np.isnan(numbers)
    if empty.any() and not column.may_be_empty and not measured:
        refuse(int(np.argmax(empty)), "empty; needed: ")
    with np.errstate(invalid="ignore"):
        for i in np.flatnonzero((numbers < column.lower) | (numbers > column.upper)):
            refuse(i, f"{numbers[i]:g}; allowed: ")
    return numbers


def _check_traces(
    folder: Path, runs_table: tuple[str, pd.DataFrame], traces_table: tuple[str, pd.DataFrame]
) -> None:
    (runs_name, runs), (traces_name, traces) = runs_table, traces_table
    known, traced = set(runs["run_id"]), set(traces["run_id"])
    if name := min(traced - known, default=""):
        row = int(np.argmax((traces["run_id"] == name).to_numpy())) + 2
        where = f"{folder / traces_name}.csv: row {row}: column run_id: '{name}'"
        if (folder / traces_name).is_dir():
            where = f"{folder / traces_name}: '{name}'"
        raise BadInput(f"{where} is not in {runs_name}.csv")
    if name := min(known - traced, default=""):
        raise BadInput(
            f"{folder / runs_name}.csv: run_id '{name}' has no rows in {traces_name}.csv"
        )
