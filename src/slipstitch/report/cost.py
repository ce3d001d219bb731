"""What jobs cost, by Snakemake's benchmark files and the logs beside them, and every stage."""

import csv
import math
import os
import re
from collections import defaultdict
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, styled, svg_uri
from slipstitch.base.page.palette import BLUE, PALE_BLUE
from slipstitch.base.page.wording import NONE, duration
from slipstitch.report.results import Results, Table
from slipstitch.report.status import Run, end_of_file, failures

STAGES = (
    "calibrate", "simulate", "convergence", "render", "sample", "train", "instrument", "evaluate",
    "criticise", "release", "audit", "report",
)  # fmt: skip
SAID_CPU_TIME = re.compile(r"(?:^CPU time: |[,:] )(\d+\.\d+) (?:CPU )?s$", re.M)
SAID_EARLIER = re.compile(r"^wall time of earlier attempts: (\d+\.\d+) s$", re.M)


class Benchmark(NamedTuple):
    """Cost of the jobs of one stage: sums and medians of times (s), the largest memory (MiB)."""

    stage: str
    jobs: int
    wall_s: float
    cpu_s: float
    wall_median_s: float
    cpu_median_s: float
    memory_mib: float | None


class Measured(NamedTuple):
    """Cost of a finished job from its benchmark file (s, MiB); NaN if it was too short."""

    cpu_s: float
    wall_s: float
    memory_mib: float


def read_benchmark(path: str | os.PathLike) -> Measured | None:
    """Cost of a job by its benchmark file; None if it is missing or empty.

    Snakemake looks at a process every 30 s and misses what it uses after the last look; the CPU
    time is the one that the verb says at the end of the log of the same name, if it does. There it
    also says what attempts took that were killed and continued, of which Snakemake knows nothing.
    """
    path = Path(path)
    try:
        with open(path, encoding="utf-8", errors="replace") as stream:
            rows = list(csv.DictReader(stream, delimiter="\t"))
    except (OSError, csv.Error):
        return None
    if not rows or math.isnan(wall := _number(rows[-1].get("s"))):
        return None
    log = path.parents[2] / "logs" / path.parent.name / f"{path.stem}.log"
    end = end_of_file(log, 200) if log.is_file() else ""
    said, earlier = ([0.0, *map(float, p.findall(end))][-1] for p in (SAID_CPU_TIME, SAID_EARLIER))
    cpu_s = said or _number(rows[-1].get("cpu_time"))
    return Measured(cpu_s, wall + earlier, _number(rows[-1].get("max_rss")))


def _number(text: Any) -> float:
    """A cell as a number; Snakemake writes ``-`` or ``NA`` for a job too short to be measured."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def benchmarks(folder: Path, job_classes: bool = False) -> list[Benchmark]:
    """Cost of every stage that has benchmark files, in the order of the chain.

    With `job_classes`, of every class of jobs that the files' names tell: ``render/shade``.
    """
    classes: dict[tuple[int, str], list[Measured]] = defaultdict(list)
    for path in sorted((folder / "benchmarks").glob("*/*.tsv")):
        stage = name = path.parent.name
        if job_classes:
            # A network, or the word before what the job was of: sweep_..., shade_...
            job = re.search(r"[a-z]+_[a-z]+(?=_seed)|^(?!by_)[a-z]+(?=_|$)", path.stem)
            name += f"/{job[0]}" if job else ""
        order = STAGES.index(stage) if stage in STAGES else len(STAGES)
        if cost := read_benchmark(path):
            classes[order, name].append(cost)
    found = []
    for (_, name), jobs in sorted(classes.items()):
        of = pandas.DataFrame(jobs)
        sums, medians = of.sum(min_count=1), of.median()
        times_s = sums.wall_s, sums.cpu_s, medians.wall_s, medians.cpu_s
        memory = None if math.isnan(most := of.memory_mib.max()) else float(most)
        found.append(Benchmark(name, len(jobs), *times_s, memory))
    return found


def cost_section(benchmarks: Sequence[Benchmark]) -> dict[str, Any] | None:
    """One row per stage, their picture and their sum; None without benchmark files."""
    if not benchmarks:
        return None
    rows = []
    for stage in benchmarks:
        times_s = stage.cpu_s, stage.wall_s, stage.cpu_median_s, stage.wall_median_s
        memory = NONE if stage.memory_mib is None else f"{stage.memory_mib:.0f} MiB"
        rows.append([stage.stage, str(stage.jobs), *map(duration, times_s), memory])
    head = ["stage", "jobs", "CPU", "wall", "CPU, median job", "wall, median job", "memory, most"]
    return {
        "table": (head, rows),
        "figure": svg_uri(_figure(benchmarks)),
        "total_cpu": duration(float(np.nansum([stage.cpu_s for stage in benchmarks]))),
    }


def failure_table(folder: Path, runs: Sequence[Run]) -> Table:
    """Every failed attempt at a job."""
    rows = []
    for event, then in failures(folder, runs):
        when = datetime.fromtimestamp(event.time, UTC).strftime("%Y-%m-%d %H:%M")
        made = ", ".join(event.output[:2]) + (" ..." if len(event.output) > 2 else "")
        rows.append([when, event.rule, made, ", ".join(event.log), then])
    return ["when (UTC)", "job", "output", "log", "status"], rows


def provenance(results: Results) -> dict[str, Any]:
    """One record of each stage, the versions of the packages, the machines."""
    records = results.provenance()
    rows = []
    versions: dict[str, set[str]] = defaultdict(set)
    for artefact, record in records:
        commit = (record.get("git_commit") or "none")[:12] + "+" * bool(record.get("git_dirty"))
        seed = str(NONE if record.get("seed") is None else record["seed"])
        rows.append([artefact, commit, (record.get("code_digest") or "?")[:12], seed])
        for name, version in (record.get("versions") or {}).items():
            versions[name].add(version)
    return {
        "table": (["artefact", "commit", "code digest", "seed"], rows),
        "versions": {name: "/".join(sorted(found)) for name, found in sorted(versions.items())},
        "hosts": sorted({record.get("host_kind", "?") for _, record in records}),
    }


@styled
def _figure(benchmarks: Sequence[Benchmark]) -> Figure:
    """CPU and wall time of every stage."""
    figure = new_figure(7.6, 0.42 * len(benchmarks) + 0.7)
    axes = figure.subplots()
    places = np.arange(len(benchmarks))[::-1]
    for up, key, colour, label in (
        (0.17, "cpu_s", BLUE, "CPU time"),
        (-0.17, "wall_s", PALE_BLUE, "wall time, summed"),
    ):
        minutes = [getattr(stage, key) / 60 for stage in benchmarks]
        axes.barh(places + up, minutes, height=0.32, color=colour, label=label)
    axes.set_yticks(places, [stage.stage for stage in benchmarks])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("minutes")
    axes.legend(frameon=False, fontsize=8)
    return figure
