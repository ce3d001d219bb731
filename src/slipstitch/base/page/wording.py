"""Formatting of numbers, times and sizes on the pages."""

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from slipstitch.base.errors import BadInput

NONE = "–"  # where there is no number


def number(
    value: float | None,
    spread: float | None = None,
    digits: int = 3,
    scale: float = 1.0,
    unit: str = "",
) -> str:
    """A value, or a mean over seeds ± their standard deviation; a dash where there is none."""
    if value is None:
        return NONE
    beside = "" if spread is None else f" ± {scale * spread:.{digits}f}"
    return f"{scale * value:.{digits}f}{beside}{unit}"


def breaking(score: str) -> str:
    """A score that a narrow column breaks before its spread only."""
    return score.replace(" ", "\N{NO-BREAK SPACE}").replace("\N{NO-BREAK SPACE}±", " ±")


def percent(share: float | None, spread: float | None = None, digits: int = 1) -> str:
    """A share in %; a dash where there is none."""
    return number(share, spread, digits, 100.0, " %")


def quantity(value: float | None, scale: float, unit: str, digits: int = 5) -> str:
    """A number in its unit, to so many significant digits; a dash where there is none."""
    if value is None:
        return NONE
    return f"{value * scale:.{digits}g}{' ' + unit if unit else ''}"


def with_interval(
    value: float, interval: Sequence[float], digits: int = 2, scale: float = 1.0, unit: str = ""
) -> str:
    """An estimate and its interval: 0.12 [0.10, 0.14]."""
    low, high = (f"{scale * end:.{digits}f}" for end in interval)
    return f"{number(value, None, digits, scale, unit)} [{low}, {high}]"


def span(interval: Sequence[float], digits: int = 3) -> str:
    """An interval alone: 0.10 … 0.14."""
    low, high = interval
    return f"{low:.{digits}f} … {high:.{digits}f}"


def duration(seconds: float | None, digits: int = 1) -> str:
    """A time in the unit that reads best; hours always to a tenth.

    A dash for None and what is not a number; `digits` is of seconds and minutes.
    """
    if seconds is None or seconds != seconds:
        return NONE
    if seconds < 100:
        return f"{seconds:.{digits}f} s"
    if seconds < 100 * 60:
        return f"{seconds / 60:.{digits}f} min"
    return f"{seconds / 3600:.1f} h"


def size(size_bytes: float) -> str:
    """A size in the unit that reads best, to three significant digits."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size_bytes >= scale:
            return f"{size_bytes / scale:.3g} {unit}"
    return f"{size_bytes / 1e3:.3g} kB"


def counted(count: int, word: str) -> str:
    """A number with its noun, thousands set apart by a narrow space."""
    return f"{count:,} {word}{'' if count == 1 else 's'}".replace(",", "\u202f")


def seeds_in_words(count: int) -> str:
    """The number of trainings averaged in a score."""
    return "one seed only" if count == 1 else f"{count} seeds"


def yes_or_no(value: float | None) -> str:
    """A truth value that came as a number."""
    return NONE if value is None else ("yes" if value else "no")


def time_of_making() -> datetime:
    """Now (UTC), or ``SOURCE_DATE_EPOCH``, as reproducible builds set it.

    BadInput if that is no number of seconds.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if not epoch:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(epoch), UTC)
    except (ValueError, OverflowError, OSError):
        raise BadInput(f"SOURCE_DATE_EPOCH={epoch}: must be a number of seconds") from None


def shortened(text: str, most: int) -> str:
    """A text of at most `most` characters, its end left out where it is longer."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def evenly(items: Sequence[Any], most: int = 6) -> list[Any]:
    """At most that many items, 2 at least, evenly spread with both ends."""
    if len(items) <= most:
        return list(items)
    return [items[round(index * (len(items) - 1) / (most - 1))] for index in range(most)]


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of a table for a terminal: the first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (zip(row[1:], widths[1:], strict=True) for row in rows)
    others = ("".join(f"  {cell:>{wide}}" for cell, wide in line) for line in lines)
    return [f"{row[0]:<{widths[0]}}{rest}" for row, rest in zip(rows, others, strict=True)]
