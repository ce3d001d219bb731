"""Every stage names a damaged file that it reads, and says how to have it made anew."""

import json
import shutil

import pytest

from slipstitch.cli.main import main

ONE = "m00_f0100_r00"
PACKS = [f"results/render/shading/{ONE}_v00.parquet", f"results/render/shading/{ONE}_v01.parquet"]
SHARDS = [f"results/render/{ONE}_v00.parquet", f"results/render/{ONE}_v01.parquet"]
CONFIG = ["--config", "results/config.json"]
MODEL = "results/train/by_simulation/friction_baseline/seed0"


def truncated(content: bytes) -> bytes:
    return content[: len(content) * 2 // 3]


def flipped(content: bytes) -> bytes:
    """A bit of every hundredth byte: a single one may lie where nothing depends on it."""
    spoilt = bytearray(content)
    for place in range(50, len(spoilt), 100):
        spoilt[place] ^= 0x10
    return bytes(spoilt)


def emptied(content: bytes) -> bytes:
    return b""


DAMAGES = (truncated, flipped, emptied)

# What is damaged, and the command that reads it; {out} is a folder for what it would write.
READERS = {
    "calibrate": (
        "results/calibrate/sweep/base.json",
        ["calibrate", *CONFIG, "--sweeps", "results/calibrate/sweep/base.json",
         "--out", "{out}/c.json"],
    ),
    "simulate": (
        "results/calibrate/calibration.json",
        ["simulate", *CONFIG, "--calibration", "results/calibrate/calibration.json",
         "--simulation", ONE, "--out", "{out}/s.parquet"],
    ),
    "shade": (
        f"results/simulate/{ONE}.parquet",
        ["render", *CONFIG, "--trajectory", f"results/simulate/{ONE}.parquet",
         "--viewpoint", "v00", "--shading", "{out}/p.parquet"],
    ),
    "compose": (
        PACKS[0],
        ["render", *CONFIG, "--trajectory", f"results/simulate/{ONE}.parquet",
         "--from-shading", *PACKS, "--out-dir", "{out}/render"],
    ),
    "preview": (
        SHARDS[0],
        ["render", "--preview", "--out-sheet", "{out}/x.png", "--out-video", "{out}/x.mp4",
         *SHARDS],
    ),
    "verify": (
        SHARDS[0],
        ["render", *CONFIG, "--verify", "--trajectories", "results/simulate",
         "--packs", "results/render/shading", "--out", "{out}/v.json", SHARDS[0]],
    ),
    "sample": (
        SHARDS[1],
        ["sample", *CONFIG, "--out-dir", "{out}/sample", "{shards}"],
    ),
    "train": (
        "results/sample/m00_f0600_r00.parquet",  # which trains
        ["train", *CONFIG, "--dataset", "results/sample", "--network", "material_baseline",
         "--split", "by_simulation", "--seed", "0", "--out-dir", "{out}/model"],
    ),
    "train manifest": (
        "results/sample/manifest.parquet",
        ["train", *CONFIG, "--dataset", "results/sample", "--network", "material_baseline",
         "--split", "by_simulation", "--seed", "0", "--out-dir", "{out}/model"],
    ),
    "evaluate weights": (
        f"{MODEL}/model.safetensors",
        ["evaluate", *CONFIG, "--dataset", "results/sample", "--models", "results/train",
         "--out", "{out}/metrics.json", "--predictions", "{out}/predictions.parquet"],
    ),
    "evaluate card": (
        f"{MODEL}/model.json",
        ["evaluate", *CONFIG, "--dataset", "results/sample", "--models", "results/train",
         "--out", "{out}/metrics.json", "--predictions", "{out}/predictions.parquet"],
    ),
    "report": (
        "results/evaluate/metrics.json",
        ["report", *CONFIG, "--results", "results", "--out", "{out}/index.html"],
    ),
    "report predictions": (
        "results/evaluate/predictions.parquet",
        ["report", *CONFIG, "--results", "results", "--out", "{out}/index.html"],
    ),
    "release": (
        f"results/simulate/{ONE}.parquet",
        ["release", *CONFIG, "--results", "results", "--out-dir", "{out}/release"],
    ),
    "release sample": (
        f"results/sample/{ONE}.parquet",
        ["release", *CONFIG, "--results", "results", "--out-dir", "{out}/release"],
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def run(chain, tmp_path_factory):
    """A copy of the finished chain that may be damaged."""
    folder = tmp_path_factory.mktemp("damaged") / "run"
    ignored = shutil.ignore_patterns("release", ".snakemake")
    shutil.copytree(chain.folder, folder, ignore=ignored)
    return folder


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("reader", READERS)
def test_the_damaged_file_is_named_with_the_command_that_makes_it_anew(
    run, reader, damage, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(run)
    name, words = READERS[reader]
    shards = sorted(map(str, (run / "results/render").glob("m*_v*.parquet")))
    words = [word.format(out=tmp_path, shards="{shards}") for word in words]
    if "{shards}" in words:
        relative = [shard.removeprefix(f"{run}/") for shard in shards]
        words[words.index("{shards}") :] = relative
    path = run / name
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    try:
        status = main(words)
    finally:
        path.write_bytes(whole)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert status == 2
    assert f"error: {name}: " in said
    assert f"regenerate it with: snakemake --cores 2 all --forcerun {name}" in said
    assert not [one for one in tmp_path.rglob("*") if one.is_file()]


def test_what_was_not_damaged_is_read(run, monkeypatch, capsys):
    """The commands above fail for the damage alone."""
    monkeypatch.chdir(run)
    out = run / "results/again.html"
    assert main(["report", *CONFIG, "--results", "results", "--out", str(out)]) == 0
    assert json.loads((run / "results/evaluate/metrics.json").read_text())
