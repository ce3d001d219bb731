"""State of the last run: jobs by stage, cost so far, time and disk space remaining."""

import csv
import math
import os
import re
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from slipstitch.config import Config
from slipstitch.design.cost import JOB_KINDS, estimate, job_cpu_s
from slipstitch.report.status.runs import Failure, Run, failures, read_plan, read_runs
from slipstitch.report.status.schedule import finish_times_s

# The cost model's job kind for rules where it differs from the rule's name.
KIND = {
    "grid": "sample",
    "render_shading": "render",
    "render_images": "compose",
    "render_verification": "verify",
    "preview_one": "preview",
}


SAID_CPU_TIME = re.compile(r"(?:^CPU time: |[,:] )(\d+\.\d+) (?:CPU )?s$", re.M)
SAID_EARLIER = re.compile(r"^wall time of earlier attempts: (\d+\.\d+) s$", re.M)


@dataclass(frozen=True)
class Measured:
    """Cost of a finished job from its benchmark file (s, MiB); NaN if it was too short."""

    wall_s: float
    cpu_s: float
    memory_mib: float


@dataclass
class StageProgress:
    """One stage of the run: its jobs by state, their cost (s), disk used and expected (bytes)."""

    name: str
    jobs: int = 0
    done: int = 0
    running: int = 0
    failed: int = 0
    waiting: int = 0
    cpu_s: float = 0.0
    left_s: float = 0.0
    disk_bytes: int = 0
    disk_to_come_bytes: float = 0.0


@dataclass(frozen=True)
class Running:
    """A job that was started and has not ended."""

    output: str
    rule: str
    since_s: float
    expected_s: float | None
    log: list[str]


@dataclass
class Status:
    """Everything that ``slipstitch status`` shows.

    Attributes
    ----------
    run : Run or None
        The last run; None if no run has left a journal.
    alive : bool or None
        Whether it still runs; None if that cannot be known here.
    stages : list of StageProgress
    running : list of Running
        Running jobs, or interrupted ones if the run has ended.
    failures : list of Failure
        Of all runs.
    left_s : float or None
        Time remaining in the run (s); None if the duration of a waiting job is unknown.
    """

    run: Run | None
    alive: bool | None
    stages: list[StageProgress] = field(default_factory=list)
    running: list[Running] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    left_s: float | None = None


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


def stage_of(job: dict[str, Any]) -> str:
    """The stage of a job: the folder below results/ that contains its output."""
    parts = Path(job["output"][0]).parts
    return parts[1] if len(parts) > 2 or (len(parts) == 2 and "." not in parts[1]) else "grid"


def kind_of(rule: str) -> str:
    """The cost model's job kind of a rule."""
    return KIND.get(rule, rule.partition("_")[0])


def _state(job: dict[str, Any], run: Run, base: Path) -> str:
    event = run.state.get(job["id"])
    if event == "failed":
        return "failed"
    if event == "started":
        return "running"
    there = all((base / path).exists() for path in job["output"])
    return "done" if there and (event == "finished" or not job["needed"]) else "waiting"


class Expectation:
    """Expected duration of a job: the median of its rule, else the corrected cost model.

    The correction is the ratio of measured to modelled time over all finished jobs.
    """

    def __init__(self, config: Config | None, done: list[tuple[dict[str, Any], Measured]]):
        self._config = config
        self._walls = defaultdict(list)
        modelled = taken = 0.0
        for job, measured in done:
            self._walls[job["rule"]].append(measured.wall_s)
            model_s = self._model_s(job)
            if model_s:
                modelled, taken = modelled + model_s, taken + measured.wall_s
        self.correction = taken / modelled if modelled else 1.0

    def _model_s(self, job: dict[str, Any]) -> float | None:
        kind = kind_of(job["rule"])
        if self._config is None or kind not in JOB_KINDS:
            return None
        return job_cpu_s(kind, self._config)

    def wall_s(self, job: dict[str, Any]) -> float | None:
        """Seconds; None if unknown to both."""
        if self._walls[job["rule"]]:
            return median(self._walls[job["rule"]])
        model_s = self._model_s(job)
        return None if model_s is None else model_s * self.correction


def folder_bytes(folder: Path) -> int:
    """Total size of the files below a folder."""
    total = 0
    for entry in os.walk(folder, onerror=None):
        for name in entry[2]:
            try:
                total += os.lstat(os.path.join(entry[0], name)).st_size
            except OSError:
                continue  # gone since: a running job's
    return total


def status(folder: str | os.PathLike, config: Config | None, now_s: float | None = None) -> Status:
    """State of the last run in a results folder.

    Parameters
    ----------
    folder : path
        The results folder.
    config : Config or None
        Its configuration; without it, only measured durations are used.
    now_s : float, optional
        Seconds since 1970; the present by default.

    Raises
    ------
    BadInput
        If the plan is damaged.
    """
    folder, now_s = Path(folder), time.time() if now_s is None else now_s
    runs, plan = read_runs(folder), read_plan(folder)
    if not runs or not plan:
        return Status(None, None, failures=failures(folder, runs))
    run = runs[-1]
    found = Status(run, run.alive(), failures=failures(folder, runs))
    base = folder.parent
    states = {job["id"]: _state(job, run, base) for job in plan}
    measured = {
        job["id"]: cost
        for job in plan
        if states[job["id"]] == "done"
        and job["benchmark"]
        and (cost := read_benchmark(base / job["benchmark"]))
    }
    expected = Expectation(
        config, [(job, measured[job["id"]]) for job in plan if job["id"] in measured]
    )
    stages = {stage_of(job): StageProgress(stage_of(job)) for job in plan}
    left_s, unknown = {}, False
    for job in plan:
        stage, state = stages[stage_of(job)], states[job["id"]]
        stage.jobs += 1
        setattr(stage, state, getattr(stage, state) + 1)
        if job["id"] in measured and not math.isnan(measured[job["id"]].cpu_s):
            stage.cpu_s += measured[job["id"]].cpu_s
        if state == "done":
            continue
        wall_s = expected.wall_s(job)
        if state == "running":
            since_s = run.started_s.get(job["id"], now_s)
            found.running.append(
                Running(job["output"][0], job["rule"], since_s, wall_s, job["log"])
            )
            if found.alive is not False and wall_s is not None:
                # A clock that was set back must not make a job longer.
                wall_s = max(0.0, wall_s - max(0.0, now_s - since_s))
        if wall_s is None:
            unknown = unknown or bool(job["benchmark"])
            continue
        stage.left_s += wall_s
        left_s[job["id"]] = wall_s
    if not unknown:
        after = {job["id"]: job["after"] for job in plan}
        threads = {job["id"]: job["threads"] for job in plan}
        ends_s = finish_times_s(left_s, after, max(1, run.head["cores"]), threads)
        found.left_s = max(ends_s.values(), default=0.0)
    _disk(folder, config, stages)
    found.stages = list(stages.values())
    return found


def _disk(folder: Path, config: Config | None, stages: dict[str, StageProgress]) -> None:
    """Fill in the disk space used by the stages, and expected for their remaining jobs."""
    model = {}
    if config is not None:
        model = {stage.stage: stage.disk_bytes for stage in estimate(config)}
    for stage in stages.values():
        stage.disk_bytes = folder_bytes(folder / stage.name)
        if stage.done == stage.jobs:
            continue
        whole = model.get(stage.name, 0.0)
        share_left = 1.0 - stage.done / stage.jobs
        # Once enough is finished, extrapolating is better than the model.
        if stage.done and share_left < 0.9:
            whole = stage.disk_bytes / (1.0 - share_left)
        stage.disk_to_come_bytes = whole * share_left
