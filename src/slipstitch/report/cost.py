"""Cost section of the report: time and memory of every stage, failures, provenance."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, styled, svg_uri
from slipstitch.base.page.palette import BLUE, PALE_BLUE
from slipstitch.base.page.wording import NONE, duration
from slipstitch.report.results import Benchmark, Results, Table


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


def failure_table(results: Results) -> Table:
    """Every failed attempt at a job."""
    rows = []
    for failure in results.failures():
        when = datetime.fromtimestamp(failure.time_s, UTC).strftime("%Y-%m-%d %H:%M")
        made = ", ".join(failure.output[:2]) + (" ..." if len(failure.output) > 2 else "")
        rows.append([when, failure.rule, made, ", ".join(failure.log), failure.then])
    return ["when (UTC)", "job", "output", "log", "status"], rows


def provenance(results: Results) -> dict[str, Any]:
    """One record of each stage, the versions of the packages, the machines."""
    records = results.provenance()
    rows = []
    versions: dict[str, set[str]] = {}
    for artefact, record in records:
        commit = (record.get("git_commit") or "none")[:12] + "+" * bool(record.get("git_dirty"))
        seed = str(NONE if record.get("seed") is None else record["seed"])
        rows.append([artefact, commit, (record.get("code_digest") or "?")[:12], seed])
        for name, version in (record.get("versions") or {}).items():
            versions.setdefault(name, set()).add(version)
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
    cpu_min = [stage.cpu_s / 60 for stage in benchmarks]
    wall_min = [stage.wall_s / 60 for stage in benchmarks]
    axes.barh(places + 0.17, cpu_min, height=0.32, color=BLUE, label="CPU time")
    axes.barh(places - 0.17, wall_min, height=0.32, color=PALE_BLUE, label="wall time, summed")
    axes.set_yticks(places, [stage.stage for stage in benchmarks])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("minutes")
    axes.legend(frameon=False, fontsize=8)
    return figure
