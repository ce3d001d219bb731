"""User-facing errors, each shown as one line by the command line."""

import errno
import os
import shlex


class SlipstitchError(Exception):
    """Something went wrong that is not a programming error; exit code 1."""


class BadInput(SlipstitchError):  # noqa: N818 - the name is what the user did, not a fault of ours
    """Input that cannot be used: the message says what, where and what is allowed; exit code 2."""


class Damaged(BadInput):
    """A file that is damaged or altered, for a reason; the message says how to regenerate it."""

    def __init__(self, path: str | os.PathLike, reason: str):
        path, again = os.fspath(path), ""
        if os.path.normpath(path).split(os.sep)[0] == "results":
            again = f"; regenerate it with: snakemake --cores 2 all --forcerun {shlex.quote(path)}"
        super().__init__(f"{path}: {reason}{again}")


class NotConverged(SlipstitchError):  # noqa: N818
    """A solver did not reach its tolerance; whatever it had is not a result.

    ``state`` holds arrays to look into where it stood, if there are any.
    """

    def __init__(self, message: str, state: dict | None = None):
        super().__init__(message)
        self.state = state or {}


def first_line(error: BaseException) -> str:
    """The first line of an error's message; its kind if it has none."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


# What the machine refuses, whatever the program: told in one line, without a traceback.
_OF_THE_MACHINE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.ENAMETOOLONG}
_OF_THE_MACHINE |= {errno.EACCES, errno.EPERM, errno.EIO, errno.EMFILE, errno.ENOMEM}
# The words of libraries whose exceptions have no code.
_OF_DISK = ("no space left on device", "os error 28")
_OF_MEMORY = ("allocate memory", "failed to allocate", "bad_alloc", "insufficient memory")


def refused_by_the_machine(error: BaseException) -> str | None:
    """The failure of the machine (disk, memory, permission) that caused an error, if any."""
    words = str(error).lower()
    code = error.errno if isinstance(error, OSError) else None
    if isinstance(error, MemoryError) or any(text in words for text in _OF_MEMORY):
        code = errno.ENOMEM
    elif any(text in words for text in _OF_DISK):
        code = errno.ENOSPC
    if code is None or code not in _OF_THE_MACHINE:
        return None
    path = getattr(error, "filename", None)
    words = os.strerror(code).lower() + (f": {path}" if path else "")
    if f"{os.sep}.cache" in str(path) and "XDG_CACHE_HOME" not in os.environ:
        words += " (set XDG_CACHE_HOME to a folder that can be written)"
    return words
