"""The page of the ablations: a sentence, a picture and a table a question."""

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

from slipstitch import __version__

_COLOURS = {
    "better": "#00795a",
    "worse": "#b3470b",
    "not told apart": "#5b5e63",
    "nothing learnt": "#b9bcc0",
}


def ablations_page(summary: Mapping[str, Any]) -> str:
    """The page as HTML; it needs no other file.

    Parameters
    ----------
    summary : mapping
        What `slipstitch.ablate.summary.summarise` returned.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    answered = {name: one for name, one in summary["questions"].items() if not one["left_out"]}
    return environment.get_template("ablations.html.j2").render(
        version=__version__,
        level=f"{100 * summary['level']:.0f} %",
        seeds=summary["seeds"],
        comparisons=summary["comparisons"],
        by_chance=(1 - summary["level"]) * summary["comparisons"],
        questions=answered,
        pictures={name: _picture(one["comparisons"]) for name, one in answered.items()},
        left_out=[one["left_out"] for one in summary["questions"].values() if one["left_out"]],
        percent=lambda row, name: _with_spread(row, name, "{:.0f}", 100),
        number=lambda row, name: _with_spread(row, name, "{:.3f}", 1),
    )


def _with_spread(row: Mapping[str, Any], name: str, form: str, scale: float) -> str:
    if row["mean"] is None:
        return "–"
    said = form.format(scale * row["mean"][name])
    if row["spread"] is not None:
        said += f" ± {form.format(scale * row['spread'][name])}"
    return said


def _picture(comparisons: list[Mapping[str, Any]]) -> str | None:
    """Differences of the mean error as dots with their intervals, in SVG; None without any."""
    shown = [one for one in comparisons if one["low"] is not None]
    if not shown:
        return None
    names = [
        f"{one['variant']} − {one['reference']}\n{one['network']}, {one['tested_on']}"
        for one in shown
    ]
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch", "font.size": 9}):
        figure = Figure(figsize=(7.6, 0.8 + 0.5 * len(shown)), layout="constrained")
        axes = figure.subplots()
        axes.axvline(0, color="#8c8c8c", lw=0.9)
        for place, one in enumerate(shown):
            colour = _COLOURS[one["verdict"]]
            axes.plot([one["low"], one["high"]], [place, place], color=colour, lw=2)
            axes.plot(one["difference"], place, "o", color=colour, ms=6)
        axes.set_yticks(range(len(shown)), names)
        axes.set_ylim(len(shown) - 0.5, -0.5)
        reach = 1.1 * max(abs(end) for one in shown for end in (one["low"], one["high"]))
        axes.set_xlim(-max(reach, 1e-3), max(reach, 1e-3))
        axes.set_xlabel("difference of the mean error of μ;  left of 0: better")
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue().encode()).decode()}"
