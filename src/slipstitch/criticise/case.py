"""Read a case folder; every fault is one line that names file, row and column."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.protocols.columns import Column
from slipstitch.errors import BadInput
from slipstitch.provenance import read_parquet


@dataclass(frozen=True)
class Case:
    """One fabric-substrate pair measured in one campaign.

    ``tables`` maps a table's name to its checked rows: numbers as float64 with NaN where a cell
    is empty, text as str with '' where it is.
    """

    name: str
    meta: dict
    nominal: dict[str, float]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    ignored_files: tuple[str, ...] = ()

    @property
    def protocols(self) -> tuple[str, ...]:
        """Protocols that have data, in the order of the format."""
        return tuple(name for name, p in PROTOCOLS.items() if set(p.tables) <= set(self.tables))


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
    tables: dict[str, pd.DataFrame] = {}
    known = set()
    for protocol in PROTOCOLS.values():
        found = {}
        for table, columns in protocol.tables.items():
            paths = [folder / f"{table}{ending}" for ending in (".csv", ".parquet")]
            paths = [path for path in paths if path.exists()]
            known |= {path.name for path in paths}
            if len(paths) > 1:
                raise BadInput(
                    f"{folder}: both {table}.csv and {table}.parquet; only one is allowed"
                )
            if paths:
                found[table] = _read_table(paths[0], columns, with_measurements)
        missing = [table for table in protocol.tables if table not in found]
        if found and missing and (with_measurements or missing[0] == protocol.runs_table):
            have, want = ", ".join(f"{t}.csv" for t in found), f"{missing[0]}.csv"
            raise BadInput(
                f"{folder}: {have} without {want}; the {protocol.name} protocol requires both"
            )
        if found and not missing and len(found) == 2:
            _check_traces(folder, *found.items())
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
    return Case(name, meta, nominal, tables, tuple(others))


def _protocol_name(text) -> str:
    by_letter = {protocol.letter: name for name, protocol in PROTOCOLS.items()}
    text = str(text).strip().lower().replace("-", "_")
    return by_letter.get(text.strip("()"), text)


def _read_meta(path: Path) -> dict:
    if not path.exists():
        raise BadInput(f"{path.parent}: no meta.json; a case folder requires one")
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not valid JSON: {error}") from None
    if not isinstance(meta, dict) or not isinstance(meta.get("nominal"), dict):
        raise BadInput(f"{path}: nominal: missing; must be a mapping of the nominal values")
    return meta


def _nominal(path: Path, meta: dict, tables: dict) -> dict[str, float]:
    values = {}
    for key, value in meta["nominal"].items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        values[key] = float(value)
    for protocol in PROTOCOLS.values():
        if not set(protocol.tables) & set(tables):
            continue
        for key in protocol.nominal:
            value = meta["nominal"].get(key)
            if value is None:
                raise BadInput(f"{path}: nominal.{key}: missing; {protocol.name} needs it")
            good = isinstance(value, int | float) and math.isfinite(value)
            if not good or (value <= 0 and key != "ply_exponent"):
                raise BadInput(f"{path}: nominal.{key}: {value!r}; must be a positive number")
    dwell = meta.get("reversal_dwell_s", meta["nominal"].get("reversal_dwell_s"))
    if dwell is not None:
        if isinstance(dwell, bool) or not isinstance(dwell, int | float) or dwell < 0:
            raise BadInput(f"{path}: reversal_dwell_s: {dwell!r}; must be a number of at least 0")
        values["reversal_dwell_s"] = float(dwell)
    return values


def _read_raw(path: Path) -> pd.DataFrame:
    try:
        if path.suffix == ".parquet":
            return read_parquet(path).to_pandas(ignore_metadata=True)
        return pd.read_csv(
            path, dtype=str, keep_default_na=False, encoding="utf-8-sig", skip_blank_lines=False
        )
    except pd.errors.EmptyDataError:
        raise BadInput(f"{path}: empty; must contain a header and at least one row") from None
    except (UnicodeDecodeError, pd.errors.ParserError, OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None


def _read_table(path: Path, columns: tuple[Column, ...], with_measurements: bool) -> pd.DataFrame:
    raw = _read_raw(path)
    if not isinstance(raw.index, pd.RangeIndex):  # pandas takes what is too much for names of rows
        raise BadInput(f"{path}: a row has more cells than the header")
    raw.columns = [str(name).strip() for name in raw.columns]
    repeated = raw.columns[raw.columns.duplicated()]
    if len(repeated):
        raise BadInput(f"{path}: column {repeated[0]}: given twice")
    if path.suffix == ".csv":
        blank = (raw.apply(lambda values: values.str.strip()) == "").all(axis=1)
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


def _text_column(path, column, values, lines, measured) -> list[str]:
    texts = []
    for value, line in zip(values, lines, strict=True):
        missing = value is None or (isinstance(value, float) and math.isnan(value))
        if isinstance(value, float) and not missing and value.is_integer():
            value = int(value)
        text = "" if missing else str(value).strip()
        if not text and not column.may_be_empty and not measured:
            raise BadInput(f"{path}: row {line}: column {column.name}: empty")
        if text and column.choices and text not in column.choices:
            raise BadInput(
                f"{path}: row {line}: column {column.name}: '{text}'; allowed: {column.allowed}"
            )
        texts.append(text)
    return texts


def _number_column(path, column, values, lines, measured) -> np.ndarray:
    if values.dtype == object or not pd.api.types.is_numeric_dtype(values):
        texts = values.astype("string").fillna("").str.strip()
        empty = (texts == "").to_numpy()
        numbers = pd.to_numeric(texts.where(~empty, "nan"), errors="coerce").to_numpy(float)
        numbers = np.where(empty, np.nan, numbers)
        spelled_nan = texts.str.lower().isin(["nan", "na", "none", "null"]).to_numpy()
        bad = ~empty & ~np.isfinite(numbers)
        if bad.any():
            i = int(np.argmax(bad))
            hint = " (leave the cell empty if it was not recorded)" if spelled_nan[i] else ""
            raise BadInput(
                f"{path}: row {lines[i]}: column {column.name}: '{texts.iloc[i]}'; "
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
        raise BadInput(
            f"{folder / traces_name}.csv: row {row}: column run_id: '{name}' is not in "
            f"{runs_name}.csv"
        )
    if known - traced:
        name = sorted(known - traced)[0]
        raise BadInput(
            f"{folder / runs_name}.csv: run_id '{name}' has no rows in {traces_name}.csv"
        )
