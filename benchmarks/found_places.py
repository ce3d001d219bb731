"""What an instrument errs: by finding the places of the cloth, or by reading friction from them?

    python benchmarks/found_places.py FOLDER

FOLDER is the dataset of config/instrument.yaml (results/sample). Each published instrument reads
friction from videos, and from the simulated places that these show. Goes to
results/published/camera/found_places.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from filmed import publish, trainings
from surrogate_places import mean_errors, places_off, reading

from slipstitch.dataset.manifest import read_manifest
from slipstitch.dataset.videos import read_videos
from slipstitch.learning.evaluation.instruments import measured
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.measuring import load_instrument

# Videos of each part that are read: one in so many.
PARTS = {"train": 12, "test": 2, "unseen_fabric": 3}


def part_of(row, fabrics):
    """Training and test are of the fabrics that train; simulated as they are, not interpolated."""
    side = row["split_by_simulation"]
    if side == "validation":
        return "" if row["material"] in fabrics else "unseen_fabric"
    return "" if row["interpolated"] else side


def rows_of(part, videos, instrument):
    """One row a video: what is read, and how far off the places are."""
    frames = instrument.card["frames"]
    true_m = phased(videos.points_m, frames, None)
    seen = measured(instrument, phased(videos.pixels, frames, None), videos.rows)
    for row, measurement, places_m in zip(videos.rows, seen, true_m, strict=True):
        yield {
            "part": part,
            "simulation": row["simulation"],
            "video": row["video"],
            "seed": instrument.card["seed"],
            "friction": row["friction"],
            "reading": float(measurement.friction_coefficient),
            "from_true_places": reading(instrument.networks[0], torch.from_numpy(places_m[None])),
            **places_off(measurement.points_m, places_m),
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="dataset that the sample stage wrote")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    every = [load_instrument(path) for path in trainings()]
    fabrics = set(every[0].card["materials"])
    rows = []
    manifest, digest = read_manifest(arguments.folder)
    for part, step in PARTS.items():
        chosen = [row["video"] for row in manifest if part_of(row, fabrics) == part][::step]
        videos = read_videos(
            arguments.folder, lambda row, chosen=frozenset(chosen): row["video"] in chosen
        )
        for instrument in every:
            rows += rows_of(part, videos, instrument)
    summary = {}
    for part in PARTS:
        own = [row for row in rows if row["part"] == part]
        summary[part] = {
            "videos": len({row["video"] for row in own}),
            "simulations": len({row["simulation"] for row in own}),
            "lower_edge_off_mm": float(np.mean([row["lower_edge_off_mm"] for row in own])),
            **mean_errors(own, ("reading", "from_true_places")),
        }
    result = {"instruments": len(every), "dataset_digest": digest, "parts": summary}
    publish("found_places", result, [], rows)
    print(json.dumps(summary, indent=1))


if __name__ == "__main__":
    main()
