"""Estimated cost of a scale against an extrapolation from a measured part of it.

    python benchmarks/estimate.py [--scale config/paper.yaml] [--simulation m05_f0600_r00]
        [--viewpoints v00 v01 v02 v09] [--keep DIR]

Runs one simulation of the scale and renders it as the workflow would (light, images, preview; one
thread, a process of its own each): once on a matte floor and once on one that mirrors, if the
scale's simulations draw both. CPU time and disk of the whole stages, extrapolated from them, stand
beside `slipstitch doctor --estimate`. A part that lies in DIR is not run again. Demanded: within
25 %. The images that the render stage verifies are not measured: the estimate's figure for them is
added to both.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from slipstitch.config import Config, load_config, write_config
from slipstitch.design.cost import estimate, verification_cpu_s
from slipstitch.design.grid import films, simulations
from slipstitch.images.surroundings import draw_surroundings

ROOT = Path(__file__).parents[1]
TOLERANCE = 0.25


def measured(words: list[str], outs: list[Path]) -> dict[str, float]:
    """CPU seconds of a verb of slipstitch and bytes of the files it writes."""
    note = outs[0].with_name(outs[0].name + ".cost.json")
    if note.exists():
        return json.loads(note.read_text())
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "slipstitch", *words],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    cost = {"cpu_s": cpu_s, "bytes": sum(out.stat().st_size for out in outs)}
    note.write_text(json.dumps(cost))
    return cost


def rendered(
    config: Config, trajectory: Path, views: list[str], common: list[str]
) -> dict[str, float]:
    """Cost of one simulation's light, images and preview, for all viewpoints of the scale."""
    folder, name = trajectory.parent, trajectory.stem
    (folder / "shading").mkdir(exist_ok=True)
    of = ["--trajectory", str(trajectory)]
    packs = [folder / "shading" / f"{name}_{view}.parquet" for view in views]
    light = [
        measured(["render", *common, *of, "--viewpoint", view, "--shading", str(pack)], [pack])
        for view, pack in zip(views, packs, strict=True)
    ]
    shards = [folder / pack.name for pack in packs]
    words = ["--from-shading", *map(str, packs), "--out-dir", str(folder)]
    images = measured(["render", *common, *of, *words], shards)
    outs = [folder / f"{name}.png", folder / f"{name}.mp4"]
    words = ["--out-sheet", str(outs[0]), "--out-video", str(outs[1]), *map(str, shards)]
    preview = measured(["render", "--preview", *words], outs)
    shown = films(config)
    more = len(shown) / len(simulations(config)) / len(views)
    count = config.sample.frames * sum(len(shown[name, view]) for view in views)
    print(
        f"{name}: light {sum(one['cpu_s'] for one in light) / len(views):.1f} CPU s a viewpoint, "
        f"{count} images in {images['cpu_s']:.1f} CPU s"
    )
    return {
        key: more * (sum(one[key] for one in light) + images[key]) + preview[key]
        for key in ("cpu_s", "bytes")
    }


def predicted(config: Config, folder: Path, simulation: str, views: list[str]) -> dict:
    """CPU seconds and bytes of the stages, from one simulation and its rendering."""
    write_config(config, folder / "config.json")
    common = ["--config", str(folder / "config.json")]
    ids = [one.id for one in simulations(config)]
    trajectory = folder / f"{simulation}.parquet"
    words = ["--simulation", simulation, "--out", str(trajectory)]
    one = measured(["simulate", *common, *words], [trajectory])
    mirrors = {name: draw_surroundings(config.render, config.seed, name).reflects for name in ids}
    total = {"cpu_s": verification_cpu_s(config), "bytes": 0.0}
    for kind, count in Counter(mirrors.values()).items():
        # The floor is drawn by the simulation's id, which is the file's name.
        name = (
            simulation
            if mirrors[simulation] == kind
            else next(name for name in ids if mirrors[name] == kind)
        )
        path = folder / f"{name}.parquet"
        if not path.exists():
            shutil.copyfile(trajectory, path)
        cost = rendered(config, path, views, common)
        total = {key: value + count * cost[key] for key, value in total.items()}
    return {"simulate": {key: len(ids) * one[key] for key in one}, "render": total}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", default=str(ROOT / "config/paper.yaml"))
    parser.add_argument("--simulation", default="m05_f0600_r00")
    parser.add_argument("--viewpoints", nargs="+", default=["v00", "v01", "v02", "v09"])
    parser.add_argument("--keep", type=Path, help="folder for the part, kept")
    arguments = parser.parse_args()
    config = load_config(ROOT / "config.yaml", arguments.scale)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        stages = predicted(config, folder, arguments.simulation, arguments.viewpoints)
    good = True
    print(f"{'stage':<10} {'':<5} {'estimate':>10} {'predicted':>10}  ratio")
    for one in estimate(config):
        if one.stage not in stages:
            continue
        found = stages[one.stage]
        rows = (
            ("CPU h", 3600, one.cpu_s, found["cpu_s"]),
            ("GB", 1e9, one.disk_bytes, found["bytes"]),
        )
        for what, scale, stated, part in rows:
            good &= abs(stated / part - 1) <= TOLERANCE
            print(
                f"{one.stage:<10} {what:<5} {stated / scale:10.3f} {part / scale:10.3f}  "
                f"{stated / part:.2f}"
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
