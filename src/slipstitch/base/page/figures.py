"""From a matplotlib figure to a page or a file, with one style and reproducible bytes."""

import base64
import functools
import html
import io
import os
import re
from collections.abc import Mapping
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

from slipstitch.base.page.palette import FIXED_IDS, STYLE


def styled(function):
    """Apply the pages' style while a figure is drawn, not only while it is saved."""

    @functools.wraps(function)
    def draw(*arguments, **options):
        with matplotlib.rc_context(STYLE):
            return function(*arguments, **options)

    return draw


def plain_text(words: str) -> str:
    """Words from outside, as a file's name, for a figure: dollars in them begin no formula."""
    return words.replace("$", r"\$")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def legend_above(figure: Figure, lines: Mapping[str, Any], columns: int = 4) -> None:
    """One legend above all panels: names and lines."""
    figure.legend(
        [*lines.values()], [*lines], loc="outside upper center", ncols=columns, frameon=False,
        fontsize=8,
    )  # fmt: skip


def svg(figure: Figure) -> str:
    """A figure in the pages' style as the text of an SVG."""
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def svg_element(figure: Figure, label: str) -> str:
    """A figure as an element of the HTML of a page; screen readers read out `label`."""
    text = svg(figure)
    element = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.S)
    return element.replace("<svg", f'<svg role="img" aria-label="{html.escape(label)}"', 1)


def save_figure(
    figure: Figure, path: str | os.PathLike, kind: str = "png", dots_per_inch: int = 150
) -> None:
    """Write a figure to a file, without date and with fixed ids.

    The kind is png or svg, the resolution of a PNG alone.
    """
    with matplotlib.rc_context(FIXED_IDS):
        figure.savefig(
            path,
            format=kind,
            dpi=dots_per_inch,
            metadata={"Date": None} if kind == "svg" else None,
            facecolor="white",  # viewers may be dark, the ink is
        )


def data_uri(content: bytes | str, kind: str = "image/png") -> str:
    """A picture as a ``data:`` address, so that a page needs no other file."""
    raw = content.encode() if isinstance(content, str) else content
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}"


def svg_uri(content: Figure | str | None) -> str | None:
    """A figure, or the text of an SVG, as a ``data:`` address; None where there is none."""
    if content is None:
        return None
    return data_uri(svg(content) if isinstance(content, Figure) else content, "image/svg+xml")
