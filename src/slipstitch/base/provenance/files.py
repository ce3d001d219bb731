"""Files: written whole or not at all; read safely, with one clear error for each that cannot be.

Nothing here runs what it reads: YAML is loaded safely, Parquet and JSON hold data alone. Files that
claim more than they can hold are refused before memory is taken for them.
"""

import contextlib
import fcntl
import hashlib
import io
import json
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

from slipstitch.base.errors import BadInput, Damaged, first_line

SIDECAR_SUFFIX = ".provenance.json"
YAML_BYTES_MAX = 256 * 1024
YAML_VALUES_MAX = 100_000
IMAGE_PIXELS_MAX = 64 * 2**20
JSON_BYTES_MAX = 512 * 1024 * 1024
# What claims more than this for each of its bytes is no dataset: repeated values take next to none.
BYTES_A_BYTE_MAX = 10_000
ROWS_A_BYTE_MAX = 100
# What pyarrow raises for damaged files, besides OSError and its own exceptions (ValueErrors).
_DAMAGE = (OSError, ValueError, MemoryError, KeyError, TypeError, OverflowError, RecursionError)
TEMPORARY_SUFFIX = ".tmp"
YOUNG_S = 3600.0  # a temporary folder that may not have been locked yet


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path, with the suffix of `path`, that takes its name when the block ends well.

    A crash leaves the old file or folder or the new one, never half of one. Missing parents are
    created, and what a killed process left of the same name is removed. FileNotFoundError if the
    block wrote nothing.
    """
    final = Path(path)
    final.parent.mkdir(parents=True, exist_ok=True)
    _clear_abandoned(final)
    with _own_folder(final) as folder:
        temporary = folder / final.name
        yield temporary
        if not temporary.exists():
            raise FileNotFoundError(f"nothing was written for {final}")
        if temporary.is_dir():
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _flush(file)
            if final.is_dir() and not final.is_symlink():
                # At no time is there half a folder under the final name.
                os.replace(final, folder / f"{final.name}.old")
        else:
            _flush(temporary)
        os.replace(temporary, final)
        _flush(final.parent)


@contextlib.contextmanager
def _own_folder(final: Path) -> Iterator[Path]:
    """A temporary folder beside `final`, locked for as long as this process uses it."""
    with tempfile.TemporaryDirectory(
        prefix=f".{final.stem}.",
        suffix=TEMPORARY_SUFFIX,
        dir=final.parent,
        ignore_cleanup_errors=True,
    ) as name:
        descriptor = os.open(name, os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Written to in a folder of its own: from here on, until all is done, the locked one
            # isn't empty, and whoever finds it without its lock knows that it is abandoned.
            work = Path(name, "work")
            work.mkdir()
            yield work
        finally:
            os.close(descriptor)


def _clear_abandoned(final: Path) -> None:
    """Remove what processes that were killed left beside `final`; those that live hold a lock."""
    for entry in os.scandir(final.parent):
        if not (entry.name.startswith(f".{final.stem}.") and entry.name.endswith(TEMPORARY_SUFFIX)):
            continue
        with contextlib.suppress(OSError):
            descriptor = os.open(entry.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # An empty one may be so young that its process has not locked it yet.
                young = time.time() - entry.stat().st_mtime < YOUNG_S
                if not young or any(os.scandir(entry.path)):
                    shutil.rmtree(entry.path)
            finally:
                os.close(descriptor)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def file_digest(path: str | os.PathLike) -> str:
    """SHA-256 of a file's bytes, as 64 hexadecimal digits."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextlib.contextmanager
def reading(path: str | os.PathLike, kind: str) -> Iterator[None]:
    """Report errors in the block for the file at `path`, which should be a `kind`.

    BadInput if there is no such file, or it cannot be opened; `Damaged` if it cannot be understood.
    """
    try:
        yield
    except BadInput:
        raise
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except IsADirectoryError:
        raise BadInput(f"{path}: is a folder; must be a {kind}") from None
    except PermissionError:
        raise BadInput(f"{path}: permission denied") from None
    except _DAMAGE as error:
        raise Damaged(path, f"damaged or not a {kind}: {first_line(error)}") from None


def _check_claims(path: str | os.PathLike, metadata) -> None:
    """Refuse a file whose footer claims far more than its bytes can hold."""
    size = os.path.getsize(path)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    rows = max([metadata.num_rows, *(group.num_rows for group in groups)])
    claimed = sum(group.total_byte_size for group in groups)
    if not (0 <= rows <= size * ROWS_A_BYTE_MAX and 0 <= claimed <= size * BYTES_A_BYTE_MAX):
        raise ValueError(f"claims {rows} rows of {claimed} bytes in a file of {size} bytes")


@contextlib.contextmanager
def open_parquet(path: str | os.PathLike) -> Iterator[Any]:
    """A ``pyarrow.parquet.ParquetFile`` that verifies checksums; errors in the block name it."""
    import pyarrow.parquet

    path = os.fspath(path)
    with (
        reading(path, "Parquet file"),
        open(path, "rb") as stream,  # pyarrow takes no file name that is not text
        pyarrow.parquet.ParquetFile(stream, page_checksum_verification=True) as file,
    ):
        _check_claims(path, file.metadata)
        _ = file.schema_arrow.names  # raises where a column's name is no text
        yield file


def read_parquet(path: str | os.PathLike, columns: Iterable[str] | None = None):
    """A Parquet file as a pyarrow table, checksums verified; all columns, or those named."""
    wanted = None if columns is None else list(columns)
    with open_parquet(path) as file:
        for name in wanted or ():
            if name not in file.schema_arrow.names:
                raise BadInput(f"{path}: no column {name!r}; required: {', '.join(wanted or ())}")
        table = file.read(columns=wanted)
        table.validate(full=True)  # text that is none, offsets that lead nowhere
        return table


def check_image(data: bytes, where: str) -> None:
    """Refuse what is no image, or claims more than `IMAGE_PIXELS_MAX`, before it is decoded."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:
            width, height = image.size
    except Image.DecompressionBombError:
        width = height = IMAGE_PIXELS_MAX
    except (*_DAMAGE, SyntaxError):
        raise BadInput(f"{where}: not an image file, or a damaged image") from None
    if width * height > IMAGE_PIXELS_MAX:
        raise BadInput(f"{where}: an image of more than {IMAGE_PIXELS_MAX} pixels")


def image_bytes(path: str | os.PathLike) -> bytes:
    """Content of an image file, not yet checked; BadInput if it cannot be read."""
    with reading(path, "image file"):
        return Path(path).read_bytes()


def read_json(path: str | os.PathLike) -> Any:
    """Content of a JSON file; `Damaged` if it is none, or not what its record was written for."""
    with reading(path, "JSON file"):
        if os.path.getsize(path) > JSON_BYTES_MAX:
            raise ValueError("too large")
        raw = Path(path).read_bytes()
        _check_digest(path, raw)
        return json.loads(raw.decode("utf-8-sig"))


def record_beside(path: str | os.PathLike) -> dict[str, Any] | None:
    """The record in ``<path>.provenance.json``; None if there is none, Damaged if it is none."""
    side = Path(os.fspath(path) + SIDECAR_SUFFIX)
    if not side.is_file():
        return None
    with reading(side, "record of provenance"):
        record = json.loads(side.read_text(encoding="utf-8"))
        if not isinstance(record, dict):
            raise ValueError("must be a mapping")
        return record


def check_recorded(path: str | os.PathLike) -> None:
    """Refuse a file that is missing, or not what the record beside it, if any, was written for."""
    with reading(path, "file"):
        _check_digest(path, Path(path).read_bytes())


def _check_digest(path: str | os.PathLike, raw: bytes) -> None:
    noted = (record_beside(path) or {}).get("sha256")
    if noted is not None and noted != hashlib.sha256(raw).hexdigest():
        raise ValueError("its content does not match its record")


def _values(content: Any) -> int:
    """Number of values in a structure with aliases expanded; stops at `YAML_VALUES_MAX`."""
    count, waiting = 0, [content]
    while waiting and count <= YAML_VALUES_MAX:
        value = waiting.pop()
        count += 1
        if isinstance(value, dict):
            waiting.extend(value.values())
        elif isinstance(value, list | tuple | set):
            waiting.extend(value)
    return count


class _UniqueKeys(yaml.SafeLoader):
    """Plain data only, as `yaml.SafeLoader`; a key given twice is an error."""

    def construct_mapping(self, node, deep=False):
        """The mapping of a node."""
        given = set()
        for key_node, _ in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key in given and key != "<<":
                problem = f"key {key!r} is given twice"
                raise yaml.MarkedYAMLError(None, None, problem, key_node.start_mark)
            given.add(key)
            given.discard(None)
        return super().construct_mapping(node, deep)


def load_yaml(text: str, where: str) -> Any:
    """The content of a YAML text, plain data only; `where` names it in a BadInput."""
    if len(text) > YAML_BYTES_MAX:
        raise BadInput(f"{where}: {len(text)} characters; at most {YAML_BYTES_MAX} are allowed")
    try:
        content = yaml.load(text, Loader=_UniqueKeys)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}:" if mark else ""
        raise BadInput(f"{where}:{line} not YAML: {getattr(error, 'problem', error)}") from None
    except RecursionError:
        raise BadInput(f"{where}: invalid YAML: nested too deeply") from None
    except ValueError as error:  # a date of month 13, say
        raise BadInput(f"{where}: not YAML: {first_line(error)}") from None
    if _values(content) > YAML_VALUES_MAX:
        raise BadInput(f"{where}: more than {YAML_VALUES_MAX} values with aliases expanded")
    return content


def read_yaml(path: str | os.PathLike) -> Any:
    """Content of a YAML (or JSON) file; BadInput as of `load_yaml`, or if it cannot be read."""
    try:
        with open(path, "rb") as stream:
            raw = stream.read(4 * YAML_BYTES_MAX + 1)
        text = raw.decode("utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise BadInput(f"{path}: cannot be read: {reason}") from None
    return load_yaml(text, os.fspath(path))
