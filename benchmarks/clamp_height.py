"""What clamps that hang a little too high or low do to the published instruments' reading.

    python benchmarks/clamp_height.py --folder FOLDER [--processes 2]

Coefficients and fabrics that trained, clamps straight, the fabric as measured: benches differ in
the height of their clamps alone, and in the side to which the cloth sags. (In the training of
config/instrument.yaml cloths of ideal benches sag to the first, all others to the second.) Beside
it, what theory says of a reading that knows the distance from the clamps to the cloth's tail alone,
and takes them to hang as they should. Goes to results/published/camera/clamp_height.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from filmed import (
    SHIPPED,
    FilmedSet,
    answering,
    film,
    models,
    of_each_simulation,
    publish,
    readings,
)
from instrument_reach import MATERIALS
from scipy.stats import linregress

from slipstitch.design.grid import simulations
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.physics.simulation.drop_and_drag import draw_perturbation
from slipstitch.physics.theory import flexible_strip_drag

SET = FilmedSet(
    "clamp_height",
    {
        "seed": 181,
        "grid": {
            "materials": MATERIALS,
            "frictions": [0.5, 0.8, 1.0, 1.25],
            "replicates": 2,
            "own_benches": True,
        },
        "simulation": {
            "ideal_replicates": 0,
            "curl_side": "alternating",
            "yaw_sd_deg": 0.0,
            "height_sd_m": 0.001,
            "fabric_sd_rel": 0.0,
        },
    },
    cameras=1,
    textures=("cloth_1", "cloth_2", "cloth_3", "cloth_4"),
)


def theory(friction):
    """Relative error of such a reading a millimetre of height, of a heavy flexible strip."""

    def tail_m(mu, height_m):
        return flexible_strip_drag(mu, SIDE_M, height_m).holder_ahead_of_tail_m

    path = StagePath()
    height_m, part = path.start_height_m - path.drop_m, 0.01
    a_friction = (tail_m(friction * (1 + part), height_m) - tail_m(friction, height_m)) / part
    return float((tail_m(friction, height_m + 1e-3) - tail_m(friction, height_m)) / a_friction)


def slope(rows):
    """Relative error of the reading a millimetre of height, each simulation counting once."""
    of_each = of_each_simulation(rows)
    height_mm = [each[0]["height_mm"] for each in of_each]
    error = [np.mean([row["reading"] / row["friction"] - 1 for row in each]) for each in of_each]
    found = linregress(height_mm, error)
    return {
        "simulations": len(of_each),
        "videos": len(rows),
        "height_sd_mm": float(np.std(height_mm)),
        "error_per_mm": float(found.slope),
        "error_per_mm_sd": float(found.stderr),
        "at_true_height": float(found.intercept),
        "rms_error": float(np.sqrt(np.mean(np.square(error)))),
        "mean_absolute_error": float(np.mean([abs(r["reading"] - r["friction"]) for r in rows])),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="for simulations and videos")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    configs = film([SET], arguments.folder, arguments.processes)
    config = configs[SET.name]
    benches = {
        f"{SET.name} {one.id}": draw_perturbation(config.simulation, one.seed, one.replicate)
        for one in simulations(config)
    }
    every = readings(configs, arguments.folder, models(arguments.run))
    for row in every:
        bench = benches[row["simulation"]]
        row["height_mm"] = 1e3 * bench.height_m
        row["side"] = "first" if bench.natural_curl_per_m > 0 else "second"
    rows = answering(every)
    result = {"all": slope(rows)} | {
        side: slope([row for row in rows if row["side"] == side]) for side in ("first", "second")
    }
    frictions = SET.changes["grid"]["frictions"]
    result["theory_error_per_mm"] = {f"{one:g}": theory(one) for one in frictions}
    publish("clamp_height", result, [SET], every, arguments.run)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
