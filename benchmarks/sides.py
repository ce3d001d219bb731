"""Up to which friction coefficient a cloth stays on the side to which it sagged.

    python benchmarks/sides.py FOLDER

FOLDER holds the trajectories of config/instrument.yaml (results/simulate): every pair on the
paper's bench, and on one of its own with the cloth curled to the other side. The mean distance
along the track between the middles of both lower edges, later than 40 s, by coefficient and
fabric. Goes to results/published/camera/sides.json.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from filmed import CONFIGS, ROOT
from interpolation import digests

from slipstitch.base.provenance import provenance_record, write_json
from slipstitch.config import load_config
from slipstitch.design.grid import simulations
from slipstitch.images.keypoints import KEYPOINTS_UV, keypoints_m
from slipstitch.physics.simulation.trajectory import read_trajectory

RESULT = ROOT / "results" / "published" / "camera" / "sides.json"
LOWER_EDGE = int(np.flatnonzero((KEYPOINTS_UV == (0.5, 1.0)).all(axis=1))[0])
AFTER_S = 40.0
APART_MM = 20.0  # clamps and fabric alone move the lower edge by some millimetres


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    config = load_config(*(str(ROOT / name) for name in CONFIGS))
    edges = defaultdict(dict)
    for one in simulations(config):
        run = read_trajectory(folder / f"{one.id}.parquet")
        places_m = keypoints_m(run.positions_m, run.uv, run.stage_x_m)
        late = run.time_s > AFTER_S
        edges[one.friction, one.material][one.replicate] = places_m[late, LOWER_EDGE, 0]
    apart_mm = defaultdict(dict)
    for (friction, material), of in edges.items():
        apart_mm[friction][material] = float(1e3 * np.abs(of[0] - of[1]).mean())
    rows = [
        {
            "friction": friction,
            "fabrics": len(of),
            "on_other_sides": sum(distance > APART_MM for distance in of.values()),
            "median_mm": float(np.median(list(of.values()))),
            "apart_mm": of,
        }
        for friction, of in sorted(apart_mm.items())
    ]
    for row in rows:
        print(row["friction"], row["on_other_sides"], round(row["median_mm"], 1))
    record = provenance_record(
        "simulate", inputs=[], config={"simulations": digests(folder), "after_s": AFTER_S}
    )
    write_json(RESULT, {"rows": rows}, record)


if __name__ == "__main__":
    main()
