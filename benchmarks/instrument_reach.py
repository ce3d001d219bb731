"""The published instruments where nothing was trained: off the grid, unseen fabrics, far cameras.

    python benchmarks/instrument_reach.py --folder FOLDER [--processes 2]

All videos are of simulations, cameras, floors and lamps of their own. Goes to
results/published/camera/reach.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from filmed import (
    SHIPPED,
    TEXTURES,
    UNSEEN_TEXTURE,
    FilmedSet,
    answering,
    film,
    models,
    publish,
    readings,
    trainings,
)

from slipstitch.learning.evaluation.metrics import BY_NAME, PredictionsAndTruth
from slipstitch.learning.instrument.measuring import load_instrument
from slipstitch.learning.instrument.poses import outside

MATERIALS = ["pink-ribbon-brown", "gray-interlock", "11oz-black-denim", "white-swim-solid"]
OFF_GRID = [0.15, 0.55, 0.95, 1.35]
# Fabrics unlike any of the ten: one of them, of another mass and bending rigidity.
FABRICS = {
    "camel-ponte-roma": (-0.3, 1.0),
    "gray-interlock": (0.5, -0.5),
    "royal-target": (-0.4, -0.6),
    "ivory-rib-knit": (0.3, 1.5),
}
PARTS = ("off_grid", "unseen_fabric", "unseen_texture", "far")
FAR_DEG = (22.5, 30.0)  # aside, where the training ends at 15
# Clamps, curl and fabric vary from one simulation to the next, as on a bench.
BENCHES = {
    "simulation": {
        "ideal_replicates": 0,
        "curl_side": "drawn",
        "yaw_sd_deg": 1.0,
        "height_sd_m": 0.0005,
        "fabric_sd_rel": 0.03,
    }
}


def sets():
    """Off the grid; unseen fabrics; simulations of the first, seen from far aside."""
    once = {"replicates": 1, "own_benches": True}
    off_grid = {"seed": 131, "grid": {"materials": MATERIALS, "frictions": OFF_GRID} | once}
    off_grid |= BENCHES
    far = {"bench_camera": {"yaw_deg": FAR_DEG[1], "calibrated_share": 0.0}}
    plain = {"face": {"coefficient": 0.3, "mechanisms": {}}}
    return [
        FilmedSet("off_grid", off_grid),
        *(
            FilmedSet(
                f"unseen_fabric_{name}",
                {"seed": 139, "grid": {"materials": [name], "frictions": [0.25, 0.65, 1.15]} | once}
                | BENCHES,
                {"friction_law": plain, "bench": {"mass_error": mass, "bending_error": bending}},
            )
            for name, (mass, bending) in FABRICS.items()
        ),
        FilmedSet("far", {**off_grid, "seed": 149, "render": far}, None, "off_grid", FAR_DEG),
    ]


def scores(rows):
    """Of all instruments; every simulation counts once for the coverage."""
    answers = PredictionsAndTruth(
        0.1,
        np.array([row["reading"] for row in rows]),
        np.array([row["friction"] for row in rows]),
        intervals=np.array([(row["low"], row["high"]) for row in rows]),
        groups=[row["simulation"] for row in rows],
        alarms=np.array([row["alarm"] for row in rows]),
    )
    covered, error = answers.coverage
    widths = [row["high"] - row["low"] for row in rows]
    return {
        "videos": len(rows),
        "simulations": len({row["simulation"] for row in rows}),
        "mean_absolute_error": BY_NAME["mean_absolute_error"].compute(answers),
        "within_0_1": BY_NAME["within_0.1"].compute(answers),
        "coverage_90": covered,
        "coverage_90_error": error if np.isfinite(error) else None,  # of one simulation
        "interval_width": float(np.mean(widths)),
        "alarms": BY_NAME["alarms"].compute(answers),
    }


def _is_unseen_fabric(row):
    return "unseen" in row["set"] and row["texture"] != UNSEEN_TEXTURE


def _is_off_grid(row):
    return row["set"] == "off_grid" and row["texture"] != UNSEEN_TEXTURE


def result_of(every, run=SHIPPED):
    """Scores of all parts, from the readings by the average and by the trainings."""
    rows = answering(every)
    tested = load_instrument(trainings(run)[0]).card["pose_range"]
    parts = {name: [] for name in PARTS}
    refused = []
    for row in rows:
        pose = {name: row[f"pose_{name}"] for name in tested}
        if row["set"] == "far":
            parts["far"].append(row)
            refused.append(bool(outside(pose, tested)))
        elif row["texture"] == UNSEEN_TEXTURE:
            parts["unseen_texture"].append(row)
        else:
            parts["unseen_fabric" if _is_unseen_fabric(row) else "off_grid"].append(row)
    result = {name: scores(part) for name, part in parts.items()}
    result["far"]["refused"] = float(np.mean(refused))
    result["fabrics"] = {
        name: scores([row for row in parts["unseen_fabric"] if row["material"] == name])
        for name in FABRICS
    }
    near = [row for row in rows if row["set"] != "far"]
    result["textures"] = {
        name: scores([row for row in near if row["texture"] == name])
        for name in [*TEXTURES, UNSEEN_TEXTURE]
    }
    result["instruments"] = len({row["seed"] for row in rows})
    alone = [row for row in every if row["seed"] is not None]
    result["trainings"] = {
        "instruments": len({row["seed"] for row in alone}),
        "off_grid": scores([row for row in alone if _is_off_grid(row)]),
        "unseen_fabric": scores([row for row in alone if _is_unseen_fabric(row)]),
    }
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="for simulations and videos")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    configs = film(sets(), arguments.folder, arguments.processes)
    every = readings(configs, arguments.folder, models(arguments.run))
    result = result_of(every, arguments.run)
    publish("reach", result, sets(), every, arguments.run)
    print(json.dumps({name: result[name] for name in PARTS}, indent=1))


if __name__ == "__main__":
    main()
