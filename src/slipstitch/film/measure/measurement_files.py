"""Measurements of one pair's videos, and as files: the page, all numbers, a table."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, provenance_record, write_json, write_text
from slipstitch.film.csv_table import FORMULA
from slipstitch.film.measure import truth_of
from slipstitch.film.measure.measuring_bench import MeasuredVideo, MeasuringBench
from slipstitch.film.measure.pages import measurement_page, repeats_page
from slipstitch.film.measure.repeats import Repeats, combined
from slipstitch.learning.prediction import Prediction

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
