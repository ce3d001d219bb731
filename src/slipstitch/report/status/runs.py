"""Reading what `status.journal` wrote: the last run's jobs, and every failure so far."""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.report.status.journal import EVENTS, PLAN, boot_identity, process_birth

LOG_LINES = 12
LOG_BYTES = 64 * 1024
MOST_FAILURES = 3


@dataclass(frozen=True)
class Failure:
    """One attempt at a job that failed.

    Attributes
    ----------
    time_s : float
        Time of failure, in seconds since 1970.
    rule : str
    output, log : list of str
        Its outputs and log files.
    then : str
        ``retried`` if another attempt of the same run followed, ``completed later`` if its output
        exists now, else ``not completed``.
    """

    time_s: float
    rule: str
    output: list[str]
    log: list[str]
    then: str


@dataclass
class Run:
    """One run of the workflow: how it began, what happened to each job, how it ended.

    Attributes
    ----------
    head : dict
        The journal's first entry of the run.
    state : dict of int to str
        Last event of each job that had one: started, finished or failed.
    failures : list of dict
        The journal's lines.
    success : bool or None
        None if it has no end entry.
    last_s : float
        Time of its last entry.
    own_cpu_s, jobs_cpu_s : float
        CPU time of Snakemake itself and of its jobs on this machine, once it has ended.
    """

    head: dict[str, Any]
    state: dict[int, str] = field(default_factory=dict)
    failures: list[dict[str, Any]] = field(default_factory=list)
    success: bool | None = None
    last_s: float = 0.0
    own_cpu_s: float = 0.0
    jobs_cpu_s: float = 0.0

    def alive(self) -> bool | None:
        """Whether its process still runs; None if it was started on another machine."""
        if self.success is not None:
            return False
        if self.head.get("boot") is None or self.head["boot"] != boot_identity():
            return None
        return process_birth(self.head["pid"]) == self.head["born"]


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """The entries of the journal, without one truncated by a crash."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    for line in text.splitlines():
        try:
            event = json.loads(line)
            if _is_event(event):
                yield event
        except (ValueError, TypeError, KeyError, RecursionError):
            continue


_HEAD = {"cores": int, "pid": int, "born": int | None, "boot": str | None}


def _is_event(event: Any) -> bool:
    """Whether an entry has the format of the journal."""
    if not isinstance(event["event"], str) or not isinstance(event["time"], float | int):
        return False
    if event["event"] == "run":
        return all(isinstance(event[key], kind) for key, kind in _HEAD.items())
    if event["event"] == "end":
        return all(isinstance(event[key], float | int) for key in ("own_cpu_s", "jobs_cpu_s"))
    if event["event"] == "failed":
        named = [*event["output"], *event["log"], event["rule"]]
        return isinstance(event["job"], int) and all(isinstance(name, str) for name in named)
    return isinstance(event.get("job", 0), int)


def read_runs(folder: str | os.PathLike) -> list[Run]:
    """All runs in the journal of a results folder, in order.

    Parameters
    ----------
    folder : path
        The results folder.
    """
    runs: list[Run] = []
    for event in _lines(Path(folder) / "status" / EVENTS):
        if event["event"] == "run":
            runs.append(Run(event))
        if not runs:
            continue
        run = runs[-1]
        run.last_s = event["time"]
        if event["event"] == "end":
            run.success = bool(event.get("success"))
            run.own_cpu_s, run.jobs_cpu_s = event["own_cpu_s"], event["jobs_cpu_s"]
        elif "job" in event:
            run.state[event["job"]] = event["event"]
            if event["event"] == "failed":
                run.failures.append(event)
    return runs


def _is_job(job: Any) -> bool:
    lists = [job[key] for key in ("output", "log")]
    texts = [job["rule"], job["benchmark"] or "", *lists[0], *lists[1]]
    return (
        all(isinstance(paths, list) for paths in lists)
        and len(lists[0]) > 0
        and all(isinstance(text, str) and "\0" not in text for text in texts)
        and isinstance(job["id"], int)
        and isinstance(job["threads"], int)
        and isinstance(job["needed"], bool)
        and all(isinstance(before, int) for before in job["after"])
    )


def read_plan(folder: str | os.PathLike) -> list[dict[str, Any]]:
    """The jobs of the last run; empty if there was none.

    Raises
    ------
    BadInput
        If the plan cannot be read.
    """
    path = Path(folder) / "status" / PLAN
    try:
        jobs = json.loads(path.read_text(encoding="utf-8"))["jobs"]
        if not all(_is_job(job) for job in jobs):
            raise ValueError
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError, IndexError, RecursionError):
        raise BadInput(f"{path}: damaged; the next run of snakemake regenerates it") from None
    return jobs


def failures(folder: str | os.PathLike, runs: list[Run]) -> list[Failure]:
    """Every failed attempt of every run, the oldest first."""
    base = Path(folder).parent
    found = []
    for run in runs:
        for position, event in enumerate(run.failures):
            output = list(event.get("output") or [])
            again = any(later["job"] == event["job"] for later in run.failures[position + 1 :])
            if again or run.state.get(event["job"]) == "finished":
                then = "retried"
            else:
                there = output and all((base / path).exists() for path in output)
                then = "completed later" if there else "not completed"
            logs = list(event.get("log") or [])
            found.append(Failure(event["time"], event.get("rule", "?"), output, logs, then))
    return found


def last_lines(path: str | os.PathLike, count: int = LOG_LINES) -> list[str]:
    """The last non-empty lines of a log, without control characters."""
    try:
        with open(path, "rb") as stream:
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(0, size - LOG_BYTES))
            text = stream.read().decode("utf-8", errors="replace")
    except OSError as error:
        return [f"(no log: {error.strerror})"]
    lines = [
        "".join(letter if letter.isprintable() else " " for letter in line).rstrip()
        for line in text.replace("\r", "\n").splitlines()
    ]
    return [line for line in lines if line][-count:] or ["(the log is empty)"]


def failure_lines(
    folder: str | os.PathLike, event: Failure | dict[str, Any], count: int = LOG_LINES
) -> list[str]:
    """The description of a failure: job, log file, end of the log."""
    failure = event if isinstance(event, dict) else vars(event)
    made = ", ".join(failure["output"][:3]) + (" ..." if len(failure["output"]) > 3 else "")
    lines = [f"failed: {failure['rule']}, output {made}"]
    for log in failure["log"]:
        lines.append(f"  end of {log}:")
        lines += [f"    {line}" for line in last_lines(Path(folder).parent / log, count)]
    return lines


def last_failures(folder: str | os.PathLike) -> str:
    """The failures of the last run, to be printed at the end of a failed run."""
    runs = read_runs(folder)
    # For a retried job, the last attempt.
    failed = {event["job"]: event for event in (runs[-1].failures if runs else [])}
    standing = [event for job, event in failed.items() if runs[-1].state[job] == "failed"]
    lines = []
    for event in standing[:MOST_FAILURES]:
        lines += ["", *failure_lines(folder, event)]
    if len(standing) > MOST_FAILURES:
        lines += ["", f"and {len(standing) - MOST_FAILURES} more: slipstitch status"]
    if standing:
        lines += ["", "Finished work is kept: fix the cause and repeat the command."]
    return "\n".join(lines)
