"""The workflow where disks are full, processes are killed, clocks jump and people do two things."""

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import time
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from support import equal_results, kills
from support.stage_commands import TRAJECTORY, words_of

from slipstitch.config.load import load_config
from slipstitch.design.grid import simulations

pytestmark = pytest.mark.slow

ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a file system")


def start_all(undisturbed) -> subprocess.Popen:
    """The whole chain, once a job of it runs."""
    words = undisturbed.snakemake_words("--quiet", "all", "--", "all")
    return kills.start_until_a_job_runs(undisturbed, words)


def finished(undisturbed, reference, *words: str) -> None:
    """Give the command again: it ends well, and the results are those of the undisturbed run."""
    assert undisturbed.snakemake(*(words or ("all",))).returncode == 0
    assert kills.differences(undisturbed.folder, reference, partial=False) == []


@contextlib.contextmanager
def mounted(folder: Path, *commands: str):
    """A file system that commands mount at `folder`, for the time of the block."""
    folder.mkdir(exist_ok=True)
    for command in commands:
        subprocess.run([*command.split(), folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def small_disk(folder: Path, size: str):
    """A file system of so many bytes at `folder`."""
    return mounted(folder, f"mount -t tmpfs -o size={size} tmpfs")


# Every writing stage.
WRITERS = (
    "grid", "sweep", "simulate by hand", "shade", "compose", "preview", "sample", "train",
    "evaluate", "instrument", "capture", "criticise", "report", "release",
)  # fmt: skip


@ROOT_ONLY
@pytest.mark.parametrize("stage", WRITERS)
def test_a_full_disk_is_one_line_and_leaves_nothing_half_written(undisturbed, stage, tmp_path):
    with small_disk(tmp_path / "disk", "16k") as disk:
        (disk / "ballast").write_bytes(bytes(16 * 1024))
        answer = undisturbed.run("slipstitch", *words_of(stage, undisturbed.folder, disk))
        there = sorted(path.name for path in disk.rglob("*") if path.is_file())
    assert answer.returncode == 1 and "Traceback" not in answer.stderr, answer.stderr
    last = answer.stderr.splitlines()[-1]
    assert re.search("no space left|free on that disk", last), answer.stderr
    assert there == ["ballast"]


@ROOT_ONLY
def test_a_disk_that_fills_up_during_a_run_and_is_emptied_again(undisturbed, reference, tmp_path):
    kills.remove(undisturbed, "simulate_one")
    target = undisturbed.folder / "results/simulate"
    kept_kib = sum(path.stat().st_size // 1024 + 4 for path in target.iterdir())
    with small_disk(tmp_path / "disk", f"{kept_kib + 24}k") as disk:
        shutil.copytree(target, disk, dirs_exist_ok=True)
        kept = target.with_name("simulate_kept")
        target.rename(kept)
        target.symlink_to(disk)
        answer = undisturbed.snakemake("simulate")
        assert answer.returncode == 1 and "no space left on device" in answer.stderr
        assert "Finished work is kept: fix the cause and repeat the command" in answer.stderr
        target.unlink()
        kept.rename(target)
    finished(undisturbed, reference)


def test_the_command_that_is_named_makes_a_damaged_file_anew(undisturbed, reference):
    damaged = undisturbed.folder / TRAJECTORY
    damaged.write_bytes(damaged.read_bytes()[:-100])
    answer = undisturbed.snakemake("all")
    assert answer.returncode == 1
    last = answer.stderr[answer.stderr.index("failed: render_shading") :]
    command = re.search("regenerate it with: snakemake --cores 2 (all --forcerun [^ \n]+)", last)
    finished(undisturbed, reference, *command[1].split())


def test_two_runs_at_once_in_one_folder(undisturbed, reference):
    """The second is turned away and says how to go on; the first is not disturbed."""
    kills.remove(undisturbed, "simulate_one")
    first = start_all(undisturbed)
    second = undisturbed.snakemake("all")
    said = second.stdout + second.stderr
    assert second.returncode == 1 and "cannot be locked" in said and "--unlock" in said
    assert first.wait(timeout=1200) == 0
    assert kills.differences(undisturbed.folder, reference, partial=False) == []


def test_the_configuration_may_be_edited_during_a_run(undisturbed, reference):
    """The run goes on with what it began with; the next one makes what has changed."""
    kills.remove(undisturbed, "simulate_one")
    process = start_all(undisturbed)
    file = undisturbed.project / "config/smoke.yaml"
    before = file.read_text()
    try:
        file.write_text(before.replace("frames: 6", "frames: 5"))
        assert process.wait(timeout=1200) == 0
        assert kills.differences(undisturbed.folder, reference, partial=False) == []
        assert load_config(undisturbed.folder / "results/config.json").sample.frames == 6
        assert any(name.startswith("sample/") for name in undisturbed.pending())
    finally:
        file.write_text(before)
    assert undisturbed.pending() == set()


def test_a_clock_that_ran_ahead_makes_nothing_anew_in_vain(undisturbed, reference):
    """Files from next year look newer than all that is made from them; contents are compared."""
    ahead = (datetime.now() + timedelta(days=365)).timestamp()
    for one in simulations(load_config(undisturbed.folder / "results/config.json")):
        os.utime(undisturbed.folder / f"results/simulate/{one.id}.parquet", (ahead, ahead))
    assert undisturbed.pending() == set()
    by_time_alone = ("--max-checksum-file-size", "0")  # as for files above Snakemake's limit, 1 MB
    assert any(name.startswith("render/") for name in undisturbed.pending(*by_time_alone))
    assert undisturbed.snakemake("all", "--touch", "--forceall").returncode == 0
    assert undisturbed.pending(*by_time_alone) == set()
    assert kills.differences(undisturbed.folder, reference, partial=False) == []


@ROOT_ONLY
def test_results_that_cannot_be_written_are_said_to_be_so(undisturbed, reference):
    folder = undisturbed.folder / "results/simulate"
    kills.remove(undisturbed, "simulate_one")
    with mounted(folder, f"mount --bind {folder}", "mount -o remount,ro,bind"):
        answer = undisturbed.snakemake("simulate")
    assert answer.returncode == 1
    assert "not writable (read-only file system or missing permission)" in answer.stderr
    assert "Traceback" not in answer.stderr
    finished(undisturbed, reference)


@pytest.mark.parametrize("limit_mb", [600, 2100, 3000])
@pytest.mark.parametrize("stage", ["simulate by hand", "compose", "sample", "train"])
def test_a_memory_limit_leaves_nothing_half_written(undisturbed, stage, limit_mb, tmp_path):
    """Done or failed, never half; libraries may end the process before we can say why."""
    run = undisturbed.folder
    words = ["slipstitch", *words_of(stage, run, tmp_path / "out")]
    limit = limit_mb * 2**20
    answer = subprocess.run(
        words, cwd=run, env=undisturbed.environment(), capture_output=True, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)), timeout=1800,
    )  # fmt: skip
    there = [path.suffix for path in tmp_path.rglob("*") if path.is_file()]
    if answer.returncode == 0:
        assert there
    else:
        assert not {".parquet", ".json", ".safetensors"} & set(there)


def test_an_interrupt_by_hand_leaves_no_lock(undisturbed, reference):
    kills.remove(undisturbed, "simulate_one")
    process = start_all(undisturbed)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=600) != 0
    finished(undisturbed, reference)


def test_five_kills_on_the_way_and_the_result_is_the_same(undisturbed, reference):
    """Everything is killed at a random moment, five times in one run of the chain."""
    chance = random.Random(5)
    kills.remove(undisturbed, "simulate_one", "render_shading", "sample_all", "train_one")
    words = undisturbed.snakemake_words("--quiet", "all", "--", "all")
    for _ in range(5):
        process = kills.start(undisturbed, words)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=chance.uniform(2.0, 25.0))
        kills.kill(process, "machine")
        process.wait()
        assert kills.differences(undisturbed.folder, reference, partial=True) == []
        assert undisturbed.snakemake("--unlock").returncode == 0
    finished(undisturbed, reference)
    assert equal_results.leftovers(undisturbed.folder / "results") == []


@pytest.mark.parametrize("rule", ["simulate_one", "render_shading", "train_one"])
@pytest.mark.parametrize("victim", ["worker", "snakemake"])
def test_whoever_is_killed_the_same_command_goes_on(undisturbed, pristine, reference, rule, victim):
    job = next(one for one in kills.jobs(pristine) if one["rule"] == rule)
    done = kills.kill_and_resume(undisturbed, pristine, reference, job, victim, random.Random(rule))
    assert done.problems == []
