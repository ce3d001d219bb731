"""How near a cloth interpolated between two simulations comes to the one simulated between them.

    python benchmarks/interpolation.py FOLDER

FOLDER holds trajectories of a grid (results/simulate). Every simulation whose fabric is there at a
lower and at a higher coefficient is compared with the mean of those two, weighted by the tail that
theory gives, as `slipstitch.design.interpolation` does, and linearly, at the frames that the
networks see: the median distance of the vertices, and what it is worth in friction, by how far the
two are apart. And of cloths mixed half and half of two fabrics the share of frames in which they
are cloths (`slipstitch.images.interpolation`). Goes to results/published/camera/interpolation.json.
"""

import argparse
import json
import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path

import numpy as np

from slipstitch.base.provenance import file_digest, provenance_record, write_json
from slipstitch.config import resolve_config
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.images.cloth_interpolation import STRAIN_MAX, edge_strain
from slipstitch.physics.simulation.trajectory import read_trajectory
from slipstitch.physics.theory.drag import flexible_strip_drag

ROOT = Path(__file__).parents[1]
HEIGHT_M = StagePath().start_height_m - StagePath().drop_m
RESULT = ROOT / "results" / "published" / "camera" / "interpolation.json"


def read(folder):
    """Fabric id -> friction coefficient -> trajectory."""
    found = defaultdict(dict)
    for path in sorted(folder.glob("m??_f*_r00.parquet")):
        material, friction = re.match(r"(m\d\d)_f(\d+)_", path.name).groups()
        found[material][int(friction) / 1000] = read_trajectory(path)
    return found


def digests(folder):
    """Of the trajectories, by simulation."""
    return {path.stem: file_digest(path) for path in sorted(folder.glob("m*.parquet"))}


def apart_mm(one, other):
    """Mean distance of the vertices, mm, shape (frames,)."""
    return 1e3 * np.linalg.norm(one - other, axis=2).mean(1)


def compared(of_fabric, frames, lowest):
    """One entry a simulation that has neighbours, all from a friction coefficient on."""
    at = {mu: one.positions_m[frames].astype(float) for mu, one in of_fabric.items()}
    known = [mu for mu in sorted(at) if mu >= lowest]
    for below, mu, above in zip(known, known[1:], known[2:], strict=False):
        tails = [flexible_strip_drag(each, SIDE_M, HEIGHT_M) for each in (below, mu, above)]
        first, middle, last = (tail.holder_ahead_of_tail_m for tail in tails)
        span = np.median(apart_mm(at[below], at[above]))
        entry = {"friction": mu, "between": [below, above]}
        for name, part in (
            ("linear", (mu - below) / (above - below)),
            ("theory", (middle - first) / (last - first)),
        ):
            error = apart_mm((1 - part) * at[below] + part * at[above], at[mu])
            entry[name] = {
                "median_mm": float(np.median(error)),
                "worst_frame_mm": float(error.max()),
                "in_friction": float((above - below) * np.median(error) / span),
            }
        yield entry


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    grid = read(folder)
    some = next(iter(next(iter(grid.values())).values()))
    frames = sampled_frames(len(some.frame), resolve_config({}).sample.frames)
    lowest = resolve_config({}).render.interpolation.from_friction
    between = {material: list(compared(of, frames, lowest)) for material, of in grid.items()}
    mixed = {}
    for one, other in combinations(grid, 2):
        for mu in sorted(mu for mu in grid[one] if mu in grid[other] and mu >= lowest):
            mean_m = (grid[one][mu].positions_m[frames] + grid[other][mu].positions_m[frames]) / 2
            whole = edge_strain(some, mean_m) <= STRAIN_MAX
            mixed[f"{one}+{other} {mu:g}"] = float(whole.mean())
    every = [entry for entries in between.values() for entry in entries]
    result = {
        "from_friction": lowest,
        "simulations": len(every),
        **{
            kind: {
                name: float(np.median([entry[kind][name] for entry in every]))
                for name in ("median_mm", "worst_frame_mm", "in_friction")
            }
            | {"in_friction_90": float(np.percentile([e[kind]["in_friction"] for e in every], 90))}
            for kind in ("linear", "theory")
        },
        "mixed": len(mixed),
        "mixed_frames_whole": float(np.mean(list(mixed.values()))),
        "by_fabric": between,
        "by_pair": mixed,
    }
    record = provenance_record("simulate", inputs=[], config={"simulations": digests(folder)})
    write_json(RESULT, result, record, indent=None)
    print(json.dumps({key: value for key, value in result.items() if "by_" not in key}, indent=1))


if __name__ == "__main__":
    main()
