"""What a camera reads where friction has a hidden effect, before and after the effect is found.

    python benchmarks/criticise_camera.py --folder FOLDER [--processes 2]

The effect of the case surrogate_anisotropic is planted in simulations of the whole protocol, filmed
along warp and weft by cameras of their own and read by the published instruments, which know plain
friction only. ``before``: the reading as it is. ``after``: the coefficient at which simulations
with the law that the criticism found, filmed by other cameras, give that reading. Goes to
results/published/camera/hidden_effect.json.
"""

import argparse
import json
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import yaml
from filmed import ROOT, FilmedSet, film, publish, readings, trainings

from slipstitch.cli.main import main as slipstitch

CASE = ROOT / "data" / "cases" / "surrogate_anisotropic"
HIDDEN = {"anisotropy": {"anisotropy": 0.25}}  # data/cases/README.md
MATERIALS = ["gray-interlock", "navy-sparkle-sweat"]
# A cloth with its warp down is dragged along it (docs/physics.md).
DIRECTIONS = {"warp": "v", "weft": "u"}


def model_found():
    """The extended model of the criticism of the case."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        words = [str(CASE), "--out", str(out / "verdict.json"), "--model", str(out / "model.yaml")]
        if slipstitch(["criticise", *words]):
            raise SystemExit("the criticism failed")
        return yaml.safe_load((out / "model.yaml").read_text())


def sets(found):
    """The bench that is measured, and the simulations with the law found."""
    hidden = {"friction_law": {"face": {"coefficient": 0.45, "mechanisms": HIDDEN}}}
    return [
        FilmedSet(
            f"{name}_{direction}",
            {
                "seed": seed,
                "grid": {"materials": MATERIALS, "frictions": frictions, "replicates": 1},
                "simulation": {"warp": warp},
            },
            model,
            cameras=2,
        )
        for name, seed, frictions, model in (
            ("hidden", 211, [0.3, 0.45, 0.6], hidden),
            ("found", 223, [0.2, 0.4, 0.6, 0.8], found),
        )
        for direction, warp in DIRECTIONS.items()
    ]


def curve(rows):
    """Coefficients and mean readings there, by which a reading is turned into a coefficient."""
    at = defaultdict(list)
    for row in rows:
        at[row["friction"]].append(row["reading"])
    frictions = sorted(at)
    return frictions, np.maximum.accumulate([np.mean(at[mu]) for mu in frictions])


def line(frictions, means, reading):
    """The coefficient at which the mean reading is this one, beyond the ends along a line."""
    k = int(np.clip(np.searchsorted(means, reading) - 1, 0, len(means) - 2))
    slope = (frictions[k + 1] - frictions[k]) / max(means[k + 1] - means[k], 1e-6)
    return max(frictions[k] + slope * (reading - means[k]), 0.0)


def errors(rows, name):
    """Mean error and its size, with the standard deviation over simulations of the former."""
    off = defaultdict(list)
    for row in rows:
        off[row["simulation"]].append(row[name] - row["friction"])
    means = np.array([np.mean(one) for one in off.values()])
    size = np.mean([np.mean(np.abs(one)) for one in off.values()])
    return {
        "mean_error": float(means.mean()),
        "standard_deviation": float(means.std(ddof=1)),
        "mean_absolute_error": float(size),
        "simulations": len(off),
        "videos": len(rows),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="for simulations and videos")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    found = model_found()
    configs = film(sets(found), arguments.folder, arguments.processes)
    measuring = trainings()
    rows = readings(configs, arguments.folder, measuring)
    result = {
        "hidden": HIDDEN,
        "found": found["friction_law"]["face"]["mechanisms"],
        "instruments": len(measuring),
    }
    for direction in DIRECTIONS:
        parts = {name: [r for r in rows if r["set"] == f"{name}_{direction}"] for name in
                 ("hidden", "found")}  # fmt: skip
        curves = {
            seed: curve([row for row in parts["found"] if row["seed"] == seed])
            for seed in {row["seed"] for row in parts["found"]}
        }
        for row in parts["hidden"]:
            row["after"] = line(*curves[row["seed"]], row["reading"])
        result[direction] = {
            "before": errors(parts["hidden"], "reading"),
            "after": errors(parts["hidden"], "after"),
            "alarms": float(np.mean([row["alarm"] for row in parts["hidden"]])),
        }
    publish("hidden_effect", result, sets(found), rows)
    print(json.dumps({key: result[key] for key in DIRECTIONS}, indent=1))


if __name__ == "__main__":
    main()
