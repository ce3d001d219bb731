"""The cost of a job, from the benchmark file that Snakemake wrote and the log beside it."""

import csv
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SAID_CPU_TIME = re.compile(r"(?:^CPU time: |[,:] )(\d+\.\d+) (?:CPU )?s$", re.M)
SAID_EARLIER = re.compile(r"^wall time of earlier attempts: (\d+\.\d+) s$", re.M)


@dataclass(frozen=True)
class Measured:
    """Cost of a finished job from its benchmark file (s, MiB); NaN if it was too short."""

    wall_s: float
    cpu_s: float
    memory_mib: float


def read_benchmark(path: str | os.PathLike) -> Measured | None:
    """Cost of a job by its benchmark file; None if it is missing or empty.

    Snakemake looks at a process every 30 s and misses what it uses after the last look; the CPU
    time is the one that the verb says at the end of the log of the same name, if it does. There it
    also says what attempts took that were killed and continued, of which Snakemake knows nothing.
    """
    try:
        with open(path, encoding="utf-8", errors="replace") as stream:
            rows = list(csv.DictReader(stream, delimiter="\t"))
    except (OSError, csv.Error):
        return None
    if not rows:
        return None
    wall = _number(rows[-1].get("s"))
    if math.isnan(wall):
        return None
    said = _end_of_log(Path(path))
    cpu_s = _last(SAID_CPU_TIME, said) or _number(rows[-1].get("cpu_time"))
    return Measured(wall + _last(SAID_EARLIER, said), cpu_s, _number(rows[-1].get("max_rss")))


def _last(pattern: re.Pattern[str], text: str) -> float:
    """The last number that is said in a text; 0 if none is."""
    found = pattern.findall(text)
    return float(found[-1]) if found else 0.0


def _end_of_log(benchmark: Path) -> str:
    """The end of the log beside a benchmark file, logs/STAGE/JOB.log; empty if there is none."""
    log = benchmark.parents[2] / "logs" / benchmark.parent.name / f"{benchmark.stem}.log"
    try:
        with open(log, "rb") as stream:
            stream.seek(max(0, os.path.getsize(log) - 200))
            return stream.read().decode(errors="replace")
    except OSError:
        return ""


def _number(text: Any) -> float:
    """A cell as a number; Snakemake writes ``-`` or ``NA`` for a job too short to be measured."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan
