"""Estimate of a scale's cost against what a measured part of it predicts.

    python benchmarks/estimate.py [--scale config/paper.yaml] [--simulation m05_f06_r00]
        [--viewpoints v00 v01 v02] [--keep DIR]

Runs one simulation of the scale, its rendering from some viewpoints and its preview, each as the
workflow would (one thread, a process of its own), and sets CPU time and disk of the whole stage,
extrapolated from them, beside `slipstitch doctor --estimate`. A part that lies in DIR is not run
again. Demanded: within 25 %.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from slipstitch.config import load_config, write_config
from slipstitch.config.cost import estimate
from slipstitch.config.grid import simulations, viewpoints

ROOT = Path(__file__).parents[1]
TOLERANCE = 0.25


def measured(words: list[str], out: Path) -> dict[str, float]:
    """CPU seconds of a verb of slipstitch and bytes of the file it writes."""
    note = out.with_name(out.name + ".cost.json")
    if note.exists():
        return json.loads(note.read_text())
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "slipstitch", *words],
        env=os.environ | one_thread,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    cost = {"cpu_s": cpu_s, "bytes": out.stat().st_size}
    note.write_text(json.dumps(cost))
    return cost


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", default=str(ROOT / "config/paper.yaml"))
    parser.add_argument("--simulation", default="m05_f06_r00")
    parser.add_argument("--viewpoints", nargs="+", default=["v00", "v01", "v02"])
    parser.add_argument("--keep", type=Path, help="folder for the part, kept")
    arguments = parser.parse_args()
    config = load_config(ROOT / "config.yaml", arguments.scale)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        write_config(config, folder / "config.json")
        common = ["--config", str(folder / "config.json")]
        trajectory = folder / f"{arguments.simulation}.parquet"
        name = arguments.simulation
        simulated = measured(
            ["simulate", *common, "--simulation", name, "--out", str(trajectory)], trajectory
        )
        rendered, shards = [], []
        for view in arguments.viewpoints:
            shards.append(folder / f"{name}_{view}.parquet")
            words = ["--trajectory", str(trajectory), "--viewpoint", view]
            rendered.append(
                measured(["render", *common, *words, "--out", str(shards[-1])], shards[-1])
            )
        sheet, film = folder / "sheet.png", folder / "film.mp4"
        words = ["--out-sheet", str(sheet), "--out-video", str(film), *map(str, shards)]
        preview = measured(["render", "--preview", *words], sheet)
        preview["bytes"] += film.stat().st_size

    runs, views = len(simulations(config)), len(viewpoints(config))

    def mean(key: str) -> float:
        return sum(one[key] for one in rendered) / len(rendered)

    predicted = {
        "simulate": [runs * simulated[key] for key in ("cpu_s", "bytes")],
        "render": [runs * (views * mean(key) + preview[key]) for key in ("cpu_s", "bytes")],
    }
    good = True
    print(f"{'stage':<10} {'':<5} {'estimate':>10} {'predicted':>10}  ratio")
    for one in estimate(config):
        if one.stage in predicted:
            pairs = zip((one.cpu_s, one.disk_bytes), predicted[one.stage], strict=True)
            for what, scale, (stated, found) in zip(
                ("CPU h", "GB"), (3600, 1e9), pairs, strict=True
            ):
                ratio = stated / found
                good &= abs(ratio - 1) <= TOLERANCE
                print(
                    f"{one.stage:<10} {what:<5} {stated / scale:10.3f} {found / scale:10.3f}  "
                    f"{ratio:.2f}"
                )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
