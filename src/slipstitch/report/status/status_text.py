"""`Status` as text."""

import time
from functools import partial
from pathlib import Path

from slipstitch.base.page.wording import aligned, duration, size
from slipstitch.report.status.runs import MOST_FAILURES, Failure, Run, failure_lines, last_lines
from slipstitch.report.status.state import Running, StageProgress, Status

MOST_RUNNING = 8


_about = partial(duration, digits=0, unknown="?")


def _table(stages: list[StageProgress]) -> list[str]:
    total = StageProgress("total")
    for stage in stages:
        for key, value in vars(stage).items():
            if key != "name":
                setattr(total, key, getattr(total, key) + value)
    rows = [
        ("stage", "done", "running", "failed", "to do", "CPU", "remaining", "disk", "remaining")
    ]
    for stage in [*stages, total]:
        rows.append(
            (
                stage.name,
                f"{stage.done}/{stage.jobs}",
                str(stage.running or "-"),
                str(stage.failed or "-"),
                str(stage.waiting or "-"),
                _about(stage.cpu_s),
                _about(stage.left_s) if stage.left_s else "-",
                size(stage.disk_bytes),
                size(stage.disk_to_come_bytes) if stage.disk_to_come_bytes else "-",
            )
        )
    return aligned(rows)


def _head(found: Status, run: Run, now_s: float) -> str:
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.head["time"]))
    if run.success is True:
        state = (
            f"finished after {_about(max(0.0, run.last_s - run.head['time']))}; CPU time of "
            f"its jobs {_about(run.jobs_cpu_s)}, of Snakemake itself {_about(run.own_cpu_s)}"
        )
    elif run.success is False:
        state = "stopped by a failure; fix the cause and repeat the snakemake command to continue"
    elif found.alive:
        state = "running"
        if found.left_s is not None:
            state += f", about {_about(found.left_s)} remaining on {run.head['cores']} cores"
    elif found.alive is None:
        ago = _about(max(0.0, now_s - run.last_s))
        state = f"started on another machine, last entry {ago} ago"
    else:
        state = "interrupted; to continue: `snakemake --unlock`, then repeat the snakemake command"
    return f"Run of {began}: {state}."


def _running(base: Path, running: list[Running], alive: bool | None, now_s: float) -> list[str]:
    if not running:
        return []
    lines = ["", "Running:" if alive is not False else "Interrupted:"]
    for job in running[:MOST_RUNNING]:
        told = f"  {job.output} ({job.rule}), for {_about(max(0.0, now_s - job.since_s))}"
        if job.expected_s is not None:
            told += f" of about {_about(job.expected_s)}"
        lines.append(told)
        for log in job.log:
            if (base / log).is_file():
                lines.append(f"    {last_lines(base / log, 1)[0]}")
    if len(running) > MOST_RUNNING:
        lines.append(f"  and {len(running) - MOST_RUNNING} more")
    return lines


def _failed(folder: Path, failures: list[Failure], count: int) -> list[str]:
    """Unresolved failures with their logs, then the number of resolved ones."""
    standing = [failure for failure in failures if failure.then == "not completed"]
    mended = len(failures) - len(standing)
    lines = []
    for failure in standing[-MOST_FAILURES:]:
        lines += [*failure_lines(folder, failure, count), ""]
    if len(standing) > MOST_FAILURES:
        lines += [f"and {len(standing) - MOST_FAILURES} more failures", ""]
    if mended:
        lines += [f"{mended} earlier failed attempt{'s' * (mended > 1)} resolved since", ""]
    return lines


def text(folder: Path, found: Status, log_lines: int, now_s: float | None = None) -> str:
    """The whole page: failures first, where the run stands, the stages, the jobs under way.

    Parameters
    ----------
    folder : path
        The results folder.
    found : Status
    log_lines : int
        How many lines of a failed job's log to show.
    now_s : float, optional
        Seconds since 1970; the present by default.
    """
    now_s = time.time() if now_s is None else now_s
    if found.run is None:
        return f"{folder}: no snakemake run has started a job here."
    lines = [
        *_failed(folder, found.failures, log_lines),
        _head(found, found.run, now_s),
        "",
        *_table(found.stages),
        *_running(folder.parent, found.running, found.alive, now_s),
    ]
    return "\n".join(lines)
