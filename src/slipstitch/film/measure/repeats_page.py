"""The page of several videos of one pair: every interval, the combined one, what was seen."""

from pathlib import Path
from typing import TYPE_CHECKING

from slipstitch.base.page.figures import new_figure, plain_text, styled, svg_element
from slipstitch.base.page.palette import BLUE, INK, SOFT, VERMILION
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import number, percent, span
from slipstitch.film.measure.measurement_page import decisive_frames

if TYPE_CHECKING:
    from slipstitch.film.measure.measurement_files import MeasuredPair

_TEMPLATE = Path(__file__).with_name("repeats.html.j2")


def page(pair: "MeasuredPair") -> str:
    """The page as HTML; it needs no other file."""
    together = pair.together
    return render(
        _TEMPLATE,
        pair=pair,
        mu=number(together.friction_coefficient) if together else None,
        error_bar=pair.without_error_bar
        or (f"90 % interval {span(together.interval_90)}" if together else None),
        outliers=pair.names(pair.outliers),
        scatter=number(together.scatter) if together else None,
        figure=svg_element(_figure(pair), "Friction of each video with its interval"),
        rows=[
            {
                "name": video.name,
                "mu": number(video.measurement.friction_coefficient),
                "interval": video.without_error_bar or span(video.measurement.interval_90),
                "fabric": f"{video.fabric[0]} ({percent(video.fabric[1], digits=0)})",
                "alarm": video.alarm_reason,
                "notes": video.notes,
                "frames": decisive_frames(video),
            }
            for video in pair.videos
        ],
        instrument=pair.videos[0].instrument[:12],
    )


def _short(name: str, most: int = 28) -> str:
    """The end of a long name: that is where repeats differ."""
    return name if len(name) <= most else f"…{name[1 - most :]}"


@styled
def _figure(pair: "MeasuredPair"):
    """Every video's interval, one below the other, and the combined one."""
    figure = new_figure(8.6, 0.9 + 0.3 * len(pair.videos))
    axes = figure.subplots()
    for row, video in enumerate(pair.videos):
        measured = video.measurement
        stray = video.alarm_reason or row in pair.outliers
        if not pair.without_error_bar:
            axes.plot(measured.interval_90, [row, row], color=VERMILION if stray else SOFT, lw=2)
        axes.plot(measured.friction_coefficient, row, "o", color=VERMILION if stray else INK, ms=5)
    if pair.together:
        if not pair.without_error_bar:
            axes.axvspan(*pair.together.interval_90, color=BLUE, alpha=0.18, lw=0)
        axes.axvline(pair.together.friction_coefficient, color=BLUE, lw=1.5)
    names = [video.name for video in pair.videos]
    short = [_short(name) for name in names]
    shown = short if len(set(short)) == len(names) else names
    axes.set_yticks(range(len(names)), map(plain_text, shown))
    axes.invert_yaxis()
    axes.set_xlabel("friction coefficient")
    return figure
