"""Every stage names a damaged file that it reads, and says how to have it made anew."""

import shutil

import numpy as np
import pytest
from support.stage_commands import ONE, PACKS, SHARDS, SWEEP, TRAJECTORY, words_of

from slipstitch.cli.main import main

pytestmark = pytest.mark.slow

MODEL = "results/train/by_simulation/friction_baseline/seed0"


def flipped(content: bytes) -> bytes:
    """A bit of every hundredth byte: a single one may lie where nothing depends on it."""
    spoilt = np.frombuffer(content, np.uint8).copy()
    spoilt[50::100] ^= 0x10
    return spoilt.tobytes()


DAMAGES = {
    "truncated": lambda content: content[: len(content) * 2 // 3],
    "flipped": flipped,
    "emptied": lambda content: b"",
}
# What is damaged, and the stage that reads it.
DAMAGED = [
    (SWEEP, "calibrate"),
    ("results/calibrate/calibration.json", "simulate"),
    *((TRAJECTORY, stage) for stage in ("shade", "release")),
    (PACKS[0], "compose"),
    *((SHARDS[0], stage) for stage in ("preview", "verify")),
    (SHARDS[1], "sample"),
    ("results/sample/m00_f0600_r00.parquet", "train"),  # which trains
    ("results/sample/manifest.parquet", "train"),
    (f"results/sample/{ONE}.parquet", "release"),
    *((f"{MODEL}/model.{kind}", "evaluate") for kind in ("safetensors", "json")),
    *((f"results/evaluate/{name}", "report") for name in ("metrics.json", "predictions.parquet")),
]


@pytest.fixture(scope="module")
def run(chain, tmp_path_factory):
    """A copy of the finished chain that may be damaged."""
    folder = tmp_path_factory.mktemp("damaged") / "run"
    ignored = shutil.ignore_patterns("release", ".snakemake")
    shutil.copytree(chain.folder, folder, ignore=ignored)
    return folder


@pytest.mark.parametrize(("name", "stage"), DAMAGED)
@pytest.mark.parametrize("damage", DAMAGES)
def test_the_damaged_file_is_named_with_the_command_that_makes_it_anew(
    run, name, stage, damage, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(run)
    path = run / name
    whole = path.read_bytes()
    path.write_bytes(DAMAGES[damage](whole))
    try:
        status = main(words_of(stage, run, tmp_path))
    finally:
        path.write_bytes(whole)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert status == 2
    assert f"error: {name}: " in said
    assert f"regenerate it with: snakemake --cores 2 all --forcerun {name}" in said
    assert not [one for one in tmp_path.rglob("*") if one.is_file()]


def test_what_was_not_damaged_is_read(run, tmp_path, monkeypatch):
    """The commands above fail for the damage alone."""
    monkeypatch.chdir(run)
    assert main(words_of("preview", run, tmp_path)) == 0
    assert (tmp_path / "x.png").stat().st_size > 0
