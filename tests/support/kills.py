"""kill -9 at a random moment of one job of the chain, then the same command again."""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import psutil

from slipstitch.report.cost import read_benchmark
from support import equal_results
from support.workflow_copy import Workflow

# Who is killed: everything (the machine), the process that works, or Snakemake alone, whose job
# then goes on while the same command is given again.
VICTIMS = ("machine", "machine", "worker", "snakemake")
START_TIMEOUT_S = 600.0


@dataclass(frozen=True)
class Kill:
    """One kill and what came of it."""

    rule: str
    output: str
    victim: str
    after_s: float  # after the job's start; negative while Snakemake was still preparing it
    hit: bool  # whether anything was still running to be killed
    locked: bool  # whether ``snakemake --unlock`` was needed
    problems: list[str]  # empty if what was there was whole, and the end result is the reference's


def unprotect(folder: Path) -> None:
    """Give a release's files back the right to be removed."""
    if folder.exists():
        for path in [folder, *folder.rglob("*")]:
            path.chmod(0o755 if path.is_dir() else 0o644)


def copy_run(source: Path, target: Path) -> None:
    """A run folder as it is, times of its files included."""
    unprotect(target / "results/release")
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, symlinks=True)


def jobs(run: Path) -> list[dict]:
    """The jobs of the plan of the folder's last run whose files are there."""
    plan = json.loads((run / "results/status/plan.json").read_text())["jobs"]
    return [job for job in plan if all((run / name).exists() for name in job["output"])]


def wall_s(run: Path, job: dict) -> float:
    """What a job took when it was left alone."""
    if job["benchmark"] is None or not (run / job["benchmark"]).exists():
        return 1.0
    return read_benchmark(run / job["benchmark"]).wall_s


def remove_outputs(run: Path, job: dict) -> None:
    for name in job["output"]:
        path = run / name
        if path.is_dir():
            unprotect(path)
            shutil.rmtree(path)
        else:
            path.unlink()
            path.with_name(path.name + ".provenance.json").unlink(missing_ok=True)


def tree(process: psutil.Process) -> list[psutil.Process]:
    with contextlib.suppress(psutil.NoSuchProcess):
        return [process, *process.children(recursive=True)]
    return []


def remove(workflow: Workflow, *rules: str) -> None:
    """Take away what the first job of each rule made."""
    plan = jobs(workflow.folder)
    for rule in rules:
        remove_outputs(workflow.folder, next(job for job in plan if job["rule"] == rule))


def kill(process: subprocess.Popen, victim: str) -> bool:
    """Kill without a warning; False if nothing was left to be killed."""
    chosen = tree(psutil.Process(process.pid)) if process.poll() is None else []
    if victim == "snakemake":
        chosen = chosen[:1]
    elif victim == "worker":
        chosen = [one for one in chosen if is_worker(one)] or chosen[-1:]
    for one in chosen:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.send_signal(signal.SIGKILL)
    return bool(chosen)


def is_worker(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.NoSuchProcess):
        words = process.cmdline()[1:2]
        return any(word.endswith("/slipstitch") or "slipstitch." in word for word in words)
    return False


def events(run: Path) -> list[str]:
    """The lines of the journal."""
    journal = run / "results/status/journal.jsonl"
    return journal.read_text().splitlines() if journal.exists() else []


def wait_for_start(run: Path, process: subprocess.Popen, before: int) -> None:
    """Wait until the journal says that a job has started, or the process has ended."""
    until = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < until:
        started = any('"started"' in line for line in events(run)[before:])
        if started or process.poll() is not None:
            return
        time.sleep(0.02)
    raise TimeoutError("snakemake started no job")


def differences(run: Path, reference: dict[str, str], partial: bool) -> list[str]:
    """Files that are not the reference's; with `partial`, files may be absent."""
    try:
        found = equal_results.digests(run / "results")
    except Exception as error:  # whatever a half-written file raises
        return [f"half-written: {error}"]
    names = found.keys() & reference.keys() if partial else found.keys() | reference.keys()
    return sorted(name for name in names if found.get(name) != reference.get(name))


def kill_and_resume(
    workflow: Workflow,
    pristine: Path,
    reference: dict[str, str],
    job: dict,
    victim: str,
    chance: random.Random,
    by_command: bool = True,
) -> Kill:
    """One job is made again, killed at a random moment, and made with the same command once more.

    The workflow's folder is overwritten from `pristine`, an undisturbed run, whose results have the
    digests `reference`. A lock is cleared by `by_command` or, sparing its start, as that does.
    """
    run = workflow.folder
    copy_run(pristine, run)
    remove_outputs(run, job)
    target = "release" if job["rule"] == "release_folder" else job["output"][0]
    words = workflow.snakemake_words("--quiet", "all", "--", target)
    before = len(events(run))
    process = start(workflow, words)
    if chance.random() < 0.1:  # while Snakemake prepares
        after_s = -chance.uniform(0.0, 2.0)
        time.sleep(2.0 + after_s)
    else:
        wait_for_start(run, process, before)
        after_s = chance.uniform(0.0, 1.1 * wall_s(pristine, job) + 0.5)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=after_s)
    hit = kill(process, victim)
    process.wait()
    problems = [f"after the kill: {name}" for name in differences(run, reference, partial=True)]
    locked = any((run / ".snakemake/locks").glob("*"))
    if locked and by_command:
        unlocking = workflow.snakemake("--unlock")
        if unlocking.returncode != 0:
            problems.append(f"unlocking failed: {unlocking.stderr[-500:]}")
    elif locked:  # what the command does
        shutil.rmtree(run / ".snakemake/locks")
    where = {"cwd": run, "env": workflow.environment(), "start_new_session": True}
    answer = subprocess.run(words, **where, capture_output=True, text=True)
    if answer.returncode != 0:
        problems.append(f"resuming failed: {(answer.stdout + answer.stderr)[-2000:]}")
    wait_for_orphans(run)
    problems += differences(run, reference, partial=False)
    problems += [f"left behind: {name}" for name in equal_results.leftovers(run / "results")]
    return Kill(job["rule"], job["output"][0], victim, after_s, hit, locked, problems)


def start(workflow: Workflow, words: list[str]) -> subprocess.Popen:
    """Start a command that an interrupt stops, also where those of the tests are ignored."""
    silent = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    where = {"cwd": workflow.folder, "env": workflow.environment(), "start_new_session": True}
    stopped = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    return subprocess.Popen(words, **where, **silent, **stopped)


def start_until_a_job_runs(workflow: Workflow, words: list[str]) -> subprocess.Popen:
    """Start Snakemake and wait for its first job's start."""
    before = len(events(workflow.folder))
    process = start(workflow, words)
    wait_for_start(workflow.folder, process, before)
    return process


def wait_for_orphans(run: Path, timeout_s: float = 120.0) -> None:
    """Wait for jobs whose Snakemake was killed: they work in the same folder."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until and any(map(partial(works_in, run), psutil.process_iter())):
        time.sleep(0.2)


def works_in(run: Path, process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error, OSError):
        other = process.pid != os.getpid() and process.cwd() == str(run)
        return other and process.status() != psutil.STATUS_ZOMBIE
    return False
