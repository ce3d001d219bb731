"""Numbers as the pages show them, with their spread over seeds where there is one."""


def percent(share: float | None, spread: float | None = None, digits: int = 1) -> str:
    """A share in %; a dash where there is none."""
    return number(share, spread, digits, 100.0, " %")


def number(
    value: float | None,
    spread: float | None = None,
    digits: int = 3,
    scale: float = 1.0,
    unit: str = "",
) -> str:
    """A value, or a mean over seeds ± their standard deviation; a dash where there is none."""
    if value is None:
        return "–"
    beside = "" if spread is None else f" ± {scale * spread:.{digits}f}"
    return f"{scale * value:.{digits}f}{beside}{unit}"


def seeds_in_words(count: int) -> str:
    """How many trainings a score is the mean of."""
    return "one seed only" if count == 1 else f"{count} seeds"
