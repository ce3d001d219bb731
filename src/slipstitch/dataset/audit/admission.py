"""What of a folder may be read at all: plain files of sizes and shapes that a release can have.

A folder from a stranger may hold links to devices, pipes, files that grow a thousandfold when they
are read. All that is refused before anything of it is opened, hashed or decoded.
"""

import contextlib
import os
import resource
import stat
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.provenance import reading
from slipstitch.dataset.release.records import RECORDS, SIMULATIONS
from slipstitch.dataset.release.shards import FOLDER

ENTRIES_MAX = 200_000
DEPTH_MAX = 20
#: Of any file but shards and simulations, and of all of them together.
FILE_BYTES_MAX = 64 * 2**20
BYTES_MAX = 512 * 2**20
#: Of a text in a table: ids and names are far shorter.
TEXT_BYTES_MAX = 1000
#: An audit takes a quarter of it for its libraries, images one by one.
MEMORY_BYTES = 768 * 2**20
NESTING_MAX = 200
_LABEL_RATIO = 50
_BATCH_ROWS = 256
_BUFFER_BYTES = 2**20
_STEPS = np.zeros(256, np.int8)
_STEPS[[ord(sign) for sign in "[{"]], _STEPS[[ord(sign) for sign in "]}"]] = 1, -1
_KINDS = {
    stat.S_ISLNK: "a link",
    stat.S_ISFIFO: "a pipe",
    stat.S_ISSOCK: "a socket",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
}


#: What content that somebody made up may make of the code that reads it.
UNUSABLE = (
    *(LookupError, TypeError, ValueError, AttributeError, StopIteration, ArithmeticError),
    *(OSError, RecursionError, cv2.error, pa.ArrowException, SlipstitchError),
)


class Harmful(BadInput):
    """A file that takes far more memory than it has bytes; it was not read."""


def check_entries(folder: Path) -> None:
    """Refuse a folder of anything but plain files and folders, before anything is opened."""
    waiting = [(folder, 0)]
    entries = total = 0
    while waiting:
        place, depth = waiting.pop()
        if depth > DEPTH_MAX:
            raise BadInput(f"{folder}: folders nested more than {DEPTH_MAX} deep; not a release")
        with os.scandir(place) as found:
            for entry in found:
                if place == folder and entry.name.startswith("."):  # a hub's or desktop's: not read
                    continue
                entries += 1
                if entries > ENTRIES_MAX:
                    raise BadInput(f"{folder}: more than {ENTRIES_MAX} files; not a release")
                name = Path(entry.path).relative_to(folder).as_posix()
                if not name.isprintable():
                    raise BadInput(f"{folder}: {name!r}: the name is not printable")
                status = entry.stat(follow_symlinks=False)
                if stat.S_ISDIR(status.st_mode):
                    waiting.append((Path(entry.path), depth + 1))
                    continue
                if not stat.S_ISREG(status.st_mode):
                    kinds = (kind for test, kind in _KINDS.items() if test(status.st_mode))
                    raise BadInput(
                        f"{folder}: {name} is {next(kinds, 'no file')}; a release contains only "
                        "regular files (for a folder of links, copy it with cp -rL)"
                    )
                total += _checked_size(f"{folder}: {name}", name, status)
    if total > BYTES_MAX:
        raise BadInput(f"{folder}: {total} bytes besides the shards; at most {BYTES_MAX} allowed")


def _checked_size(where: str, name: str, status: os.stat_result) -> int:
    """Bytes of a file that is no shard; 0 of a shard."""
    if status.st_size > FILE_BYTES_MAX and 4 * 512 * status.st_blocks < status.st_size:
        raise BadInput(f"{where}: {status.st_size} bytes, mostly a hole (sparse file)")
    if name.startswith((f"{FOLDER}/", f"{SIMULATIONS}/")):
        return 0
    if status.st_size > FILE_BYTES_MAX:
        raise BadInput(f"{where}: {status.st_size} bytes; at most {FILE_BYTES_MAX} are allowed")
    return status.st_size


def check_nesting(folder: Path) -> None:
    """Refuse JSON that is nested more deeply than a parser can follow."""
    for path in sorted(folder.glob(f"{RECORDS}/**/*.json")):
        steps = _STEPS[np.frombuffer(path.read_bytes(), np.uint8)]
        # Brackets in texts count too: no record has hundreds of them.
        if len(steps) and np.cumsum(steps, dtype=np.int32).max() > NESTING_MAX:
            raise BadInput(f"{path}: nested more than {NESTING_MAX} deep; not read")


def check_parquet(path: Path, images: bool) -> str | None:
    """Whether a Parquet file holds what it seems to hold, by its footer alone.

    Harmful if reading it could take far more memory than it has bytes; the `images` of a shard must
    be stored as they are. Returns what is odd but harmless: bytes that belong to no column.
    """
    with reading(path, "Parquet file"), pq.ParquetFile(path) as file:
        footer, size = file.metadata, os.path.getsize(path)
        # Ids and digests of a row take 8 bytes, however well they are compressed.
        if footer.num_rows > size / 8:
            raise Harmful(f"{path}: {footer.num_rows} rows compressed to {size} bytes; not read")
        groups = [footer.row_group(number) for number in range(footer.num_row_groups)]
        chunks = [group.column(k) for group in groups for k in range(footer.num_columns)]
        labels = [one for one in chunks if not (images and one.path_in_schema[:6] == "image.")]
        packed = sum(chunk.total_uncompressed_size for chunk in labels)
        if packed > _LABEL_RATIO * size + 2**20:
            raise Harmful(f"{path}: {packed} bytes compressed to {size}; not read")
        for chunk in chunks:
            stored = chunk.compression == "UNCOMPRESSED" and not chunk.has_dictionary_page
            coded = any("DICTIONARY" in encoding for encoding in chunk.encodings)
            if chunk not in labels and (not stored or coded):
                raise Harmful(f"{path}: its images are compressed or coded again; not read")
        known = sum(chunk.total_compressed_size for chunk in chunks) + footer.serialized_size + 12
        return None if known == size else f"{size - known} bytes do not belong to any column"


def batches(path: Path) -> Iterator[pa.RecordBatch]:
    """A Parquet file a few rows at a time; Harmful if it has texts that grow row by row.

    Texts come as dictionaries: a long one that every row repeats is held once.
    """
    schema = pq.read_schema(path)
    texts = [column.name for column in schema if str(column.type) in ("string", "large_string")]
    with pq.ParquetFile(path, read_dictionary=texts, buffer_size=_BUFFER_BYTES) as file:
        for batch in file.iter_batches(batch_size=_BATCH_ROWS, use_threads=False):
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                if not pa.types.is_dictionary(column.type):
                    continue
                longest = pc.max(pc.binary_length(column.dictionary)).as_py() or 0
                if longest > TEXT_BYTES_MAX:
                    raise Harmful(f"{path}: a text of {longest} bytes in {name}; not read")
            yield batch


@contextlib.contextmanager
def limited_memory() -> Iterator[None]:
    """Let this process take `MEMORY_BYTES` more than it has; BadInput where that is too little."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    try:
        with open("/proc/self/statm", encoding="ascii") as stream:
            now = int(stream.read().split()[5]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        yield  # not Linux
        return
    limit = now + MEMORY_BYTES
    if soft != resource.RLIM_INFINITY:
        limit = min(limit, soft)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    try:
        yield
    except MemoryError:
        most = f"{MEMORY_BYTES // 2**20} MiB"
        raise BadInput(f"reading it takes more than {most}; not a release") from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
