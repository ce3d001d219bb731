"""Numbers, times and pictures as the page shows them."""

import base64
from collections.abc import Sequence
from typing import Any


def data_uri(content: bytes | str, kind: str) -> str:
    """A picture as a ``data:`` address, so that the page needs no other file."""
    raw = content.encode() if isinstance(content, str) else content
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}"


def svg_uri(content: str | None) -> str | None:
    """An SVG as a ``data:`` address; None where there is none."""
    return None if content is None else data_uri(content, "image/svg+xml")


def evenly(items: Sequence[Any], most: int) -> list[Any]:
    """At most that many items, evenly from first to last.

    Parameters
    ----------
    items : sequence
    most : int
        At least 2 if there are more items than that.
    """
    if len(items) <= most:
        return list(items)
    return [items[round(index * (len(items) - 1) / (most - 1))] for index in range(most)]


def duration(seconds: float | None) -> str:
    """A time in the unit that reads best."""
    if seconds is None or seconds != seconds:
        return "–"
    if seconds < 100:
        return f"{seconds:.1f} s"
    if seconds < 100 * 60:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def counted(number: int, word: str) -> str:
    """A number with its noun."""
    return f"{number:,} {word}{'' if number == 1 else 's'}".replace(",", "\u202f")


def in_words(value: float | None) -> str:
    """A truth value that came as a number."""
    return "–" if value is None else ("yes" if value else "no")


def quantity(value: float | None, scale: float, unit: str, digits: int = 5) -> str:
    """A number in its unit; a dash where there is none."""
    if value is None:
        return "–"
    return f"{value * scale:.{digits}g}{' ' + unit if unit else ''}"
