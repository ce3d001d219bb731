"""The errors that a user may meet, each shown as one line by the command line."""


class SlipstitchError(Exception):
    """Something went wrong that is not a programming error; exit code 1."""


class BadInput(SlipstitchError):  # noqa: N818 - the name is what the user did, not a fault of ours
    """Input that cannot be used: the message says what, where and what is allowed; exit code 2."""


class NotConverged(SlipstitchError):  # noqa: N818
    """A solver did not reach its tolerance; whatever it had is not a result.

    ``state`` holds arrays to look into where it stood, if there are any.
    """

    def __init__(self, message: str, state: dict | None = None):
        super().__init__(message)
        self.state = state or {}
