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
        path = os.fspath(path)
        again = ""
        if not os.path.isabs(path) and os.path.normpath(path).split(os.sep)[0] == "results":
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
_OF_THE_MACHINE = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is exceeded",
    errno.EFBIG: "the file would exceed the size limit",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "permission denied",
    errno.EPERM: "not permitted",
    errno.EIO: "disk I/O error",
    errno.EMFILE: "too many open files",
    errno.ENOMEM: "out of memory",
    errno.ENAMETOOLONG: "file name too long",
}
# The words of libraries whose exceptions have no code.
_WORDS_OF_THE_MACHINE = {
    "No space left on device": errno.ENOSPC,
    "os error 28": errno.ENOSPC,
    "can't allocate memory": errno.ENOMEM,
    "failed to allocate": errno.ENOMEM,
    "bad_alloc": errno.ENOMEM,
    "Cannot allocate memory": errno.ENOMEM,
    "Insufficient memory": errno.ENOMEM,
}


def refused_by_the_machine(error: BaseException) -> str | None:
    """The failure of the machine (disk, memory, permission) that caused an error, if any."""
    code = error.errno if isinstance(error, OSError) else None
    if isinstance(error, MemoryError):
        code = errno.ENOMEM
    if code not in _OF_THE_MACHINE:
        words = str(error).lower()
        found = (known for text, known in _WORDS_OF_THE_MACHINE.items() if text.lower() in words)
        code = next(found, None)
    if code is None:
        return None
    path = getattr(error, "filename", None)
    words = _OF_THE_MACHINE[code] + (f": {path}" if path else "")
    if f"{os.sep}.cache" in str(path) and "XDG_CACHE_HOME" not in os.environ:
        words += " (set XDG_CACHE_HOME to a folder that can be written)"
    return words
