"""Pages of a measurement: one video's frames, weights, distribution; or repeats of a pair."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slipstitch.base.page.figures import new_figure, plain_text, png_uri, styled, svg_element
from slipstitch.base.page.palette import BLUE, INK, SOFT, VERMILION
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import number, percent, span
from slipstitch.film.measure.measuring_bench import MeasuredVideo
from slipstitch.images.camera import POSE
from slipstitch.images.encoding import encode_png
from slipstitch.learning.instrument.poses import in_words

if TYPE_CHECKING:
    from slipstitch.film.measure.measurement_files import MeasuredPair

_OF_ONE, _OF_REPEATS = (
    Path(__file__).with_name(f"{name}.html.j2") for name in ("measurement", "repeats")
)
_SIDE = 112  # pixels of a frame on the page
_DECISIVE = 5
_RING = tuple(bytes.fromhex(VERMILION.removeprefix("#")))
_WIDTH, _HEIGHT = 920, 190


def _frames(result: MeasuredVideo) -> list[dict]:
    """Every frame with its weight in the decision."""
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
    ]


def measurement_page(result: MeasuredVideo, known: dict[str, Any] | None = None) -> str:
    """The page as HTML; it needs no other file.

    Parameters
    ----------
    known : dict, optional
        Of the example: the true fabric, substrate and friction.
    """
    measured, video, trained = result.measurement, result.video, result.pose_range
    weights = np.asarray(measured.attention_weights, dtype=float)
    frames = _frames(result)
    materials = sorted(measured.material_probabilities.items(), key=lambda item: -item[1])
    return render(
        _OF_ONE,
        name=result.name,
        mu=number(measured.friction_coefficient),
        uncertainty=number(result.uncertainty),
        interval=span(measured.interval_90),
        without_error_bar=result.without_error_bar,
        notes=result.notes,
        materials=materials,
        alarm=result.alarm_reason,
        frames=frames,
        decisive=[frame["time"] for frame in frames if frame["decisive"]],
        distribution=_distribution(result, known),
        known=known,
        timeline=_timeline(result, weights),
        start=video.start,
        video=video,
        instrument=result.instrument[:12],
        poses=[in_words(one, video.pose[one], trained[one]) for one in POSE] if trained else [],
        floors=result.floors,
        rings=result.keypoints_px is not None,
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
    return png_uri(encode_png(large))


def _points(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def _distribution(result: MeasuredVideo, known: dict[str, Any] | None) -> dict:
    """The distribution over friction as the corners of a shape, in a box of 920 x 190."""
    grid, probability = map(np.asarray, result.measurement.distribution)
    lowest, highest = float(grid[0]), float(grid[-1])

    def across(mu):
        return 20 + (np.asarray(mu) - lowest) / (highest - lowest) * (_WIDTH - 40)

    height = _HEIGHT - 30 - probability / probability.max() * (_HEIGHT - 55)
    x = across(grid)
    shape = _points(
        np.concatenate([x[:1], x, x[-1:]]), np.concatenate([[_HEIGHT - 30], height, [_HEIGHT - 30]])
    )
    ticks = [t for t in np.arange(0, highest + 1e-9, 0.1 if highest < 1.2 else 0.2) if t >= lowest]
    low, high = across(result.measurement.interval_90)
    return {
        "shape": shape,
        "true": f"{across(known['friction']):.1f}" if known else None,
        "median": f"{across(result.measurement.friction_coefficient):.1f}",
        "low": f"{low:.1f}",
        "width": f"{max(high - low, 1.0):.1f}",
        "ticks": [(f"{across(tick):.1f}", f"{tick:.1f}") for tick in ticks],
    }


def _timeline(result: MeasuredVideo, weights: np.ndarray) -> dict:
    """The stage's path over time, and one disc per frame as large as its weight."""
    path, video = result.stage_path, result.video
    end_s = float(video.time_s[-1]) or 1.0

    def across(time_s):
        return 20 + np.asarray(time_s) / end_s * (_WIDTH - 40)

    time_s = np.linspace(0, end_s, 400)
    x_m, z_m = path.position_m(time_s)
    at_m, _ = path.position_m(np.maximum(video.time_s, 0))

    def up(place_m):
        return _HEIGHT - 35 - np.asarray(place_m) / path.stroke_m * (_HEIGHT - 60)

    radius = 14 * np.sqrt(weights / max(weights.max(), 1e-9))
    step = 10 if end_s > 60 else 5
    return {
        "x": _points(across(time_s), up(x_m)),
        "z": _points(across(time_s), up(z_m)),
        "discs": [
            (f"{a:.1f}", f"{b:.1f}", f"{max(r, 1.0):.1f}")
            for a, b, r in zip(across(np.maximum(video.time_s, 0)), up(at_m), radius, strict=True)
        ],
        "ticks": [(f"{across(t):.1f}", f"{t:g}") for t in np.arange(0, end_s + 1e-9, step)],
    }


def repeats_page(pair: "MeasuredPair") -> str:
    """The page as HTML; it needs no other file."""
    together = pair.together
    return render(
        _OF_REPEATS,
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
                "frames": [frame for frame in _frames(video) if frame["decisive"]],
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
