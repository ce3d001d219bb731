"""Cost section of the report: CPU time, wall time and memory of every stage."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipstitch.base.page.figures import new_figure, styled, svg_uri
from slipstitch.base.page.palette import BLUE, PALE_BLUE
from slipstitch.base.page.wording import NONE, duration
from slipstitch.report.results import Benchmark


def cost_section(benchmarks: Sequence[Benchmark]) -> dict[str, Any] | None:
    """One row per stage, their picture and their sum; None without benchmark files."""
    if not benchmarks:
        return None
    return {
        "rows": [
            {
                "stage": stage.stage,
                "jobs": str(stage.jobs),
                "cpu": duration(stage.cpu_s),
                "wall": duration(stage.wall_s),
                "cpu_median": duration(stage.cpu_median_s),
                "wall_median": duration(stage.wall_median_s),
                "memory": NONE if stage.memory_mib is None else f"{stage.memory_mib:.0f} MiB",
            }
            for stage in benchmarks
        ],
        "figure": svg_uri(_figure(benchmarks)),
        "total_cpu": duration(sum(stage.cpu_s for stage in benchmarks)),
    }


@styled
def _figure(benchmarks: Sequence[Benchmark]):
    """CPU and wall time of every stage."""
    figure = new_figure(7.6, 0.42 * len(benchmarks) + 0.7)
    axes = figure.subplots()
    places = np.arange(len(benchmarks))[::-1]
    cpu_min = [stage.cpu_s / 60 for stage in benchmarks]
    wall_min = [stage.wall_s / 60 for stage in benchmarks]
    axes.barh(places + 0.17, cpu_min, height=0.32, color=BLUE, label="CPU time")
    axes.barh(
        places - 0.17, wall_min, height=0.32, color=PALE_BLUE, label="wall time, summed over jobs"
    )
    axes.set_yticks(places, [stage.stage for stage in benchmarks])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("minutes")
    axes.legend(frameon=False, fontsize=8)
    return figure
