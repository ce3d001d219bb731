"""Overhead of Snakemake: building graphs of 10^3 and 10^4 jobs, running trivial jobs.

The graphs are the project's own, of grids of different sizes; CPU seconds and memory are those of
the process of a dry run. For the cost of running, a workflow of jobs that only touch a file.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
PAPER_VIEWS = 9  # three, and six turned ones
JOBS_A_SIMULATION = 3 + PAPER_VIEWS


def measured(words: list[str], folder: Path) -> dict[str, float]:
    """CPU seconds of the process without its children's, wall seconds and memory of a command."""
    code = (
        "import json, resource, runpy, sys, atexit\n"
        "def say():\n"
        "    own = resource.getrusage(resource.RUSAGE_SELF)\n"
        "    jobs = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "    open(sys.argv.pop(), 'w').write(json.dumps([own.ru_utime + own.ru_stime,\n"
        "        jobs.ru_utime + jobs.ru_stime, own.ru_maxrss / 1024]))\n"
        "out = sys.argv.pop(1)\n"
        "atexit.register(lambda: (sys.argv.append(out), say()))\n"
        "from snakemake.cli import main\n"
        "main(sys.argv[1:])\n"
    )
    out = folder / "cost.json"
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    began = time.monotonic()
    answer = subprocess.run(
        [sys.executable, "-c", code, str(out), *words],
        cwd=folder, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    if answer.returncode != 0:
        sys.exit((answer.stdout + answer.stderr)[-4000:])
    own, jobs, memory = json.loads(out.read_text())
    return {
        "cpu_s": own, "jobs_cpu_s": jobs, "memory_mib": memory, "wall_s": time.monotonic() - began
    }  # fmt: skip


def grid(jobs: int) -> dict:
    """A configuration of the paper's kind with about so many jobs."""
    paper = yaml.safe_load((ROOT / "config/paper.yaml").read_text(encoding="utf-8"))
    simulations = max(1, jobs // JOBS_A_SIMULATION)
    materials = paper["grid"]["materials"]
    frictions = max(1, min(16, simulations // len(materials)))
    replicates = max(1, round(simulations / len(materials) / frictions))
    paper["grid"] |= {
        "frictions": [round(0.1 * k, 1) for k in range(frictions)], "replicates": replicates
    }  # fmt: skip
    return paper


def building(jobs: int, folder: Path) -> dict[str, float]:
    """A dry run of a grid with about so many jobs, nothing of it made yet."""
    config = folder / "grid.yaml"
    content = grid(jobs)
    config.write_text(yaml.safe_dump(content))
    done = measured(
        ["--snakefile", str(ROOT / "Snakefile"), "--configfile", str(config), "--cores", "2",
         "--quiet", "all", "--dry-run", "--", "all"], folder,
    )  # fmt: skip
    runs = len(content["grid"]["materials"]) * len(content["grid"]["frictions"])
    runs *= content["grid"]["replicates"]
    return {"simulations": runs, "jobs": runs * JOBS_A_SIMULATION + 18, **done}


def running(jobs: int, folder: Path) -> dict[str, float]:
    """Jobs that do nothing but touch a file and are all ready at once."""
    (folder / "Snakefile").write_text(
        textwrap.dedent(f"""
        rule all:
            input: expand("out/{{k}}", k=range({jobs}))
        rule one:
            output: "out/{{k}}"
            log: "log/{{k}}"
            benchmark: "bench/{{k}}"
            shell: "touch {{output}} > {{log}} 2>&1"
        """)
    )
    words = ["--cores", "2", "--quiet", "all", "--", "all"]
    done = measured(words, folder)
    start = measured(["--dry-run", *words], folder)["cpu_s"]
    return {"jobs": jobs, **done, "start_cpu_s": start}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, nargs="+", default=[100, 1000, 3000, 10_000])
    parser.add_argument("--run", type=int, nargs="+", default=[50, 200, 800])
    parser.add_argument("--out", type=Path, help="JSON file")
    arguments = parser.parse_args()
    result = {"load": os.getloadavg()[0], "building": [], "running": []}
    for jobs in arguments.jobs:
        with tempfile.TemporaryDirectory() as folder:
            one = building(jobs, Path(folder))
        result["building"].append(one)
        print(
            f"graph of {one['jobs']} jobs ({one['simulations']} simulations): "
            f"{one['cpu_s']:.1f} CPU s, {one['wall_s']:.0f} s, {one['memory_mib']:.0f} MiB",
            flush=True,
        )
    for jobs in arguments.run:
        with tempfile.TemporaryDirectory() as folder:
            one = running(jobs, Path(folder))
        result["running"].append(one)
        each = 1000 * (one["cpu_s"] - one["start_cpu_s"]) / jobs
        print(f"running {jobs} jobs: {each:.1f} ms of Snakemake's own CPU a job", flush=True)
    sizes = np.array([one["jobs"] for one in result["building"]], float)
    cpu_s = np.array([one["cpu_s"] for one in result["building"]])
    if len(sizes) > 2:
        terms = np.stack([np.ones_like(sizes), sizes, sizes**2], axis=1)
        result["fit_cpu_s"] = np.linalg.lstsq(terms / cpu_s[:, None], np.ones_like(cpu_s), None)[
            0
        ].tolist()
        a, b, c = result["fit_cpu_s"]
        print(f"CPU s = {a:.2f} + {b:.2e} n + {c:.2e} n²")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"largest memory: {peak:.0f} MiB; load {result['load']:.1f}")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
