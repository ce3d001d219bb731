"""The journal of a workflow run: a plan of its jobs, then a line for every event.

Snakemake hands its events to `Journal` as structured log records; no text is parsed.
Only the main process writes, from the first job's start on: a dry run, or a run that has nothing to
do, leaves no trace.
"""

import json
import logging
import os
import resource
import time
from pathlib import Path
from typing import Any

from slipstitch.base.provenance import write_json

FOLDER = Path("results/status")
PLAN = "plan.json"
EVENTS = "journal.jsonl"


def process_identity() -> dict[str, Any]:
    """Unique identity of this process on this machine, without naming the machine."""
    return {"pid": os.getpid(), "born": process_birth(os.getpid()), "boot": boot_identity()}


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


def plan_of(dag) -> list[dict[str, Any]]:
    """The jobs of Snakemake's graph with output files, in the order of their ids."""
    needed = set(dag.needrun_jobs())
    jobs = [
        {
            "id": dag.jobid(job),
            "rule": job.rule.name,
            "output": [str(file) for file in job.output],
            "log": [str(file) for file in job.log],
            "benchmark": None if job.benchmark is None else str(job.benchmark),
            "threads": job.threads,
            "needed": job in needed,
            "after": sorted(dag.jobid(before) for before in dag.dependencies[job] if before.output),
        }
        for job in dag.jobs
        if job.output
    ]
    return sorted(jobs, key=lambda job: job["id"])


def _cpu_s(who: int) -> float:
    usage = resource.getrusage(who)
    return round(usage.ru_utime + usage.ru_stime, 2)


class Journal(logging.Handler):
    """Writes the events of one run; a handler of Snakemake's logger.

    Parameters
    ----------
    folder : path
        Folder of plan and journal; relative to the working folder when the first job starts.
    """

    def __init__(self, folder: str | os.PathLike = FOLDER):
        super().__init__()
        self._folder = Path(folder)
        self._begun = False

    def begin(self, dag, cores: int) -> None:
        """Write the plan and the first entry of the run."""
        self._begun = True
        plan = plan_of(dag)
        write_json(self._folder / PLAN, {"jobs": plan}, indent=None)
        needed = sum(job["needed"] for job in plan)
        self._write("run", cores=cores, jobs=len(plan), needed=needed, **process_identity())

    def end(self, success: bool) -> None:
        """Write how the run ended, and the CPU time of Snakemake itself and of its jobs (s)."""
        if self._begun:
            own, jobs = _cpu_s(resource.RUSAGE_SELF), _cpu_s(resource.RUSAGE_CHILDREN)
            self._write("end", success=success, own_cpu_s=own, jobs_cpu_s=jobs)

    def emit(self, record: Any) -> None:
        """Write the job events among Snakemake's log records."""
        if not self._begun:
            return
        event = getattr(getattr(record, "event", None), "value", None)
        if event == "job_info":
            self._write("started", job=record.jobid)
        elif event == "job_finished":
            self._write("finished", job=record.job_id)
        elif event == "job_error":
            self._write(
                "failed",
                job=record.jobid,
                rule=record.rule_name,
                output=list(map(str, record.output)),
                log=list(map(str, record.log)),
            )

    def _write(self, event: str, **what: Any) -> None:
        line = json.dumps({"event": event, "time": round(time.time(), 3), **what})
        try:
            with open(self._folder / EVENTS, "a", encoding="utf-8") as stream:
                stream.write(line + "\n")
        except OSError as error:  # a full disk must not turn logging into a failure
            logging.getLogger(__name__).debug("journal: %s", error)
