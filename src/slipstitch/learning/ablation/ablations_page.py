"""The page of the ablations: conclusions, a plot and a table per question."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, styled, svg_uri
from slipstitch.base.page.palette import BAD, FAINT, GOOD, PALE, SOFT
from slipstitch.base.page.templates import render
from slipstitch.learning.evaluation.metrics import TEST_SETS, metrics_of

_TEMPLATE = Path(__file__).with_name("ablations.html.j2")
_COLOURS = {"better": GOOD, "worse": BAD, "no significant difference": SOFT, "nothing learnt": PALE}


def ablations_page(summary: Mapping[str, Any]) -> str:
    """The page as HTML; it needs no other file.

    Parameters
    ----------
    summary : mapping
        What `slipstitch.learning.ablation.summary.summarise` returned.
    """
    questions = summary["questions"].items()
    answered = {name: question for name, question in questions if not question["left_out"]}
    return render(
        _TEMPLATE,
        level=f"{100 * summary['level']:.0f} %",
        seeds=summary["seeds"],
        comparisons=summary["comparisons"],
        by_chance=(1 - summary["level"]) * summary["comparisons"],
        questions=answered,
        columns=metrics_of(TEST_SETS, "friction"),
        pictures={
            name: svg_uri(_picture(question["comparisons"])) for name, question in answered.items()
        },
        left_out=[question["left_out"] for _, question in questions if question["left_out"]],
    )


@styled
def _picture(comparisons: list[Mapping[str, Any]]) -> Figure | None:
    """Differences of the mean error as dots with their intervals; None without any."""
    shown = [comparison for comparison in comparisons if comparison["low"] is not None]
    if not shown:
        return None
    names = [
        f"{comparison['variant']} − {comparison['reference']}\n"
        f"{comparison['network']}, {comparison['tested_on']}"
        for comparison in shown
    ]
    figure = new_figure(7.6, 0.8 + 0.5 * len(shown))
    axes = figure.subplots()
    axes.axvline(0, color=FAINT, lw=0.9)
    for place, comparison in enumerate(shown):
        colour = _COLOURS[comparison["verdict"]]
        axes.plot([comparison["low"], comparison["high"]], [place, place], color=colour, lw=2)
        axes.plot(comparison["difference"], place, "o", color=colour, ms=6)
    axes.set_yticks(range(len(shown)), names)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    ends = [abs(comparison[end]) for comparison in shown for end in ("low", "high")]
    reach = max(1.1 * max(ends), 1e-3)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("difference of the mean error of µ;  negative: better")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    return figure
