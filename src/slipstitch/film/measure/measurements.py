"""Measurements of one pair's videos, and of all pairs of a table: in words, numbers, a table."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest
from slipstitch.film.captures_table import LABELS, TOLD, Capture, read_captures
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


@dataclass(frozen=True)
class MeasuredCaptures:
    """All pairs of a table, in its order; at least one video was measured."""

    # one row of each pair's, which agree in what is said of it -> what the pair's videos say
    pairs: dict[Capture, MeasuredPair]

    @property
    def surrogate(self) -> bool:
        """Whether the films are simulated, which are never called real."""
        return next(iter(self.pairs)).surrogate

    @property
    def caveat(self) -> str:
        """What is to be said of all films; empty if nothing."""
        return "surrogate captures: simulated, not real" if self.surrogate else ""

    @property
    def videos(self) -> list:
        """All videos that were measured."""
        return [video for pair in self.pairs.values() for video in pair.videos]

    @property
    def refused(self) -> list[str]:
        """Why each of the other videos could not be measured."""
        pairs = self.pairs.values()
        return [problem for pair in pairs for problem in pair.refused.values()]

    def lines(self) -> list[str]:
        """The result for a terminal."""
        lines = [f"these are {self.caveat}"] if self.caveat else []
        for row, pair in self.pairs.items():
            beside = f"; reference {row.reference}" if row.reference else ""
            lines.append(f"{row.title}: {pair.summary()}{beside}")
            for video in pair.videos:
                if video.alarm_reason:
                    lines.append(f"  ALARM in {video.name}: {video.alarm_reason}")
            lines += [f"  {remark}" for remark in pair.remarks()]
        return lines

    def numbers(self) -> dict[str, Any]:
        """The result for a program."""
        return {
            "surrogate": self.surrogate,
            "pairs": [row.labels | pair.numbers_of_repeats() for row, pair in self.pairs.items()],
        }

    def table(self) -> str:
        """CSV: of every pair a row per video, measured or not, then the combined value."""
        rows = (row.labels | cells for row, pair in self.pairs.items() for cells in pair.rows())
        return csv_text((*LABELS, *COLUMNS), rows)


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


def measured_captures(
    table: str | Path,
    bench_of: Callable[[Path], MeasuringBench],
    progress: Callable[[Sequence], Iterable] = iter,
) -> tuple[MeasuredCaptures, list[Path]]:
    """Measure the videos of a captures table; return also the files that were read.

    Parameters
    ----------
    table : path
        See `slipstitch.film.captures_table.read_captures`; mu_ref may be missing.
    bench_of : callable
        Opens the bench behind a camera.
    progress : callable
        Is told the pairs, and returns what goes through them.

    BadInput if the table, a camera, or what a row tells cannot be used, before any video is read;
    or if no video at all can be measured.
    """
    captures = read_captures(table, referenced=False)
    benches = {camera: bench_of(camera) for camera in dict.fromkeys(one.camera for one in captures)}
    films = {one: _film(table, one, benches[one.camera]) for one in captures}
    names = dict(zip(captures, names_of([one.video for one in captures]), strict=True))
    of_pair: dict[str, list[Capture]] = {}
    for one in captures:
        of_pair.setdefault(one.pair, []).append(one)
    result = MeasuredCaptures(
        {
            rows[0]: measured_pair([films[one] for one in rows], [names[one] for one in rows])
            for rows in progress(list(of_pair.values()))
        }
    )
    if not result.videos:
        raise BadInput(
            f"{table}: none of {len(captures)} videos can be measured; the first: "
            f"{result.refused[0]}"
        )
    configs = {bench.config_path for bench in benches.values()}
    return result, [Path(table), *benches, *configs, *(one.video for one in captures)]


def _film(table: str | Path, capture: Capture, bench: MeasuringBench) -> Film:
    """A row's video, and its bench with what the row tells."""
    try:
        told = bench.told(**{name: getattr(capture, name) for name in TOLD})
    except BadInput as problem:
        raise BadInput(f"{table} line {capture.line}: {problem}") from None
    return Film(capture.video, told, capture.start_s, capture.frame_rate_hz)
