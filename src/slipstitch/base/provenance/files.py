"""Atomically written files and their digests."""

import contextlib
import fcntl
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

SUFFIX = ".tmp"
YOUNG_S = 3600.0


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name when the block ends well.

    On an exception whatever was written (file or folder) is removed and `path` is left as it was.
    The temporary name keeps the suffix of `path`, because many writers choose a format by it.
    The content is flushed to the disk before the renaming, so that a crash leaves the old file or
    the new one, never half of one. Missing parent folders are created. What a killed process left
    of an earlier attempt at the same name is removed.

    Parameters
    ----------
    path : path
        Where the finished file shall be. A folder replaces an existing folder as a whole.

    Yields
    ------
    pathlib.Path
        The path to write to.

    Raises
    ------
    FileNotFoundError
        If the block ended well but wrote nothing.
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
        prefix=f".{final.stem}.", suffix=SUFFIX, dir=final.parent, ignore_cleanup_errors=True
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
        if not (entry.name.startswith(f".{final.stem}.") and entry.name.endswith(SUFFIX)):
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
