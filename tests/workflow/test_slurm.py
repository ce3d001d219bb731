"""The smoke chain through a Slurm of one node on loopback: the bits of the local run."""

import importlib.util
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest
from support import equal_results
from support.workflow_copy import Workflow

from slipstitch.config import load_config
from slipstitch.design.cost import MEMORY_MIB, job_memory_mb, job_runtime_min
from slipstitch.report.cost import read_benchmark

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "srun", "scontrol")
# The plugin takes every SLURM_ variable from its job steps: the configuration must lie here.
CONFIGURATION = Path("/etc/slurm/slurm.conf")
START_TIMEOUT_S = 60
RUN_TIMEOUT_S = 3600


def why_impossible() -> str:
    """What stands in the way of a Slurm of our own; empty if nothing does."""
    if importlib.util.find_spec("snakemake_executor_plugin_slurm") is None:
        return "Snakemake's Slurm plugin is not installed (make setup-cluster)"
    if os.geteuid() != 0:
        return "only root can start Slurm's daemons"
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        return f"no {', '.join(missing)} (apt-get install slurm-wlm munge)"
    if CONFIGURATION.exists():
        return f"{CONFIGURATION} is there already: a Slurm that is not ours"
    return ""


# Before any fixture: the local run that a cluster is compared with takes minutes.
IMPOSSIBLE = why_impossible()
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(IMPOSSIBLE), reason=IMPOSSIBLE)]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def configuration(folder: Path, host: str) -> str:
    return f"""
ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmctldPort={free_port()}
SlurmdPort={free_port()}
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
MinJobAge=300
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=8000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """A Slurm of one node with two cores; its state lies in a folder of its own."""
    folder = tmp_path_factory.mktemp("slurm")
    for part in folder, *folder.parents[:2]:
        part.chmod(0o755)  # munge refuses a socket that others cannot reach
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir(mode=0o755)
    munge, host = folder / "munge", socket.gethostname().split(".")[0]
    (munge / "key").write_bytes(os.urandom(1024))
    (munge / "key").chmod(0o400)
    CONFIGURATION.parent.mkdir(exist_ok=True)
    CONFIGURATION.write_text(configuration(folder, host))
    files = [f"--{name}-file={munge}/{name}" for name in ("key", "pid", "log", "seed")]
    daemons = []
    try:
        for words in (
            ["munged", "--foreground", "--force", f"--socket={munge}/socket", *files],
            ["slurmctld", "-D"],
            ["slurmd", "-D", "-N", host],
        ):
            with open(folder / f"{words[0]}.out", "wb") as log:
                daemons.append(subprocess.Popen(words, stdout=log, stderr=log))
            time.sleep(1.0)
        wait_until_idle(folder)
        yield folder
    finally:
        for daemon in reversed(daemons):
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(timeout=30)
        CONFIGURATION.unlink()


def wait_until_idle(folder: Path) -> None:
    for _ in range(START_TIMEOUT_S):
        answer = subprocess.run(["sinfo", "-h", "-o", "%T"], capture_output=True, text=True)
        if answer.stdout.strip() == "idle":
            return
        time.sleep(1.0)
    logs = "".join(path.read_text(errors="replace")[-2000:] for path in folder.glob("*.log"))
    pytest.fail(f"Slurm did not come up in {START_TIMEOUT_S} s: {answer.stderr}\n{logs}")


def through_slurm(workflow: Workflow, *words: str):
    """Run snakemake as docs/run-the-factory.md says."""
    return workflow.snakemake(
        "--profile", str(workflow.project / "profiles/slurm"),
        "--slurm-status-command", "squeue",
        "--slurm-init-seconds-before-status-checks", "1",
        "--slurm-keep-successful-logs",
        *words,
    )  # fmt: skip


# Rule -> the kind of its jobs in the cost model, where the rule's first word does not say it.
KIND = {
    "grid": "sample", "render_shading": "render", "render_images": "compose",
    "render_verification": "verify", "preview_one": "preview",
}  # fmt: skip


def jobs(workflow: Workflow) -> list[dict]:
    """The jobs of the plan of the last run."""
    return json.loads((workflow.folder / "results/status/plan.json").read_text())["jobs"]


@pytest.fixture(scope="module")
def cluster(slurm, tmp_path_factory):
    """The smoke chain made through Slurm."""
    workflow = Workflow(tmp_path_factory.mktemp("cluster"), scale="config/smoke.yaml")
    plugin = importlib.util.find_spec("snakemake_executor_plugin_slurm")
    workflow.more_python_path.append(Path(plugin.origin).parents[1])
    answer = through_slurm(workflow, "all")
    workflow.said = answer.stdout + answer.stderr
    assert answer.returncode == 0, workflow.said[-20000:]
    return workflow


def test_the_results_are_those_of_a_local_run_bit_by_bit(cluster, chain):
    there, here = (equal_results.digests(one.folder / "results") for one in (cluster, chain))
    assert len(here) > 60 and there == here


def test_a_simulation_with_its_images_is_one_submission_of_one_core(cluster):
    submitted = cluster.said.count("has been submitted with SLURM jobid")
    rules = Counter(job["rule"] for job in jobs(cluster))
    grouped = ("simulate_one", "render_shading", "render_images", "preview_one")
    alone = sum(count for rule, count in rules.items() if rule not in (*grouped, "grid"))
    assert submitted == alone + rules["simulate_one"]


def test_status_knows_the_jobs_that_went_through_slurm(cluster):
    answer = cluster.run("slipstitch", "status")
    assert answer.returncode == 0 and "finished after" in answer.stdout
    assert re.search(r"^total +(\d+)/\1 ", answer.stdout, re.M), answer.stdout


def test_memory_and_time_that_are_asked_for_hold_what_the_jobs_took(cluster):
    """No job took more than is declared, nor so little that the declaration were a guess."""
    config = load_config(cluster.folder / "results/config.json")
    largest: dict[str, float] = {}
    for job in jobs(cluster):
        done = job["benchmark"] and read_benchmark(cluster.folder / job["benchmark"])
        if done and not math.isnan(done.memory_mib):
            kind = KIND.get(job["rule"], job["rule"].partition("_")[0])
            largest[kind] = max(largest.get(kind, 0.0), done.memory_mib)
            assert done.wall_s < 60 * job_runtime_min(kind, config), job["output"]
    assert set(largest) == set(MEMORY_MIB)
    for kind, memory_mib in largest.items():
        declared_mib = job_memory_mb(kind, config) * 1e6 / 2**20
        assert 0.15 * declared_mib < memory_mib < 0.9 * declared_mib, kind
