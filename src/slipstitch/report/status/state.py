"""What ``slipstitch status`` prints: failures, the state of the last run, jobs done by stage."""

import time
from collections import Counter
from pathlib import Path
from typing import Any

from slipstitch.base.page.wording import aligned, duration
from slipstitch.report.status.runs import (
    MOST_FAILURES,
    Failure,
    Run,
    failure_lines,
    failures,
    read_plan,
    read_runs,
)

STATES = ("done", "running", "failed", "waiting")


def stage_of(job: dict[str, Any]) -> str:
    """Return the stage of a job: the folder below results/ that contains its output."""
    parts = Path(job["output"][0]).parts
    return parts[1] if len(parts) > 2 or (len(parts) == 2 and "." not in parts[1]) else "grid"


def _state(job: dict[str, Any], run: Run, base: Path) -> str:
    event = run.state.get(job["id"])
    if event in ("failed", "started"):
        return "failed" if event == "failed" else "running"
    there = all((base / path).exists() for path in job["output"])
    return "done" if there and (event == "finished" or not job["needed"]) else "waiting"


def jobs_by_stage(folder: Path, run: Run, plan: list[dict[str, Any]]) -> dict[str, Counter]:
    """Return how many jobs of each stage are in each of `STATES`, in the order of the plan."""
    stages: dict[str, Counter] = {}
    for job in plan:
        stages.setdefault(stage_of(job), Counter())[_state(job, run, folder.parent)] += 1
    return stages


def _head(run: Run) -> str:
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.head["time"]))
    if run.success is True:
        took_s = max(0.0, run.last_s - run.head["time"])
        state = (
            f"finished after {duration(took_s, digits=0)}; CPU time of its jobs "
            f"{duration(run.jobs_cpu_s, digits=0)}, of Snakemake itself "
            f"{duration(run.own_cpu_s, digits=0)}"
        )
    elif run.success is False:
        state = "stopped by a failure; fix the cause and repeat the snakemake command to continue"
    elif run.alive() is None:
        state = "started on another machine"
    elif run.alive():
        state = "running"
    else:
        state = "interrupted; to continue: `snakemake --unlock`, then repeat the snakemake command"
    return f"Run of {began}: {state}."


def _failed(folder: Path, found: list[Failure], count: int) -> list[str]:
    """Unresolved failures with their logs, then the number of resolved ones."""
    standing = [failure for failure in found if failure.then == "not completed"]
    mended = len(found) - len(standing)
    lines = []
    for failure in standing[-MOST_FAILURES:]:
        lines += [*failure_lines(folder, failure, count), ""]
    if len(standing) > MOST_FAILURES:
        lines += [f"and {len(standing) - MOST_FAILURES} more failures", ""]
    if mended:
        lines += [f"{mended} earlier failed attempt{'s' * (mended > 1)} resolved since", ""]
    return lines


def status(folder: str | Path, log_lines: int) -> tuple[str, bool]:
    """Return what to print of a results folder, and whether its last run stopped unfinished.

    Parameters
    ----------
    folder : path
        The results folder.
    log_lines : int
        How many lines of a failed job's log to show.

    Raises
    ------
    BadInput
        If the plan is damaged.
    """
    folder = Path(folder)
    runs, plan = read_runs(folder), read_plan(folder)
    if not runs or not plan:
        return f"{folder}: no snakemake run has started a job here.", False
    run = runs[-1]
    stages = jobs_by_stage(folder, run, plan)
    rows: list[tuple[str, ...]] = [("stage", *STATES)]
    for name, counts in [*stages.items(), ("total", sum(stages.values(), Counter()))]:
        others = [str(counts[state] or "-") for state in STATES[1:]]
        rows.append((name, f"{counts['done']}/{counts.total()}", *others))
    lines = [*_failed(folder, failures(folder, runs), log_lines), _head(run), "", *aligned(rows)]
    return "\n".join(lines), run.alive() is False and run.success is not True
