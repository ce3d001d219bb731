"""The errors that a user may meet, each shown as one line by the command line."""

import os
import shlex


class SlipstitchError(Exception):
    """Something went wrong that is not a programming error; exit code 1."""


class BadInput(SlipstitchError):  # noqa: N818 - the name is what the user did, not a fault of ours
    """Input that cannot be used: the message says what, where and what is allowed; exit code 2."""


class Damaged(BadInput):
    """A file that is not as it was written; says how to make it anew.

    Parameters
    ----------
    path : path
        The file.
    reason : str
        What is wrong with it.
    """

    def __init__(self, path: str | os.PathLike, reason: str):
        path = os.fspath(path)
        again = ""
        if not os.path.isabs(path) and os.path.normpath(path).split(os.sep)[0] == "results":
            again = f"; make it anew with: snakemake --cores 2 all --forcerun {shlex.quote(path)}"
        super().__init__(f"{path}: {reason}{again}")


class NotConverged(SlipstitchError):  # noqa: N818
    """A solver did not reach its tolerance; whatever it had is not a result.

    ``state`` holds arrays to look into where it stood, if there are any.
    """

    def __init__(self, message: str, state: dict | None = None):
        super().__init__(message)
        self.state = state or {}
