"""The record of every artefact: its origin, inputs, software and cost."""

import contextlib
import functools
import hashlib
import json
import os
import platform
import re
import resource
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from slipstitch import __version__
from slipstitch.base.project import PACKAGE, installed_version
from slipstitch.base.provenance import files
from slipstitch.base.provenance.code import code_digest

METADATA_KEY = b"slipstitch"
DIGEST_KEY = b"slipstitch_sha256"
# A checksum per page: damage is noticed when a file is read (slipstitch.base.provenance.files).
WRITE_OPTIONS = {"compression": "zstd", "write_page_checksum": True}
#: What of a checkout decides about results, beside the configuration, whose values are recorded.
TRACKED = ("Snakefile", "rules", "envs", "src", "workflow", "LICENSE", "CITATION.cff")
RECORDED_PACKAGES = (
    *("av", "bpy", "cvxopt", "numpy", "opencv-python-headless", "pandas", "pillow", "pyarrow"),
    *("pydantic", "safetensors", "scipy", "snakemake", "torch", "warp-lang"),
)


def _cpu_s() -> float:
    """CPU seconds of this process and of its children that have ended."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


# Of killed processes whose work this one continues: wall and CPU seconds.
_EARLIER_S = [0.0, 0.0]


def count_earlier_attempts(wall_s: float, cpu_s: float) -> None:
    """From now on, count what an interrupted process took for work that this one continues."""
    _EARLIER_S[:] = _EARLIER_S[0] + wall_s, _EARLIER_S[1] + cpu_s


def earlier_attempts() -> tuple[float, float]:
    """Wall and CPU seconds of earlier attempts that were counted."""
    return _EARLIER_S[0], _EARLIER_S[1]


def start_clock() -> tuple[float, float]:
    """Now, as (wall seconds, CPU seconds): keep it and hand it to `provenance_record`."""
    return time.perf_counter() + _EARLIER_S[0], _cpu_s() + _EARLIER_S[1]


_PROCESS_START = (time.perf_counter(), 0.0)


@functools.cache
def _git() -> tuple[str | None, bool | None]:
    """Commit of the checkout that the running sources lie in, and whether they differ from it."""
    root = PACKAGE.parents[1]

    def ask(*words: str) -> str | None:
        command = ["git", "-C", str(root), *words]
        try:
            answer = subprocess.run(command, capture_output=True, text=True, timeout=20)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return answer.stdout.strip() if answer.returncode == 0 else None

    top = ask("rev-parse", "--show-toplevel")
    if top is None or Path(top).resolve() != root:  # installed inside somebody else's checkout
        return None, None
    changes = ask("status", "--porcelain", "--untracked-files=normal", "--", *TRACKED)
    return ask("rev-parse", "HEAD"), None if changes is None else bool(changes)


def versions() -> dict[str, str]:
    """Versions of Python, Slipstitch and the packages a result may depend on, if installed."""
    found = {package: installed_version(package) for package in RECORDED_PACKAGES}
    installed = {package: version for package, version in found.items() if version is not None}
    return {"python": platform.python_version(), "slipstitch": __version__, **installed}


@functools.cache
def host_kind() -> str:
    """The kind of machine (not its identity): system, processor, number of CPUs."""
    model = platform.machine()
    with contextlib.suppress(OSError):
        named = re.search(r"^model name\s*:(.*)$", Path("/proc/cpuinfo").read_text("utf-8"), re.M)
        model = named[1].strip() if named else model
    return f"{platform.system()} {platform.machine()}, {model}, {os.cpu_count()} CPUs"


def _plain(value: Any) -> Any:
    """`value` as JSON can hold it; pydantic models become mappings, paths strings."""
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return value.tolist()
    return value


def _shown(path: str | os.PathLike) -> str:
    """The path as a record shows it: relative to the working folder, never a machine's layout."""
    relative = os.path.relpath(path)
    return Path(path).name if relative.startswith("..") else Path(relative).as_posix()


def provenance_record(
    stage: str,
    *,
    inputs: Iterable[str | os.PathLike] = (),
    config: Any = None,
    seed: int | None = None,
    started: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """The origin of an artefact: inputs with their SHA-256, configuration, code, versions, cost.

    The stage is a key of `slipstitch.base.provenance.code.STAGES`. Times count from what
    `start_clock` returned, or the start of the process, with ended children and earlier attempts.
    """
    wall_then, cpu_then = started or _PROCESS_START
    commit, dirty = _git()
    return {
        "stage": stage,
        "inputs": {_shown(path): files.file_digest(path) for path in sorted(map(str, inputs))},
        "config": _plain(config) if config is not None else {},
        "code_digest": code_digest(stage),
        "git_commit": commit,
        "git_dirty": dirty,
        "versions": versions(),
        "seed": seed,
        "host_kind": host_kind(),
        "wall_s": round(start_clock()[0] - wall_then, 4),
        "cpu_s": round(start_clock()[1] - cpu_then, 4),
    }


def write_sidecar(path: str | os.PathLike, record: Mapping[str, Any]) -> None:
    """Write `record` beside the file `path`, as ``<path>.provenance.json``.

    The file's SHA-256 is noted in it, so that whoever reads the file sees damage to it.
    """
    if Path(path).is_file():
        record = {**record, "sha256": files.file_digest(path)}
    write_json(f"{os.fspath(path)}{files.SIDECAR_SUFFIX}", _plain(record))


def write_text(path: str | os.PathLike, text: str, record: Mapping[str, Any] | None = None) -> None:
    """Write a text file, whole or not at all, and `record` beside it if there is one."""
    with files.atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    if record is not None:
        write_sidecar(path, record)


def write_json(
    path: str | os.PathLike, content: Any, record: Mapping[str, Any] | None = None, **options: Any
) -> None:
    """As `write_text`; `options` go to ``json.dumps`` (indented, NaN refused unless said so)."""
    options = {"indent": 1, "allow_nan": False} | options
    write_text(path, json.dumps(content, **options) + "\n", record)


@contextlib.contextmanager
def recorded_path(path: str | os.PathLike, record: Mapping[str, Any]) -> Iterator[Path]:
    """As `atomic_path`; afterwards `record` is written beside the file."""
    with files.atomic_path(path) as temporary:
        yield temporary
    write_sidecar(path, record)


def read_sidecar(path: str | os.PathLike) -> dict[str, Any]:
    """The record beside the file `path`; FileNotFoundError without one, Damaged if none."""
    record = files.record_beside(path)
    if record is None:
        raise FileNotFoundError(f"{os.fspath(path)}{files.SIDECAR_SUFFIX}")
    record.pop("sha256", None)  # of the file, not of its origin
    return record


def attach_metadata(table, metadata: Mapping[str, Any], record: Mapping[str, Any] | None = None):
    """A pyarrow table or schema with `metadata` merged into its JSON under key ``slipstitch``.

    New entries win; a `record` goes to the entry ``provenance``; other keys and the data stay.
    """
    schema = getattr(table, "schema", table)
    keys = dict(schema.metadata or {})
    whole = json.loads(keys.get(METADATA_KEY, b"{}")) | _plain(metadata)
    replace = getattr(table, "replace_schema_metadata", None) or table.with_metadata
    return replace(keys | _described(whole, record))


def _described(metadata: Mapping[str, Any], record: Mapping[str, Any] | None) -> dict[bytes, bytes]:
    """What a schema says in metadata: the JSON object, and its SHA-256."""
    whole = {**_plain(metadata), **({} if record is None else {"provenance": _plain(record)})}
    text = json.dumps(whole, allow_nan=False).encode()
    return {METADATA_KEY: text, DIGEST_KEY: hashlib.sha256(text).hexdigest().encode()}


def write_parquet(
    table,
    path: str | os.PathLike,
    metadata: Mapping[str, Any] | None = None,
    record: Mapping[str, Any] | None = None,
    **options: Any,
) -> None:
    """Write a pyarrow table atomically, with metadata and provenance inside its schema.

    `options` go to ``pyarrow.parquet.write_table`` (compression zstd unless said otherwise).
    """
    import pyarrow.parquet

    whole = attach_metadata(table, metadata or {}, record)
    with files.atomic_path(path) as temporary, open(temporary, "wb") as stream:
        pyarrow.parquet.write_table(whole, stream, **{**WRITE_OPTIONS, **options})


def write_row_groups(
    path: str | os.PathLike,
    schema,
    groups: Iterable[list[dict[str, Any]]],
    describe: Callable[[], tuple[Mapping[str, Any], Mapping[str, Any]]],
    **options: Any,
) -> None:
    """Write rows atomically, a row group at a time: memory does not grow with the file.

    `schema` must hold types that Parquet itself knows. `describe` is called after the last rows,
    and returns what `write_parquet` calls metadata and record; `options` go to ``ParquetWriter``.
    """
    import pyarrow.parquet

    # Arrow's own copy of the schema is left out: it would hide metadata that is added at the end.
    options = {**WRITE_OPTIONS, "store_schema": False, **options}
    with (
        files.atomic_path(path) as temporary,
        open(temporary, "wb") as stream,
        pyarrow.parquet.ParquetWriter(stream, schema, **options) as writer,
    ):
        for rows in groups:
            writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))
        writer.add_key_value_metadata(_described(*describe()))


def read_metadata(source) -> dict[str, Any]:
    """The JSON object under key ``slipstitch`` of a Parquet file, pyarrow table or schema, or {}.

    BadInput if there is no such file, ValueError if the object is not as it was written.
    """
    if isinstance(source, str | os.PathLike):
        with files.open_parquet(source) as file:
            return read_metadata(file.schema_arrow)
    keys = getattr(source, "schema", source).metadata or {}
    text = keys.get(METADATA_KEY, b"{}")
    if keys.get(DIGEST_KEY, None) not in (None, hashlib.sha256(text).hexdigest().encode()):
        raise ValueError("its metadata was altered or damaged")
    content = json.loads(text)
    if not isinstance(content, dict):
        raise ValueError("its metadata is not a mapping")
    return content


def read_provenance(path: str | os.PathLike) -> dict[str, Any]:
    """The record of any artefact, in a Parquet file or beside it; FileNotFoundError without one."""
    if not Path(path).exists():
        raise FileNotFoundError(path)
    if Path(path).suffix == ".parquet" and "provenance" in (inside := read_metadata(path)):
        return inside["provenance"]
    return read_sidecar(path)
