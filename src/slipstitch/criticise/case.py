"""Read a case folder; every fault is one line that names file, row and column."""

from __future__ import annotations

import io
import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_parquet
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.protocols.columns import Column

TABLE_BYTES_MAX = 512 * 2**20


@dataclass(frozen=True)
class Case:
    """One fabric-substrate pair measured in one campaign.

    ``tables`` maps a table's name to its checked rows: numbers as float64 with NaN where a cell
    is empty, text as str with '' where it is. ``files`` are those that were read.
    """

    name: str
    meta: dict
    nominal: dict[str, float]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    ignored_files: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def protocols(self) -> tuple[str, ...]:
        """Protocols that have data, in the order of the format."""
        return tuple(name for name, p in PROTOCOLS.items() if set(p.tables) <= set(self.tables))

    @property
    def protocols_of_runs(self) -> tuple[str, ...]:
        """Protocols that have a table of runs, with traces or without."""
        return tuple(name for name, p in PROTOCOLS.items() if p.runs_table in self.tables)


def read_case(folder: Path | str, with_measurements: bool = True) -> Case:
    """Read and check a case.

    Parameters
    ----------
    folder
        Holds meta.json and at least one protocol's tables, as CSV or Parquet.
    with_measurements
        False reads run tables only (a design whose outcome is to be predicted): traces may be
        absent and measured values empty.

    Raises
    ------
    BadInput
        For any violation of the format.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such case folder")
    meta = _read_meta(folder / "meta.json")
    files = [folder / "meta.json"]
    tables: dict[str, pd.DataFrame] = {}
    known = set()
    for protocol in PROTOCOLS.values():
        found = {}
        for table, columns in protocol.tables.items():
            paths = [folder / f"{table}{ending}" for ending in (".csv", ".parquet")]
            paths += [folder / table] if table != protocol.runs_table else []  # one file a run
            paths = [path for path in paths if path.exists()]
            known |= {path.name for path in paths}
            if len(paths) > 1:
                names = " and ".join(path.name for path in paths)
                raise BadInput(f"{folder}: both {names}; only one is allowed")
            if paths:
                read = _read_folder if paths[0].is_dir() else _read_table
                found[table] = read(paths[0], columns, with_measurements)
                files += _files_of(paths[0]) if paths[0].is_dir() else paths
        missing = [table for table in protocol.tables if table not in found]
        if found and missing and (with_measurements or missing[0] == protocol.runs_table):
            have, want = ", ".join(f"{t}.csv" for t in found), f"{missing[0]}.csv"
            raise BadInput(
                f"{folder}: {have} without {want}; the {protocol.name} protocol requires both"
            )
        if found and not missing and len(found) == 2:
            _check_traces(folder, *found.items())
            traces = list(found)[1]
            found[traces] = _in_order(found[traces])
        tables |= found
    if not tables:
        names = " ".join(f"{table}.csv" for p in PROTOCOLS.values() for table in p.tables)
        raise BadInput(f"{folder}: no table of any protocol; known: {names}")
    declared = meta.get("protocols") or []
    for name in declared if isinstance(declared, list) else []:
        wanted = PROTOCOLS.get(_protocol_name(name))
        if wanted is None:
            raise BadInput(
                f"{folder / 'meta.json'}: protocols: unknown protocol {name!r}; "
                f"known: {' '.join(PROTOCOLS)}"
            )
        absent = [table for table in wanted.tables if table not in tables]
        if absent and with_measurements:
            raise BadInput(f"{folder / 'meta.json'}: protocols: {name} has no {absent[0]}.csv")
    nominal = _nominal(folder / "meta.json", meta, tables)
    others = sorted(
        path.name
        for path in folder.iterdir()
        if path.suffix in (".csv", ".parquet") and path.name not in known
    )
    name = str(meta.get("case") or meta.get("case_id") or folder.resolve().name)
    return Case(name, meta, nominal, tables, tuple(others), tuple(files))


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
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not valid JSON: {error}") from None
    if not isinstance(meta, dict) or not isinstance(meta.get("nominal"), dict):
        raise BadInput(f"{path}: nominal: missing; must be a mapping of the nominal values")
    return meta


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
            good = isinstance(value, int | float) and not isinstance(value, bool)
            good = good and math.isfinite(value)
            if not good or (value <= 0 and key != "ply_exponent"):
                raise BadInput(f"{path}: nominal.{key}: {value!r}; must be a positive number")
    values = {
        key: float(value)
        for key, value in given.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    dwell = meta.get("reversal_dwell_s", meta["nominal"].get("reversal_dwell_s"))
    if dwell is not None:
        good = isinstance(dwell, int | float) and not isinstance(dwell, bool)
        if not good or not 0 <= dwell < math.inf:
            raise BadInput(f"{path}: reversal_dwell_s: {dwell!r}; must be a number of at least 0")
        values["reversal_dwell_s"] = float(dwell)
    return values


def _read_raw(path: Path) -> pd.DataFrame:
    try:
        if path.suffix == ".parquet":
            return read_parquet(path).to_pandas(ignore_metadata=True)
        content = path.read_bytes()
        if b"\0" in content:  # pandas would leave them out
            raise ValueError("holds NUL bytes; text in UTF-8 is needed")
        return pd.read_csv(
            io.BytesIO(content),
            dtype=str,
            keep_default_na=False,
            encoding="utf-8-sig",
            skip_blank_lines=False,
        )
    except pd.errors.EmptyDataError:
        raise BadInput(f"{path}: empty; must contain a header and at least one row") from None
    except (UnicodeDecodeError, pd.errors.ParserError, OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None


def _files_of(path: Path) -> list[Path]:
    """The files of a folder of traces."""
    return sorted(file for file in path.iterdir() if file.suffix in (".csv", ".parquet"))


def _read_folder(path: Path, columns: tuple[Column, ...], with_measurements: bool) -> pd.DataFrame:
    """The traces of a folder with one file a run, which the file is called after."""
    files = _files_of(path)
    if not files:
        raise BadInput(f"{path}: no file; RUN_ID.csv or RUN_ID.parquet for each run is needed")
    columns = tuple(column for column in columns if column.name != "run_id")
    parts = {file.stem: _read_table(file, columns, with_measurements) for file in files}
    if len(parts) < len(files):
        raise BadInput(f"{path}: a run as CSV and as Parquet; give one of them")
    names = np.repeat(list(parts), [len(part) for part in parts.values()])
    table = pd.concat(parts.values(), ignore_index=True)
    table.insert(0, "run_id", names.astype(object))
    return table


def _read_table(path: Path, columns: tuple[Column, ...], with_measurements: bool) -> pd.DataFrame:
    _refuse_no_file(path)
    raw = _read_raw(path)
    if not isinstance(raw.index, pd.RangeIndex):  # pandas takes what is too much for names of rows
        raise BadInput(f"{path}: a row has more cells than the header")
    raw.columns = [str(name).strip() for name in raw.columns]
    repeated = raw.columns[raw.columns.duplicated()]
    if len(repeated):
        raise BadInput(f"{path}: column {repeated[0]}: given twice")
    if path.suffix == ".csv":
        blank = np.ones(len(raw), bool)
        for name in raw.columns:  # few rows are left to look at after the first column
            blank[blank] = (raw.loc[blank, name].str.strip() == "").to_numpy()
        raw = raw[~blank]
    if len(raw) == 0:
        raise BadInput(f"{path}: no rows; at least one is required")
    table = {}
    for column in columns:
        measured = column.measured and not with_measurements
        if column.name not in raw.columns:
            if measured:
                continue
            raise BadInput(f"{path}: column {column.name}: missing")
        values = raw[column.name]
        lines = np.asarray(raw.index) + (2 if path.suffix == ".csv" else 1)
        check = _text_column if column.text else _number_column
        table[column.name] = check(path, column, values, lines, measured)
    result = pd.DataFrame(table)
    if "specimen_id" in table:  # one row a trial or run
        again = result["run_id"].duplicated()
        if again.any():
            row = lines[int(np.argmax(again.to_numpy()))]
            name = result["run_id"][again].iloc[0]
            raise BadInput(f"{path}: row {row}: column run_id: '{name}' is duplicated")
    return result


def _text_column(path, column, values, lines, measured) -> np.ndarray:
    try:
        codes, found = pd.factorize(values, use_na_sentinel=False)
    except TypeError:  # lists of a nested column
        raise BadInput(f"{path}: column {column.name}: not text") from None
    texts = []
    for code, value in enumerate(found):
        missing = value is None or (isinstance(value, float) and math.isnan(value))
        if isinstance(value, float) and not missing and value.is_integer():
            value = int(value)
        text = "" if missing else str(value).strip()
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
    if values.dtype == object or not pd.api.types.is_numeric_dtype(values):
        plain = values if values.dtype == object else values.astype("string")  # dates are none
        numbers = _as_numbers(plain)
        odd = np.flatnonzero(~np.isfinite(numbers))  # empty, padded with blanks, or bad
        texts = values.iloc[odd].astype("string").fillna("").str.strip()
        given = (texts != "").to_numpy()
        numbers[odd] = _as_numbers(texts)
        empty = np.isin(np.arange(len(numbers)), odd[~given])
        bad = given & ~np.isfinite(numbers[odd])
        if bad.any():
            i = int(np.argmax(bad))
            spelled_nan = texts.iloc[i].lower() in ("nan", "na", "none", "null")
            hint = " (leave the cell empty if it was not recorded)" if spelled_nan else ""
            raise BadInput(
                f"{path}: row {lines[odd[i]]}: column {column.name}: '{texts.iloc[i]}'; "
                f"allowed: {column.allowed}{hint}"
            )
    else:
        numbers = values.to_numpy(float)
        empty = np.isnan(numbers)
    if empty.any() and not column.may_be_empty and not measured:
        row = lines[int(np.argmax(empty))]
        raise BadInput(f"{path}: row {row}: column {column.name}: empty; needed: {column.allowed}")
    with np.errstate(invalid="ignore"):
        outside = (numbers < column.lower) | (numbers > column.upper)
    if outside.any():
        i = int(np.argmax(outside))
        raise BadInput(
            f"{path}: row {lines[i]}: column {column.name}: {numbers[i]:g}; "
            f"allowed: {column.allowed}"
        )
    return numbers


def _check_traces(
    folder: Path, runs_table: tuple[str, pd.DataFrame], traces_table: tuple[str, pd.DataFrame]
) -> None:
    (runs_name, runs), (traces_name, traces) = runs_table, traces_table
    known, traced = set(runs["run_id"]), set(traces["run_id"])
    if traced - known:
        name = sorted(traced - known)[0]
        row = int(np.argmax((traces["run_id"] == name).to_numpy())) + 2
        where = f"{folder / traces_name}.csv: row {row}: column run_id: '{name}'"
        if (folder / traces_name).is_dir():
            where = f"{folder / traces_name}: '{name}'"
        raise BadInput(f"{where} is not in {runs_name}.csv")
    if known - traced:
        name = sorted(known - traced)[0]
        raise BadInput(
            f"{folder / runs_name}.csv: run_id '{name}' has no rows in {traces_name}.csv"
        )


def _in_order(traces: pd.DataFrame) -> pd.DataFrame:
    """Readings of a run in order of time; where it was not recorded, along the stage's strokes."""
    if "t_s" in traces and traces["t_s"].notna().all():
        key = traces["t_s"]
    elif "stroke" in traces:
        key = traces["x_stage_mm"] * (1 - 2 * traces["stroke"])
    else:
        return traces
    return traces.iloc[np.argsort(key.to_numpy(), kind="stable")].reset_index(drop=True)
