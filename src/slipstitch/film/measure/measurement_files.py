"""Measurements of repeats together, and as files: the page, all numbers, a table."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, provenance_record, write_json, write_text
from slipstitch.film.csv_table import FORMULA
from slipstitch.film.measure import truth_of
from slipstitch.film.measure.measuring_bench import MeasuredVideo, MeasuringBench
from slipstitch.film.measure.pages import measurement_page, repeats_page
from slipstitch.learning.instrument.measuring import COVERAGE, HALF_WIDTH
from slipstitch.learning.prediction import Prediction

FEWEST_FOR_OUTLIERS = 3
OUTLIER_CHANCE = 0.05  # of naming any video of a pair, where none is an outlier


@dataclass(frozen=True)
class Repeats:
    """Combined result of n videos of one pair."""

    friction_coefficient: float  # mean over the videos
    interval_90: tuple[float, float]  # (low, high), within the instrument's grid
    scatter: float  # standard deviation between the videos (posterior median); NaN for one video
    # videos that the others did not lead one to expect; they count in the mean all the same
    outliers: list[int]


def combined(
    friction: Sequence[float],
    intervals_90: Sequence[tuple[float, float]],
    ends: tuple[float, float],
) -> Repeats:
    """Combine medians and 90 % intervals of n videos of one pair of fabric and substrate.

    A video's error has two parts. One is shared by all videos of the pair (the fabric, the camera,
    what the instrument learnt) and stays however many are filmed; the other differs from video to
    video and averages out. The instrument states the whole, s; the scatter between videos tells the
    second, v. The pair's coefficient is then the mean of n videos with variance
    max(s² - v², 0) + v² / n, averaged over what is not known of v (prior 1 / (s + v): flat below s,
    without a scale above). The halves of the interval below and above the median have an s each.
    `ends` are those of the instrument's grid of mu, to which its intervals are clipped.
    """
    values, intervals = np.asarray(friction, float), np.asarray(intervals_90, float)
    mean = float(values.mean())
    if len(values) == 1:
        low, high = intervals[0]
        return Repeats(mean, (float(low), float(high)), float("nan"), [])
    deviations = _deviations(values, intervals, ends)
    if not np.isfinite(deviations).all():  # a video without an error bar
        return Repeats(mean, (float(ends[0]), float(ends[1])), float(values.std(ddof=1)), [])
    scatter, weights = _scatter(values, _root_mean_square(deviations.mean(axis=1)))
    below, above = (
        _quantile(
            np.sqrt(np.maximum(stated**2 - scatter**2, 0) + scatter**2 / len(values)),
            weights,
            COVERAGE,
        )
        for stated in map(_root_mean_square, deviations.T)
    )
    order = np.cumsum(weights)
    return Repeats(
        mean,
        (max(mean - below, float(ends[0])), min(mean + above, float(ends[1]))),
        float(np.interp(0.5, order, scatter)),
        _outliers(values, deviations) if len(values) >= FEWEST_FOR_OUTLIERS else [],
    )


def _deviations(values: np.ndarray, intervals: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Standard deviations below and above each median that the halves imply, shape (n, 2).

    A half that an end of the grid cuts off is at least as long as the other one; infinite where
    both are cut off.
    """
    halves = np.abs(intervals - values[:, None])
    cut = np.abs(intervals - np.asarray(ends)) < 1e-9
    longest = np.where(cut.all(axis=1), np.inf, halves.max(axis=1))
    return np.where(cut, longest[:, None], halves) / HALF_WIDTH


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _scatter(values: np.ndarray, stated: float) -> tuple[np.ndarray, np.ndarray]:
    """Posterior of the standard deviation between videos: grid and weights, sum 1."""
    squares = float(((values - values.mean()) ** 2).sum())
    grid = np.geomspace(stated / 50, max(20 * stated, 20 * np.sqrt(squares)), 120)
    # Restricted likelihood, prior, and the grid's logarithmic spacing.
    log_weight = (
        -(len(values) - 1) * np.log(grid)
        - squares / (2 * grid**2)
        - np.log1p(grid / stated)
        + np.log(grid)
    )
    weights = np.exp(log_weight - log_weight.max())
    return grid, weights / weights.sum()


def _quantile(deviations: np.ndarray, weights: np.ndarray, coverage: float) -> float:
    """Half-width that a mixture of centred normal distributions keeps within by `coverage`."""
    if not deviations.max() > 0:
        return 0.0
    return float(
        brentq(
            lambda half: float((2 * ndtr(half / deviations) - 1) @ weights) - coverage,
            0.0,
            deviations.max() * 6,
            xtol=1e-6,
        )
    )


def _outliers(values: np.ndarray, deviations: np.ndarray) -> list[int]:
    """Videos further from the mean of the others than a new video would be."""
    found = []
    for number, value in enumerate(values):
        others = np.delete(values, number)
        stated = _root_mean_square(np.delete(deviations, number, axis=0).mean(axis=1))
        scatter, weights = _scatter(others, stated)
        spread = scatter * np.sqrt(1 + 1 / len(others))
        if abs(value - others.mean()) > _quantile(
            spread, weights, 1 - OUTLIER_CHANCE / len(values)
        ):
            found.append(number)
    return found


COLUMNS = (
    *("video", "friction_coefficient", "interval_90_low", "interval_90_high"),
    *("fabric", "fabric_probability", "alarm", "outlier", "scatter", "notes"),
)
COMBINED = "combined"  # the name of the last row


@dataclass(frozen=True)
class MeasuredPair:
    """Videos of one pair of fabric and substrate."""

    videos: list[MeasuredVideo]  # at least one; no two have the same name
    refused: dict[str, str]  # name of each of the other videos -> why it could not be measured

    @cached_property
    def used(self) -> list[int]:
        """Which videos raised no alarm: the combined value rests on them."""
        return [index for index, video in enumerate(self.videos) if not video.alarm_reason]

    @property
    def without_error_bar(self) -> str:
        """Why the instrument states no interval; empty where it does."""
        return self.videos[0].without_error_bar

    @cached_property
    def together(self) -> Repeats | None:
        """The combined result; None if every video raised its alarm."""
        if not self.used:
            return None
        measured = [self.videos[index].measurement for index in self.used]
        grid = measured[0].distribution[0]
        return combined(
            [each.friction_coefficient for each in measured],
            [each.interval_90 for each in measured],
            (grid[0], grid[-1]),
        )

    @cached_property
    def outliers(self) -> list[int]:
        """Which videos disagree with the others."""
        return [self.used[number] for number in self.together.outliers] if self.together else []

    def names(self, which: Sequence[int]) -> list[str]:
        """Names of some videos."""
        return [self.videos[index].name for index in which]

    def lines(self) -> list[str]:
        """The result for a terminal."""
        lines = []
        for video in self.videos:
            first, *others = video.lines()
            lines += [f"{video.name}: {first}", *(f"  {other}" for other in others)]
        lines += [f"not measured: {problem}" for problem in self.refused.values()]
        lines += [
            f"outlier: {name} disagrees with the others" for name in self.names(self.outliers)
        ]
        together = self.together
        if together is None:
            return [*lines, "ALARM in every video: no combined value"]
        low, high = together.interval_90
        error_bar = self.without_error_bar or f"90 % interval {low:.3f} ... {high:.3f}"
        if len(self.used) > 1:
            error_bar += f"; standard deviation between the videos {together.scatter:.3f}"
        lines.append(
            f"combined ({len(self.used)} of {len(self.videos) + len(self.refused)} videos): "
            f"friction {together.friction_coefficient:.3f}, {error_bar}"
        )
        return lines

    def numbers(self) -> dict[str, Any]:
        """The result for a program."""
        together = self.together
        return {
            "videos": [video.numbers() for video in self.videos],
            "refused": list(self.refused.values()),
            "combined": together
            and {
                "friction_coefficient": together.friction_coefficient,
                "interval_90": None if self.without_error_bar else list(together.interval_90),
                "without_error_bar": self.without_error_bar,
                "scatter": together.scatter if len(self.used) > 1 else None,
                "videos": self.names(self.used),
                "outliers": self.names(self.outliers),
            },
        }

    def table(self) -> str:
        """CSV: one row per video, measured or not, then the combined value."""
        text = io.StringIO()
        rows = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        rows.writeheader()
        for index, video in enumerate(self.videos):
            fabric, probability = video.fabric
            row = {
                **self._value(video.measurement),
                "video": _cell(video.name),
                "fabric": fabric,
                "fabric_probability": f"{probability:.3f}",
                "alarm": video.alarm_reason,
                "outlier": int(index in self.outliers),
                "notes": "; ".join(filter(None, [video.without_error_bar, *video.notes])),
            }
            rows.writerow(row)
        for name, problem in self.refused.items():
            rows.writerow({"video": _cell(name), "notes": f"not measured: {problem}"})
        if together := self.together:
            scatter = f"{together.scatter:.4f}" if len(self.used) > 1 else ""
            last = {"video": COMBINED, "scatter": scatter, "notes": self.without_error_bar}
            rows.writerow({**self._value(together), **last})
        return text.getvalue()

    def _value(self, result: Prediction | Repeats) -> dict[str, str]:
        """Cells of a coefficient and its interval; without it where there is no error bar."""
        cells = {"friction_coefficient": f"{result.friction_coefficient:.4f}"}
        if not self.without_error_bar:
            for name, end in zip(("low", "high"), result.interval_90, strict=True):
                cells[f"interval_90_{name}"] = f"{end:.4f}"
        return cells


def _cell(name: str) -> str:
    """A video's name that is neither taken for a formula nor for the last row."""
    return f"./{name}" if name == COMBINED or name.startswith((*FORMULA, "-")) else name


def measured_pair(
    videos: Sequence[Path],
    bench: MeasuringBench,
    *,
    start_s: float | None = None,
    frame_rate_hz: float | None = None,
) -> MeasuredPair:
    """Measure videos of one pair; BadInput if one is given twice, or none could be measured."""
    names = names_of(videos)
    _refuse_copies(videos)
    measured: list[MeasuredVideo] = []
    refused: dict[str, str] = {}
    for name, video in zip(names, videos, strict=True):
        try:
            result = bench.measure(video, start_s=start_s, frame_rate_hz=frame_rate_hz)
        except BadInput as problem:
            if len(videos) == 1:
                raise
            refused[name] = str(problem)
        else:
            measured.append(replace(result, name=name))
    if not measured:
        first = next(iter(refused.values()))
        raise BadInput(f"none of {len(videos)} videos can be measured; the first: {first}")
    return MeasuredPair(measured, refused)


def write_measurements(
    pair: MeasuredPair,
    read: Sequence[Path],
    started: tuple[float, float],
    *,
    page_path: Path | None,
    numbers_path: Path | None,
    table_path: Path | None,
) -> None:
    """Write what is asked for (HTML, JSON, CSV), with its provenance beside it.

    Of a single video, its own page and numbers. `read` are the videos, the camera file and the
    instrument's configuration, for the record.
    """
    if not (page_path or numbers_path or table_path):
        return
    inputs = [path for path in read if Path(path).is_file()]
    record = provenance_record("measure", inputs=inputs, started=started)
    first = pair.videos[0]
    record["instrument"] = first.instrument
    single = len(pair.videos) + len(pair.refused) == 1
    if page_path:
        content = measurement_page(first, truth_of(read[0])) if single else repeats_page(pair)
        write_text(page_path, content, record)
    if numbers_path:
        write_json(numbers_path, first.numbers() if single else pair.numbers(), record)
    if table_path:
        write_text(table_path, pair.table(), record)


def _refuse_copies(videos: Sequence[Path]) -> None:
    """Refuse two files of the same content: a copy is not a repeat."""
    files = [path for path in map(Path, videos) if path.is_file()]
    sizes = [path.stat().st_size for path in files]
    seen: dict[str, Path] = {}
    for path, size in zip(files, sizes, strict=True):
        if sizes.count(size) > 1:
            first = seen.setdefault(file_digest(path), path)
            if first is not path:
                raise BadInput(f"{path}: a copy of {first}; each video counts once")


def names_of(videos: Sequence[Path]) -> list[str]:
    """As much of each path's end as tells the videos apart; BadInput if one is given twice."""
    files = [Path(video).resolve() for video in videos]
    for index, file in enumerate(files):
        if file in files[:index]:
            raise BadInput(f"{videos[index]}: given twice; each video counts once")
    parts = [Path(video).absolute().parts for video in videos]
    length = 1
    while len({part[-length:] for part in parts}) < len(parts):
        length += 1
    return [str(Path(*part[-length:])) for part in parts]
