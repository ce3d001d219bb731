"""Files that are there completely or not at all, and their digests."""

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name when the block ends well.

    On an exception whatever was written (file or folder) is removed and `path` is left as it was.
    The temporary name keeps the suffix of `path`, because many writers choose a format by it.
    The content is flushed to the disk before the renaming, so that a crash leaves the old file or
    the new one, never half of one. Missing parent folders are created.

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
    with tempfile.TemporaryDirectory(
        prefix=f".{final.stem}.", suffix=".tmp", dir=final.parent
    ) as d:
        temporary = Path(d) / final.name
        yield temporary
        if not temporary.exists():
            raise FileNotFoundError(f"nothing was written for {final}")
        if temporary.is_dir():
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _flush(file)
            if final.is_dir() and not final.is_symlink():
                shutil.rmtree(final)
        else:
            _flush(temporary)
        os.replace(temporary, final)
        _flush(final.parent)


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
