"""Instrument: friction from a video, with an error bar and an alarm."""

_MEASURING = ("Instrument", "Measurement", "load_instrument")


def __getattr__(name: str):
    """The names above when they are asked for: the settings beside them must not need torch."""
    if name not in _MEASURING:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from slipstitch.learning.instrument import measuring

    return getattr(measuring, name)
