"""Measurements as files: all numbers, a table, the page of one video, of a pair, of all pairs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import data_uri, new_figure, plain_text, styled, svg_element
from slipstitch.base.page.palette import BLUE, FRAME, INK, INTERVAL, SOFT, VERMILION
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import percent, span
from slipstitch.base.provenance import provenance_record, write_json, write_text
from slipstitch.film.measure import truth_of
from slipstitch.film.measure.measurements import MeasuredCaptures, MeasuredPair
from slipstitch.film.measure.measuring_bench import MeasuredVideo
from slipstitch.images.encoding import encode_png
from slipstitch.learning.instrument.poses import TITLES, shown

_OF_ONE, _OF_REPEATS, _OF_CAPTURES = (
    Path(__file__).with_name(f"{name}.html.j2") for name in ("measurement", "repeats", "captures")
)
_SIDE = 112  # pixels of a frame on the page
_DECISIVE = 5
_RING = tuple(bytes.fromhex(VERMILION.removeprefix("#")))


def write_measurements(
    result: MeasuredPair | MeasuredCaptures,
    read: Sequence[Path],
    started: tuple[float, float],
    *,
    page_path: Path | None,
    numbers_path: Path | None,
    table_path: Path | None,
) -> None:
    """Write what is asked for (HTML, JSON, CSV), with its provenance beside it.

    `read` are the videos, the camera files and the instrument's configuration, for the record.
    """
    if not (page_path or numbers_path or table_path):
        return
    inputs = [path for path in read if Path(path).is_file()]
    record = provenance_record("measure", inputs=inputs, started=started)
    record["instrument"] = result.videos[0].instrument
    if page_path:
        write_text(page_path, _page(result), record)
    if numbers_path:
        write_json(numbers_path, result.numbers(), record)
    if table_path:
        write_text(table_path, result.table(), record)


def _page(result: MeasuredPair | MeasuredCaptures) -> str:
    if isinstance(result, MeasuredCaptures):
        return captures_page(result)
    return repeats_page(result) if result.count > 1 else measurement_page(result.videos[0])


def _frames(result: MeasuredVideo, decisive_alone: bool = False) -> list[dict]:
    """Every frame with its weight in the decision, or the decisive ones alone."""
    video = result.video
    weights = np.asarray(result.measurement.attention_weights, dtype=float)
    ranks = np.argsort(-weights, kind="stable")[:_DECISIVE]
    keypoints_px = [None] * len(weights) if result.keypoints_px is None else result.keypoints_px
    return [
        {
            "image": _enlarged(image, points),
            "time": f"{max(time_s, 0):.1f} s",
            "weight": percent(weight),
            "bar": f"{100 * weight / max(weights.max(), 1e-9):.1f}",
            "decisive": k in ranks,
        }
        for k, (image, time_s, weight, points) in enumerate(
            zip(video.frames, video.time_s, weights, keypoints_px, strict=True)
        )
        if k in ranks or not decisive_alone
    ]


def measurement_page(result: MeasuredVideo) -> str:
    """The page as HTML; of the example also what is known: fabric, substrate and friction."""
    known = truth_of(result.path)
    weights = np.asarray(result.measurement.attention_weights, dtype=float)
    materials = result.measurement.material_probabilities
    shape = svg_element(_distribution(result, known), "Distribution of the friction coefficient")
    path = svg_element(_timeline(result, weights), "Path of the stage and weight of each frame")
    return render(
        _OF_ONE,
        result=result,
        measured=result.measurement,
        video=result.video,
        bench=result.bench,
        materials=sorted(materials.items(), key=lambda item: -item[1]),
        frames=_frames(result),
        distribution=shape,
        timeline=path,
        known=known,
        titles=TITLES,
        shown=shown,
        span=span,
    )


def _enlarged(image: np.ndarray, keypoints_px: np.ndarray | None) -> str:
    """A frame as large as the page shows it, with a ring around each keypoint."""
    side = max(_SIDE, len(image))
    large = cv2.resize(image, (side, side), interpolation=cv2.INTER_CUBIC)
    for x, y in () if keypoints_px is None else (keypoints_px + 0.5) * (side / len(image)) - 0.5:
        if not (0 <= x < side and 0 <= y < side):
            continue
        centre = round(16 * float(x)), round(16 * float(y))  # in sixteenths of a pixel
        cv2.circle(large, centre, 2 * 16, _RING, 1, cv2.LINE_AA, 4)
    return data_uri(encode_png(large))


@styled
def _distribution(result: MeasuredVideo, known: dict[str, Any] | None) -> Figure:
    """The distribution over friction, its interval and median; the true value of the example."""
    measured, figure = result.measurement, new_figure(9.2, 1.9)
    axes = figure.subplots()
    grid, probability = map(np.asarray, measured.distribution)
    axes.axvspan(*measured.interval_90, color=INTERVAL, lw=0)
    axes.fill_between(grid, probability, color=BLUE, alpha=0.55, lw=0)
    axes.axvline(measured.friction_coefficient, color=INK, lw=1.5)
    if known:
        axes.axvline(known["friction"], color=VERMILION, lw=2, ls="--")
    axes.set(xlim=(grid[0], grid[-1]), ylim=(0, None), yticks=[])
    axes.spines["left"].set_visible(False)
    return figure


@styled
def _timeline(result: MeasuredVideo, weights: np.ndarray) -> Figure:
    """The stage's path over time, and one disc per frame whose area is its weight."""
    path, seen_s = result.bench.schedule.path, np.maximum(result.video.time_s, 0)
    figure = new_figure(9.2, 1.9)
    axes = figure.subplots()
    time_s = np.linspace(0, seen_s[-1] or 1.0, 400)
    for place_m, colour in zip(path.position_m(time_s), (INK, FRAME), strict=True):
        axes.plot(time_s, place_m, color=colour, lw=1.5)
    areas = np.maximum(400 * weights / max(weights.max(), 1e-9), 3)
    axes.scatter(seen_s, path.position_m(seen_s)[0], areas, VERMILION, alpha=0.6, linewidths=0)
    axes.margins(y=0.15)
    axes.set(yticks=[])
    axes.spines["left"].set_visible(False)
    return figure


def repeats_page(pair: MeasuredPair) -> str:
    """The page as HTML; it needs no other file."""
    return render(
        _OF_REPEATS,
        pair=pair,
        figure=svg_element(_figure(pair), "Friction of each video with its interval"),
        rows=[(video, _frames(video, decisive_alone=True)) for video in pair.videos],
        span=span,
    )


def _short(name: str, most: int = 28) -> str:
    """The end of a long name: that is where repeats differ."""
    return name if len(name) <= most else f"…{name[1 - most :]}"


@styled
def _figure(pair: MeasuredPair):
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


def captures_page(captures: MeasuredCaptures) -> str:
    """The page of all pairs of a table as HTML; it needs no other file."""
    title = "Friction of each pair with its interval, and the reference where there is one"
    figure = svg_element(_pairs_figure(captures), title)
    return render(_OF_CAPTURES, captures=captures, figure=figure, span=span)


@styled
def _pairs_figure(captures: MeasuredCaptures) -> Figure:
    """Every pair's combined interval, one below the other, beside its reference."""
    figure = new_figure(8.6, 0.9 + 0.3 * len(captures.pairs))
    axes = figure.subplots()
    for place, (row, pair) in enumerate(captures.pairs.items()):
        if together := pair.together:
            if not pair.without_error_bar:
                axes.plot(together.interval_90, [place, place], color=SOFT, lw=2)
            axes.plot(together.friction_coefficient, place, "o", color=INK, ms=5)
        if row.reference:
            mu, error = row.mu_ref, row.mu_ref_error
            axes.errorbar(mu, place + 0.25, xerr=error, fmt="D", color=VERMILION, ms=4)
    titles = [plain_text(_short(row.title, 40)) for row in captures.pairs]
    axes.set_yticks(range(len(titles)), titles)
    axes.set_ylim(len(captures.pairs) - 0.5, -0.5)
    axes.set_xlabel("friction coefficient")
    return figure
