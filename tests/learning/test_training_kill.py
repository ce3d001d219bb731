"""A training whose process is killed goes on, by the same command, to an undisturbed run's bits."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors import SafetensorError, safe_open
from support import synthetic_videos

from slipstitch.base.provenance import read_sidecar
from slipstitch.cli.main import main
from slipstitch.config import write_config
from slipstitch.learning.checkpoint import CHECKPOINT
from slipstitch.report.cost import SAID_CPU_TIME

pytestmark = pytest.mark.slow

LIMIT_S = 300.0

ALWAYS = {"plateau_margin": None, "checkpoint_interval_s": 0.0}
SMALL = {"channels": [8, 8], "features": 8, "epochs": 12, "batch_size": 2}
CONFIG = synthetic_videos.config(
    render={"viewpoints": ["calibrated"], "pixels": 32},
    train={"epochs_per_cycle": 12, "fine_tuning_epochs": 0} | ALWAYS,
    instrument=SMALL | ALWAYS,
)


def command(folder: Path, verb: str, out: Path) -> list[str]:
    """The words of a training."""
    words = [verb, "--config", str(folder / "config.json"), "--dataset", str(folder / "sample")]
    words += ["--split", "by_simulation", "--seed", "0", "--out-dir", str(out)]
    return words + (["--network", "friction_baseline"] if verb == "train" else [])


def place(checkpoint: Path) -> tuple[int, int]:
    """Finished epochs and steps that a checkpoint holds; (0, 0) where there is none yet."""
    try:
        # "pt" would open it twice, and a training replaces it in between.
        with safe_open(checkpoint, "numpy") as file:
            progress = json.loads(file.metadata()["progress"])
    except (FileNotFoundError, SafetensorError):
        return 0, 0
    return progress["epoch"], progress["step"]


def killed_in_mid_epoch(words: list[str], checkpoint: Path) -> None:
    """Start a training in a process of its own and kill it (SIGKILL) after its first epoch."""
    process = subprocess.Popen(
        [sys.executable, "-m", "slipstitch", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + LIMIT_S
        while process.poll() is None and time.monotonic() < until:
            epoch, step = place(checkpoint)
            if epoch >= 1 and step >= 2:
                break
            time.sleep(0.01)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL, "it had ended before it could be killed"


@pytest.mark.parametrize(("verb", "model"), [("train", "model"), ("instrument", "instrument")])
def test_kill_9_and_the_same_command_again_give_the_bits_of_an_undisturbed_run(
    tmp_path, capsys, monkeypatch, verb, model
):
    """And the cost of both attempts: at the end of the job's log, and in the records."""
    folder, files = tmp_path, (f"{model}.safetensors", f"{model}.json", "history.csv")
    synthetic_videos.write_dataset(CONFIG, folder)
    write_config(CONFIG, folder / "config.json")
    out, undisturbed = folder / "killed", folder / "undisturbed"
    words = command(folder, verb, out)
    killed_in_mid_epoch(words, out / CHECKPOINT)
    assert not (out / files[0]).exists()
    epoch, step = place(out / CHECKPOINT)
    with safe_open(out / CHECKPOINT, "numpy") as file:
        wall_s, cpu_s = json.loads(file.metadata()["taken_s"])
    assert cpu_s > 0 and 0 < wall_s < LIMIT_S
    monkeypatch.setenv("SLIPSTITCH_CPU_TIME", "1")
    before_s = sum(os.times()[:4])
    assert main(words) == 0
    after_s = sum(os.times()[:4])
    said = capsys.readouterr().err
    assert f"epoch {epoch + 1}, step {step + 1}" in said
    assert f"\nwall time of earlier attempts: {wall_s:.2f} s\nCPU time: " in said
    told_s = float(SAID_CPU_TIME.findall(said)[-1])
    assert before_s - 0.01 < told_s - cpu_s < after_s + 0.01  # which it is rounded to
    for name in files:
        recorded = read_sidecar(out / name)
        assert cpu_s < recorded["cpu_s"] < cpu_s + after_s - before_s + 0.01
        assert recorded["wall_s"] > wall_s
    assert main(command(folder, verb, undisturbed)) == 0
    for name in files:
        assert (out / name).read_bytes() == (undisturbed / name).read_bytes(), name
    assert not (out / CHECKPOINT).exists()
