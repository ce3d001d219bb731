"""Measurements of one pair's videos: in words, all numbers, a table."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest
from slipstitch.film.csv_table import FORMULA
from slipstitch.film.measure.measuring_bench import MeasuredVideo, MeasuringBench
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

    videos: list[MeasuredVideo]  # no two have the same name
    refused: dict[str, str]  # name of each of the other videos -> why it could not be measured

    @cached_property
    def used(self) -> list[int]:
        """Which videos raised no alarm: the combined value rests on them."""
        return [index for index, video in enumerate(self.videos) if not video.alarm_reason]

    @property
    def without_error_bar(self) -> str:
        """Why the instrument states no interval; empty where it does."""
        return self.videos[0].without_error_bar if self.videos else ""

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

    @property
    def count(self) -> int:
        """Of videos, measured or not."""
        return len(self.videos) + len(self.refused)

    def lines(self) -> list[str]:
        """The result for a terminal."""
        if self.count == 1:
            return self.videos[0].lines()
        lines = []
        for video in self.videos:
            first, *others = video.lines()
            lines += [f"{video.name}: {first}", *(f"  {other}" for other in others)]
        return [*lines, *self.remarks(), self.summary()]

    def remarks(self) -> list[str]:
        """Which videos were not measured, and which disagree with the others."""
        return [
            *(f"not measured: {problem}" for problem in self.refused.values()),
            *(f"outlier: {name} disagrees with the others" for name in self.names(self.outliers)),
        ]

    def summary(self) -> str:
        """The combined result in a line."""
        together = self.together
        if together is None:
            return "ALARM in every video: no combined value" if self.videos else "not measured"
        low, high = together.interval_90
        error_bar = self.without_error_bar or f"90 % interval {low:.3f} ... {high:.3f}"
        if len(self.used) > 1:
            error_bar += f"; standard deviation between the videos {together.scatter:.3f}"
        return (
            f"combined ({len(self.used)} of {self.count} videos): "
            f"friction {together.friction_coefficient:.3f}, {error_bar}"
        )

    def numbers(self) -> dict[str, Any]:
        """The result for a program."""
        return self.numbers_of_repeats() if self.count > 1 else self.videos[0].numbers()

    def numbers_of_repeats(self) -> dict[str, Any]:
        """Numbers of all videos, also of a single one, and of what they say together."""
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
        return csv_text(COLUMNS, self.rows())

    def rows(self) -> Iterator[dict[str, Any]]:
        """Rows of the table, by its `COLUMNS`."""
        for index, video in enumerate(self.videos):
            fabric, probability = video.fabric
            yield {
                **self._value(video.measurement),
                "video": _cell(video.name),
                "fabric": fabric,
                "fabric_probability": f"{probability:.3f}",
                "alarm": video.alarm_reason,
                "outlier": int(index in self.outliers),
                "notes": "; ".join(filter(None, [video.without_error_bar, *video.notes])),
            }
        for name, problem in self.refused.items():
            yield {"video": _cell(name), "notes": f"not measured: {problem}"}
        if together := self.together:
            scatter = f"{together.scatter:.4f}" if len(self.used) > 1 else ""
            last = {"video": COMBINED, "scatter": scatter, "notes": self.without_error_bar}
            yield {**self._value(together), **last}

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


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return a table as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


@dataclass(frozen=True)
class Film:
    """A video, the bench that it was filmed on, and its clock where that is known better."""

    path: Path
    bench: MeasuringBench
    start_s: float | None = None
    frame_rate_hz: float | None = None


def measured_pair(films: Sequence[Film], names: Sequence[str]) -> MeasuredPair:
    """Measure videos of one pair as far as they can be, by their names."""
    measured: list[MeasuredVideo] = []
    refused: dict[str, str] = {}
    for name, film in zip(names, films, strict=True):
        try:
            clock = {"start_s": film.start_s, "frame_rate_hz": film.frame_rate_hz}
            measured.append(replace(film.bench.measure(film.path, **clock), name=name))
        except BadInput as problem:
            refused[name] = str(problem)
    return MeasuredPair(measured, refused)


def measured_repeats(films: Sequence[Film]) -> MeasuredPair:
    """Measure videos of one pair; BadInput if one is given twice, or none could be measured."""
    paths = [film.path for film in films]
    names = names_of(paths)
    _refuse_copies(paths)
    pair = measured_pair(films, names)
    if not pair.videos:
        first = pair.refused[names[0]]
        none = f"none of {len(films)} videos can be measured; the first: " * (len(films) > 1)
        raise BadInput(f"{none}{first}")
    return pair


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
