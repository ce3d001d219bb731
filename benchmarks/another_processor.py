"""What another processor changes: the simulations that test an instrument, made and filmed again.

    python benchmarks/another_processor.py --renders FOLDER

The folder holds the images of these simulations (results/render of config/instrument.yaml), made on
another kind of processor than the published run's. Each video is read by the published average and
compared with what it read of the published one. Goes to results/published/camera/processors.json.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import pandas
from filmed import CONFIGS, PUBLISHED, ROOT, SHIPPED, FilmedSet, models, publish, reading, videos

from slipstitch.config import load_config
from slipstitch.dataset.images import pixels_digest
from slipstitch.dataset.manifest import read_manifest
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.learning.evaluation.instruments import AVERAGE
from slipstitch.learning.instrument.measuring import load_instrument


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renders", type=Path, required=True, help="results/render")
    arguments = parser.parse_args()
    config = load_config(*(str(ROOT / name) for name in CONFIGS))
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    instrument = load_instrument(models()[-1])
    known = {row["video"]: row for row in read_manifest(PUBLISHED / SHIPPED / "dataset")[0]}
    before = pandas.read_parquet(PUBLISHED / SHIPPED / "predictions.parquet")
    before = before[(before["network"] == AVERAGE) & before["low"].notna()]
    before = before.set_index("video")["predicted_value"]
    rows = []
    for path in sorted(arguments.renders.glob("m*_v*.parquet")):
        for texture, images in videos(path, frames, config.render.pixels):
            simulation, _, view = path.stem.rpartition("_")
            name = f"{simulation}_{texture}_{view}"
            rows.append(
                {
                    "video": name,
                    "friction": known[name]["friction"],
                    "published": float(before[name]),
                    "reading": reading(instrument, images, known[name])["reading"],
                    "same_pixels": pixels_digest(images) == known[name]["pixels_sha256"],
                }
            )
    truth, first, again = (
        np.array([row[key] for row in rows]) for key in ("friction", "published", "reading")
    )
    result = {
        "videos": len(rows),
        "simulations": len({row["video"][:14] for row in rows}),
        "same_pixels": float(np.mean([row["same_pixels"] for row in rows])),
        "mean_difference": float(np.abs(again - first).mean()),
        "largest_difference": float(np.abs(again - first).max()),
        "mean_absolute_error": float(np.abs(again - truth).mean()),
        "mean_absolute_error_published": float(np.abs(first - truth).mean()),
    }
    publish("processors", result, [FilmedSet("held_out")], rows)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
