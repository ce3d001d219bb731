"""The state of a workflow run: its journal, failures in plain words, jobs by stage, time left.

Snakemake hands its events to `Journal` and `Progress` as structured log records. Only the main
process writes, from the first job's start on: a dry run leaves no trace.
"""

import contextlib
import json
import logging
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import aligned, counted, duration
from slipstitch.base.provenance import write_json
from slipstitch.config import Config
from slipstitch.design.cost import job_costs_s

FOLDER = Path("results/status")
PLAN = "plan.json"
EVENTS = "journal.jsonl"
STATES = ("done", "running", "failed", "waiting")
LOG_LINES = 12
LOG_BYTES = 64 * 1024
MOST_FAILURES = 3
# The cost model's kinds of jobs whose rules are not named by them.
KIND = {"render_images": "compose", "render_verification": "verify"}


FileName = Annotated[str, Field(pattern=r"^[^\x00]+$")]


class Job(BaseModel, strict=True):
    """A job of the plan: its rule, its files, and whether the run had to do it."""

    id: int
    rule: str
    output: list[FileName] = Field(min_length=1)
    benchmark: str | None = None
    needed: bool

    @property
    def stage(self) -> str:
        """The folder below ``results``."""
        parts = Path(self.output[0]).parts
        return parts[1] if len(parts) > 2 or (len(parts) == 2 and "." not in parts[1]) else "grid"


class Plan(BaseModel):
    """The jobs of a run that have output files, in the order of their ids."""

    jobs: list[Job]


class Event(BaseModel, strict=True, allow_inf_nan=False):
    """A line of the journal."""

    event: str  # run, started, finished, failed or end
    time: float = Field(ge=0, lt=1e11)
    job: int | None = None
    rule: str = "?"
    output: list[FileName] = []
    log: list[FileName] = []
    pid: int = 0
    born: int | None = None
    boot: str | None = None
    success: bool = False
    own_cpu_s: float = 0.0
    jobs_cpu_s: float = 0.0


@dataclass
class Run:
    """One run of the workflow: its first event, the last of each job, its failures, its end."""

    head: Event
    last: Event
    state: dict[int | None, str] = field(default_factory=dict)
    failed: list[Event] = field(default_factory=list)

    @property
    def success(self) -> bool | None:
        """How it ended; None if it has no end."""
        return self.last.success if self.last.event == "end" else None

    def alive(self) -> bool | None:
        """Whether its process still runs; None if it was started on another machine."""
        if self.success is not None:
            return False
        if self.head.boot is None or self.head.boot != boot_identity():
            return None
        return process_birth(self.head.pid) == self.head.born


def boot_identity() -> str | None:
    """A random number drawn when a machine boots; None if unavailable."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return None


def process_birth(pid: int) -> int | None:
    """Start time of a process in clock ticks since boot; None if it has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    fields = text.rpartition(")")[2].split()
    return None if fields[0] in "ZX" else int(fields[19])


def plan_of(dag) -> list[Job]:
    """The jobs of Snakemake's graph with output files, in the order of their ids."""
    needed = set(dag.needrun_jobs())
    jobs = [
        Job(
            id=dag.jobid(job),
            rule=job.rule.name,
            output=list(map(str, job.output)),
            benchmark=None if job.benchmark is None else str(job.benchmark),
            needed=job in needed,
        )
        for job in dag.jobs
        if job.output
    ]
    return sorted(jobs, key=lambda job: job.id)


def _kind(record: Any) -> str | None:
    return getattr(getattr(record, "event", None), "value", None)


class Journal(logging.Handler):
    """Writes plan and events of one run; a handler of Snakemake's logger."""

    def __init__(self, folder: str | os.PathLike = FOLDER):
        super().__init__()
        self._folder = Path(folder)
        self._begun = False

    def begin(self, dag) -> None:
        """Write the plan and the first entry of the run."""
        self._begun = True
        write_json(self._folder / PLAN, Plan(jobs=plan_of(dag)).model_dump(), indent=None)
        pid = os.getpid()  # with its birth and the machine's, unique without naming the machine
        self._write("run", pid=pid, born=process_birth(pid), boot=boot_identity())

    def end(self, success: bool) -> None:
        """Write how the run ended, and what it took."""
        if self._begun:
            own, jobs = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
            own_s, jobs_s = (round(one.ru_utime + one.ru_stime, 2) for one in (own, jobs))
            self._write("end", success=success, own_cpu_s=own_s, jobs_cpu_s=jobs_s)

    def emit(self, record: Any) -> None:
        """Write the job events among Snakemake's log records."""
        kind = _kind(record) if self._begun else None
        if kind == "job_info":
            self._write("started", job=record.jobid)
        elif kind == "job_finished":
            self._write("finished", job=record.job_id)
        elif kind == "job_error":
            files = {name: list(map(str, getattr(record, name))) for name in ("output", "log")}
            self._write("failed", job=record.jobid, rule=record.rule_name, **files)

    def _write(self, event: str, **what: Any) -> None:
        line = json.dumps({"event": event, "time": round(time.time(), 3), **what})
        with (
            contextlib.suppress(OSError),  # a full disk must not turn logging into a failure
            open(self._folder / EVENTS, "a", encoding="utf-8") as stream,
        ):
            stream.write(line + "\n")


class Progress(logging.Handler):
    """Prints a line with the last job of each stage; jobs count by their modelled times."""

    def __init__(self, plan: Sequence[Job], config: Config):
        super().__init__()
        self._jobs = {job.id: job for job in plan if job.needed}
        of_kind = job_costs_s(config)
        kinds = {n: KIND.get(j.rule, j.rule.partition("_")[0]) for n, j in self._jobs.items()}
        self._cost_s = {number: of_kind.get(kind, 1.0) for number, kind in kinds.items()}
        self._started_s = time.monotonic()
        self._done_s = 0.0

    def finished(self, number: int) -> str | None:
        """Return the share done and the time left if a job was the last one of its stage."""
        if number not in self._jobs:
            return None
        stage = self._jobs.pop(number).stage
        self._done_s += self._cost_s[number]
        left = Counter(job.stage for job in self._jobs.values())
        if left[stage]:
            return None
        share = self._done_s / sum(self._cost_s.values())
        line = f"{stage} is finished: {100 * share:.0f} % of the run"
        if self._jobs:
            left_s = (time.monotonic() - self._started_s) * (1 - share) / share
            line += f", about {duration(left_s, digits=0)} left"
            line += f" ({counted(left.total(), 'job')}: {', '.join(left)})"
        return line

    def emit(self, record: Any) -> None:
        """Print the line of a stage with its last job."""
        line = self.finished(record.job_id) if _kind(record) == "job_finished" else None
        if line:
            print(line, file=sys.stderr, flush=True)


def read_runs(folder: str | os.PathLike) -> list[Run]:
    """All runs in the journal of a results folder, in order; no entry truncated by a crash."""
    path = Path(folder) / "status" / EVENTS
    runs: list[Run] = []
    try:
        lines = path.read_bytes().splitlines() if path.exists() else []
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    for line in lines:
        try:
            event = Event.model_validate_json(line)
        except ValidationError:
            continue
        if event.event == "run":
            runs.append(Run(event, event))
        elif runs:
            runs[-1].last = event
            if event.job is not None:
                runs[-1].state[event.job] = event.event
            if event.event == "failed":
                runs[-1].failed.append(event)
    return runs


def failures(folder: str | os.PathLike, runs: Sequence[Run]) -> list[tuple[Event, str]]:
    """Every failed attempt of every run, the oldest first, and what became of its job.

    That is ``retried`` in the same run, ``completed later``, or ``not completed``.
    """
    base = Path(folder).parent
    found = []
    for run in runs:
        for position, event in enumerate(run.failed):
            again = any(later.job == event.job for later in run.failed[position + 1 :])
            there = event.output and all((base / path).exists() for path in event.output)
            then = "completed later" if there else "not completed"
            retried = again or run.state.get(event.job) == "finished"
            found.append((event, "retried" if retried else then))
    return found


def end_of_file(path: str | os.PathLike, most_bytes: int) -> str:
    """The end of a text file."""
    with open(path, "rb") as stream:
        stream.seek(max(0, os.path.getsize(path) - most_bytes))
        return stream.read().decode(errors="replace")


def last_lines(path: str | os.PathLike, count: int = LOG_LINES) -> list[str]:
    """The last non-empty lines of a log, without control characters."""
    try:
        text = end_of_file(path, LOG_BYTES)
    except OSError as error:
        return [f"(no log: {error.strerror})"]
    lines = [
        "".join(letter if letter.isprintable() else " " for letter in line).rstrip()
        for line in text.replace("\r", "\n").splitlines()
    ]
    return [line for line in lines if line][-count:] or ["(the log is empty)"]


def _described(folder: Path, events: Sequence[Event], count: int = LOG_LINES) -> list[str]:
    """The last failures with the ends of their logs, an empty line after each."""
    lines = []
    for event in events[-MOST_FAILURES:]:
        made = ", ".join(event.output[:3]) + (" ..." if len(event.output) > 3 else "")
        lines.append(f"failed: {event.rule}, output {made}")
        for log in event.log:
            lines.append(f"  end of {log}:")
            lines += [f"    {line}" for line in last_lines(folder.parent / log, count)]
        lines.append("")
    if len(events) > MOST_FAILURES:
        lines += [f"and {len(events) - MOST_FAILURES} more failures", ""]
    return lines


def last_failures(folder: str | os.PathLike) -> str:
    """The failures of the last run, to be printed at the end of a failed run."""
    last = read_runs(folder)[-1:]
    # For a retried job, the last attempt.
    failed = {event.job: event for run in last for event in run.failed}
    standing = [event for job, event in failed.items() if last[0].state.get(job) == "failed"]
    advice = "Finished work is kept: fix the cause and repeat the command."
    return "\n".join(["", *_described(Path(folder), standing), advice] if standing else [])


def _state(job: Job, run: Run, base: Path) -> str:
    event = run.state.get(job.id)
    if event in ("failed", "started"):
        return "failed" if event == "failed" else "running"
    there = all((base / path).exists() for path in job.output)
    return "done" if there and (event == "finished" or not job.needed) else "waiting"


def _head(run: Run) -> str:
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.head.time))
    if run.success:
        took_s = max(0.0, run.last.time - run.head.time)
        times_s = took_s, run.last.jobs_cpu_s, run.last.own_cpu_s
        took, jobs, own = (duration(one, digits=0) for one in times_s)
        state = f"finished after {took}; CPU time of its jobs {jobs}, of Snakemake itself {own}"
    elif run.success is False:
        state = "stopped by a failure; fix the cause and repeat the snakemake command to continue"
    else:
        interrupted = "to continue: `snakemake --unlock`, then repeat the snakemake command"
        states = {None: "started on another machine", True: "running"}
        state = states.get(run.alive(), f"interrupted; {interrupted}")
    return f"Run of {began}: {state}."


def status(folder: str | Path, log_lines: int) -> tuple[str, bool]:
    """Return what to print of a results folder, and whether its last run stopped unfinished."""
    folder = Path(folder)
    runs, path = read_runs(folder), folder / "status" / PLAN
    if not runs or not path.exists():
        return f"{folder}: no snakemake run has started a job here.", False
    try:
        plan = Plan.model_validate_json(path.read_bytes()).jobs
    except (OSError, ValidationError):
        raise BadInput(f"{path}: damaged; the next run of snakemake regenerates it") from None
    run, found = runs[-1], failures(folder, runs)
    standing = [event for event, then in found if then == "not completed"]
    lines = _described(folder, standing, log_lines)
    if mended := len(found) - len(standing):
        lines += [f"{mended} earlier failed attempt{'s' * (mended > 1)} resolved since", ""]
    stages: dict[str, Counter] = {}
    for job in plan:
        stages.setdefault(job.stage, Counter())[_state(job, run, folder.parent)] += 1
    rows: list[tuple[str, ...]] = [("stage", *STATES)]
    for name, counts in [*stages.items(), ("total", sum(stages.values(), Counter()))]:
        others = [str(counts[state] or "-") for state in STATES[1:]]
        rows.append((name, f"{counts['done']}/{counts.total()}", *others))
    lines += [_head(run), "", *aligned(rows)]
    return "\n".join(lines), run.alive() is False and not run.success
