"""What more pixels and a wider network buy the fabric network, trained on the calibrated view.

    python studies/input_size.py results/sample --config results/config.json --out DIR \
        --trials 32:0.25 48:0.25 64:0.25 32:0.5

Every trial (pixels:width) sees as many videos and is scored on the validation videos of the split
by video; what is there is not trained again. A study: asked once, not maintained.
"""

import argparse
import csv
import json
from pathlib import Path

from slipstitch.base.provenance import read_json, read_provenance
from slipstitch.config import load_config
from slipstitch.config.train import TrainSettings
from slipstitch.design.trainable import view_order
from slipstitch.learning.lrcn_training import train_network
from slipstitch.learning.trainer import Phase, Run

EPOCHS = 16


def trained(config, dataset, folder, pixels, width):
    """Return the validation scores and CPU hours of one trial, trained unless it is there."""
    settings = TrainSettings.model_validate(
        config.train.model_dump() | {"pixels": pixels, "width": width, "flat_epochs": None}
    )
    view = view_order(config)[0]
    run = Run(dataset, "by_video", 0, folder, frames=config.sample.frames)
    if not (folder / "model.safetensors").is_file():
        phases = [Phase("one viewpoint", (view,), EPOCHS)]
        train_network(settings, run, "material_baseline", [view], phases=phases)
    with open(folder / "history.csv", newline="") as stream:
        last = list(csv.DictReader(stream))[-1]
    card = read_json(folder / "model.json")
    return {
        "pixels": pixels,
        "width": width,
        "million_multiply_accumulates": card["multiply_accumulates_per_frame"] / 1e6,
        "cpu_h": read_provenance(folder / "model.safetensors")["cpu_s"] / 3600,
        "videos": int(last["validation_videos"]),
        "right": float(last["validation_accuracy"]),
        "loss": float(last["validation_loss"]),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--config", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", nargs="+", required=True, metavar="PIXELS:WIDTH")
    chosen = parser.parse_args()
    config = load_config(chosen.config)
    rows = []
    for trial in chosen.trials:
        pixels, width = trial.split(":")
        folder = chosen.out / f"{pixels}_{width}"
        rows.append(trained(config, chosen.dataset, folder, int(pixels), float(width)))
        print(rows[-1], flush=True)
    (chosen.out / "input_size.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
