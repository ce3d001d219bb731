"""The published instruments on surrogate videos, each from a camera of its own.

    python benchmarks/instrument_surrogates.py --folder FOLDER [--repeats 1] [--processes 2]

The pairs of config/paper.yaml: three fabrics on seven substrates, off the grid, with perturbed
clamps and fabrics, a lens, drifting exposure and a compressed video (docs/capture.md), measured as
`slipstitch measure` does. Not real. Goes to results/published/camera/surrogates.json.
"""

import argparse
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml
from filmed import CONFIGS, ROOT, SHIPPED, FilmedSet, answering, models, publish, run_slipstitch
from instrument_reach import scores

from slipstitch.base.errors import BadInput
from slipstitch.config import load_config
from slipstitch.config.catalogue import FLOORS
from slipstitch.film.measure.measuring import measuring_bench
from slipstitch.film.surrogate.bench import films, write_bench


def one_fabric_a_substrate():
    """Of the pairs of the configuration, one on every substrate, the fabrics taking turns."""
    pairs = load_config(*(str(ROOT / name) for name in CONFIGS)).captures.pairs
    fabrics = list(dict.fromkeys(pair.material for pair in pairs))
    substrates = list(dict.fromkeys(pair.substrate for pair in pairs))
    return [
        pair.model_dump(mode="json")
        for pair in pairs
        if fabrics.index(pair.material) == substrates.index(pair.substrate) % len(fabrics)
    ]


def made(config, folder, files, processes):
    """Simulate and render what is missing; all repeats of a pair in their order."""
    wanted = sorted(films(config), key=lambda film: (film.repeat, film.id))

    def make(film):
        out = folder / f"{film.id}.mp4"
        if not out.exists():
            run_slipstitch(
                "capture", "surrogate", "--config", *files, "--film", film.id, "--out", str(out)
            )

    with ThreadPoolExecutor(processes) as pool:
        for number, _ in enumerate(pool.map(make, wanted), 1):
            print(f"{number} of {len(wanted)} videos made", file=sys.stderr)
    return wanted


def readings(wanted, folder, run):
    """One row a video and instrument, and the videos that were refused."""
    rows, refused = [], []
    for film in wanted:
        for model in models(run):
            bench = measuring_bench(folder / f"{film.id}.json", model.parent)
            try:
                result = bench.measure(folder / f"{film.id}.mp4")
            except BadInput as problem:
                refused.append({"video": film.id, "why": str(problem).partition(": ")[2]})
                break
            measured = result.measurement
            low, high = measured.interval_90
            rows.append(
                {
                    "simulation": film.id,
                    "seed": bench.instrument.card.get("seed"),
                    "material": film.pair.material,
                    "floor": film.pair.substrate,
                    "friction": film.friction,
                    "reading": float(measured.friction_coefficient),
                    "low": float(low),
                    "high": float(high),
                    "alarm": bool(measured.alarm),
                    "fabric_right": result.fabric[0] == film.pair.material,
                }
                | {f"pose_{name}": float(value) for name, value in result.video.pose.items()}
            )
    return rows, refused


def result_of(every):
    """Scores of the average on all, and part by part, and of the trainings."""
    rows = answering(every)
    parts = {
        "all": rows,
        "matte": [row for row in rows if not FLOORS[row["floor"]].reflects_plainly],
        "reflective": [row for row in rows if FLOORS[row["floor"]].reflects_plainly],
        "trainings": [row for row in every if row["seed"] is not None],
    }
    parts |= {
        name: [row for row in rows if row["material"] == name]
        for name in sorted({row["material"] for row in rows})
    }
    return {
        name: scores(part) | {"fabric_right": sum(row["fabric_right"] for row in part) / len(part)}
        for name, part in parts.items()
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="for cameras and videos")
    parser.add_argument("--repeats", type=int, default=1, help="videos of each pair")
    parser.add_argument("--one-fabric", action="store_true", help="a substrate, the three in turn")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    changes = {"captures": {"own_cameras": True, "repeats": arguments.repeats}}
    if arguments.one_fabric:
        changes["captures"]["pairs"] = one_fabric_a_substrate()
    (folder / "changes.yaml").write_text(yaml.safe_dump(changes))
    files = [*(str(ROOT / name) for name in CONFIGS), str(folder / "changes.yaml")]
    config = load_config(*files)
    write_bench(config, folder)
    wanted = made(config, folder, files, arguments.processes)
    every, refused = readings(wanted, folder, arguments.run)
    result = result_of(every)
    result["refused"] = refused
    publish("surrogates", result, [FilmedSet("surrogates", changes)], every, arguments.run)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
