"""All videos of a captures table measured, pair by pair."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.film.captures_table import REFERENCE, TOLD, Capture, read_captures
from slipstitch.film.measure.measurement_files import (
    COLUMNS,
    Film,
    MeasuredPair,
    csv_text,
    measured_pair,
    names_of,
)
from slipstitch.film.measure.measuring_bench import MeasuringBench

LABELS = ("material", "substrate", *REFERENCE)


@dataclass(frozen=True)
class CapturedPair:
    """What the videos of one pair say, and what was measured of it by other means."""

    capture: Capture  # one of the pair's, which agree in what is said of it
    measured: MeasuredPair

    @property
    def title(self) -> str:
        """Name of the pair."""
        return f"{self.capture.material} on {self.capture.substrate}"

    @property
    def reference(self) -> str:
        """Friction measured by other means, in words; empty where it was not."""
        if self.capture.mu_ref is None:
            return ""
        return f"{self.capture.mu_ref:.3f} ± {self.capture.mu_ref_error:.3f}"

    @property
    def labels(self) -> dict[str, Any]:
        """What the table says of the pair, by `LABELS`."""
        return {name: getattr(self.capture, name) for name in LABELS}


@dataclass(frozen=True)
class MeasuredCaptures:
    """All pairs of a table, in its order; at least one video was measured."""

    pairs: list[CapturedPair]

    @property
    def surrogate(self) -> bool:
        """Whether the films are simulated, which are never called real."""
        return self.pairs[0].capture.surrogate

    @property
    def caveat(self) -> str:
        """What is to be said of all films; empty if nothing."""
        return "surrogate captures: simulated, not real" if self.surrogate else ""

    @property
    def videos(self) -> list:
        """All videos that were measured."""
        return [video for pair in self.pairs for video in pair.measured.videos]

    @property
    def refused(self) -> list[str]:
        """Why each of the other videos could not be measured."""
        return [problem for pair in self.pairs for problem in pair.measured.refused.values()]

    def lines(self) -> list[str]:
        """The result for a terminal."""
        lines = [f"these are {self.caveat}"] if self.caveat else []
        for pair in self.pairs:
            measured = pair.measured
            beside = f"; reference {pair.reference}" if pair.reference else ""
            lines.append(f"{pair.title}: {measured.summary()}{beside}")
            for video in measured.videos:
                if video.alarm_reason:
                    lines.append(f"  ALARM in {video.name}: {video.alarm_reason}")
            lines += [f"  {remark}" for remark in measured.remarks()]
        return lines

    def numbers(self) -> dict[str, Any]:
        """The result for a program."""
        return {
            "surrogate": self.surrogate,
            "pairs": [pair.labels | pair.measured.numbers_of_repeats() for pair in self.pairs],
        }

    def table(self) -> str:
        """CSV: of every pair a row per video, measured or not, then the combined value."""
        rows = (pair.labels | row for pair in self.pairs for row in pair.measured.rows())
        return csv_text((*LABELS, *COLUMNS), rows)


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
    pairs = []
    for rows in progress(list(of_pair.values())):
        measured = measured_pair([films[one] for one in rows], [names[one] for one in rows])
        pairs.append(CapturedPair(rows[0], measured))
    result = MeasuredCaptures(pairs)
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
