"""Projected cost of 10^4 and 10^6 simulations: a cluster model with the measured costs of jobs.

The cost of jobs is that of `slipstitch.design.cost`; building graphs and running jobs that of
`benchmarks/dag.py`. A file system that all share serves bytes and operations in the order in which
jobs ask. With --replay, a finished run is played again from its jobs' measured times and compared
with how long it really took.
"""

import argparse
import heapq
import json
import random
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slipstitch.config import load_config
from slipstitch.design.cost import _video_bytes, estimate, job_cpu_s, job_memory_mb
from slipstitch.design.grid import films, simulations
from slipstitch.report.status.runs import read_plan, read_runs
from slipstitch.report.status.schedule import finish_times_s
from slipstitch.report.status.state import read_benchmark

ROOT = Path(__file__).parents[1]
# CPU s of one start of Snakemake on this project: `snakemake -n` of a small graph.
START_CPU_S = 2.3
# Simulations of one setting take 20 to 159 CPU s by friction: a factor of 1.7 either way.
SPREAD = 1.7
# A shared file system of a small cluster; an assumption, to be changed by --bytes-s and --ops-s.
BYTES_S, OPERATIONS_S = 1e9, 5e3
OPERATIONS_A_FILE = 6  # create, write, sync, rename, and two looks by Snakemake
# What `sbatch` and a status query take of the submitting process; an assumption.
SUBMISSION_S = 0.1


@dataclass(frozen=True)
class Work:
    """What one simulation with all its images asks for; its jobs go to the cluster as one."""

    cpu_s: float
    size_bytes: float
    files: int
    jobs: int


def work_of(config) -> Work:
    """One group of jobs, at the scale of a configuration."""
    runs = len(simulations(config))
    views = round(len(films(config)) / runs)
    kinds = ["simulate", *["render"] * views, "compose", "preview"]
    cpu_s = sum(job_cpu_s(kind, config) for kind in kinds)
    stages = {one.stage: one for one in estimate(config)}
    size = sum(stages[name].disk_bytes for name in ("simulate", "render", "sample")) / runs
    # Trajectory, packs, shards, previews and their records, dataset; logs, benchmarks; Snakemake's.
    files = 1 + 2 * views + 4 + 1 + 2 * (views + 3) + 2 * views + 4
    return Work(cpu_s + START_CPU_S * (1 + len(kinds)), size, files, len(kinds))


def play(count, cores, work, build_s, submit_s, bytes_s, operations_s, seed=1):
    """Makespan (s) of `count` groups, and the share of it in which cores worked.

    Every group is submitted in turn, waits for a core, computes, then writes its files.
    """
    chance = random.Random(seed)
    io_s = work.size_bytes / bytes_s + work.files * OPERATIONS_A_FILE / operations_s
    spread = [chance.uniform(1 / SPREAD, SPREAD) for _ in range(4096)]
    mean = sum(spread) / len(spread)
    events = [(0.0, "free")] * min(cores, count)
    started, ended, served_s, worked_s = 0, 0.0, 0.0, 0.0
    while events:
        now_s, what = heapq.heappop(events)
        if what == "write":
            served_s = max(served_s, now_s) + io_s
            heapq.heappush(events, (served_s, "free"))
            continue
        ended = max(ended, now_s)
        if started < count:
            begin_s = max(now_s, build_s + started * submit_s)
            took_s = work.cpu_s * spread[started % 4096] / mean
            worked_s += took_s
            heapq.heappush(events, (begin_s + took_s, "write"))
            started += 1
    return ended, worked_s / ended / min(cores, count)


def replay(results: Path) -> None:
    """Jobs of a finished run with their measured times, against how long it took."""
    plan, run = read_plan(results), read_runs(results)[-1]
    base = results.parent
    took = {}
    for job in plan:
        done = job["benchmark"] and read_benchmark(base / job["benchmark"])
        took[job["id"]] = done.wall_s if done else 0.5
    after = {job["id"]: job["after"] for job in plan}
    threads = {job["id"]: job["threads"] for job in plan}
    ends = finish_times_s(took, after, run.head["cores"], threads)
    real_s = run.last_s - run.head["time"]
    print(
        f"{len(plan)} jobs on {run.head['cores']} cores: played {max(ends.values()):.0f} s, "
        f"really {real_s:.0f} s; Snakemake's own CPU {run.own_cpu_s:.1f} s beside "
        f"{run.jobs_cpu_s:.1f} s of its jobs"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dag", type=Path, default=ROOT / "results/published/scale/dag.json")
    parser.add_argument("--simulations", type=int, nargs="+", default=[160, 10_000, 1_000_000])
    parser.add_argument("--cores", type=int, nargs="+", default=[64, 1000, 10_000])
    parser.add_argument("--shard", type=int, default=1000, help="simulations of one workflow")
    parser.add_argument("--at-once", type=int, default=16, help="workflows that submit at once")
    parser.add_argument("--bytes-s", type=float, default=BYTES_S)
    parser.add_argument("--ops-s", type=float, default=OPERATIONS_S)
    parser.add_argument("--replay", type=Path, help="results folder of a finished run")
    arguments = parser.parse_args()
    if arguments.replay:
        replay(arguments.replay)
        return
    dag = json.loads(arguments.dag.read_text())
    last, first = dag["building"][-1], dag["building"][0]
    graph = np.polynomial.Polynomial(dag["fit_cpu_s"])  # CPU s by jobs
    slope_mib = (last["memory_mib"] - first["memory_mib"]) / (last["jobs"] - first["jobs"])
    # Snakemake weighs every job that is ready against every other: what one costs grows with them.
    ready = [run["jobs"] / 2 for run in dag["running"]]
    each = [(run["cpu_s"] - run["start_cpu_s"]) / run["jobs"] for run in dag["running"]]
    choice_s, own_s = np.polyfit(ready, each, 1)
    config = load_config(ROOT / "config.yaml", ROOT / "config/paper.yaml")
    work = work_of(config)
    print(
        f"graph of 10^4 jobs: {graph(1e4):.0f} CPU s; {1024 * slope_mib:.0f} KiB a job; "
        f"running a job: {1e3 * own_s:.1f} ms of Snakemake's own CPU and {1e6 * choice_s:.0f} us "
        "for every job that is ready beside it"
    )
    print(
        f"a simulation: {work.jobs} jobs, {work.cpu_s:.0f} CPU s, {work.size_bytes / 1e6:.0f} MB, "
        f"{work.files} files; the paper's scale trains with {job_memory_mb('train', config)} MB"
    )
    for count in arguments.simulations:
        demands(count, config, work, graph, slope_mib)
        for cores in arguments.cores:
            print("  " + played(count, cores, work, (graph, own_s, choice_s), arguments))


def demands(count: int, config, work: Work, graph, slope_mib: float) -> None:
    """Say what so many simulations at the configuration's scale ask for."""
    runs, shown = len(simulations(config)), films(config)
    views, jobs = len(shown) / runs, count * work.jobs
    videos = sum(map(len, shown.values())) / runs
    train_gb = _video_bytes(config) / runs * count / 1e9
    sample_h = 2 * job_cpu_s("sample", config) / runs * count / 3600  # its table of ids is a job
    print(
        f"\n{count} simulations: {jobs} jobs, {count * work.cpu_s / 3600:.3g} CPU h, "
        f"{count * work.size_bytes / 1e12:.3g} TB, {count * work.files / 1e6:.3g} million files, "
        f"{count * views / 1e6:.3g} million in the largest folder"
    )
    print(
        f"  graph {graph(jobs) / 60:.3g} min, {jobs * slope_mib / 1024:.3g} GiB; "
        f"sampling in one job {sample_h:.3g} h; training holds {train_gb:.3g} GB; "
        f"manifest of {count * videos / 1e6:.3g} million rows"
    )


def played(count: int, cores: int, work: Work, costs: tuple, arguments) -> str:
    """One workflow for all, and one for every so many, in a line."""
    ideal_s = count * work.cpu_s / cores
    graph, own_s, choice_s = costs
    each_s = SUBMISSION_S + work.jobs * own_s
    whole_s, busy = play(
        count,
        cores,
        work,
        float(graph(count * work.jobs)),
        each_s + choice_s * count / 2,
        arguments.bytes_s,
        arguments.ops_s,
    )
    size = min(arguments.shard, count)
    workflows = -(-count // size)
    at_once = min(arguments.at_once, workflows)
    parts_s, parts_busy = play(
        count,
        cores,
        work,
        float(graph(size * work.jobs)),
        (each_s + choice_s * size / 2 + float(graph(size * work.jobs)) / size) / at_once,
        arguments.bytes_s * at_once,
        arguments.ops_s * at_once,
    )
    return (
        f"{cores} cores: ideal {ideal_s / 3600:.3g} h; one workflow {whole_s / 3600:.3g} h "
        f"({busy:.0%} busy); {workflows} of {size} simulations, {at_once} at once, a store each "
        f"{parts_s / 3600:.3g} h ({parts_busy:.0%})"
    )


if __name__ == "__main__":
    sys.exit(main())
