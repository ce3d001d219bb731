"""What the published networks of the paper's experiment read of cloths that sag to the other side.

    python benchmarks/paper_sides.py FOLDER --images SCRATCH [--processes 2]

FOLDER holds the trajectories of config/instrument.yaml (results/simulate): every pair on the
paper's bench (r00), and on one of its own with the cloth curled to the other side (r01). Both are
rendered from the calibrated view as the paper's experiment is, and read by its networks, which
trained on many of the first and on none of the second. Goes to
results/published/camera/paper_sides.json.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas
import yaml
from filmed import PUBLISHED, ROOT, run_slipstitch, videos

from slipstitch.base.provenance import provenance_record, write_json
from slipstitch.config import load_config, read_mapping
from slipstitch.dataset.videos import resized
from slipstitch.design.grid import simulations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.learning.model_file import load_model
from slipstitch.learning.prediction import predict

RESULT = PUBLISHED / "camera" / "paper_sides.json"
FRICTIONS = (0.1, 0.2, 0.3, 0.5, 1.0)
SPLITS = ("by_video", "by_simulation")
NETWORK = "friction_baseline"
# The simulations' benches are the instrument's; all else is as in the paper's experiment.
CHANGES = {
    "grid": {"frictions": list(FRICTIONS), "replicates": 2},
    "simulation": read_mapping(ROOT / "config/instrument.yaml")["simulation"],
    "render": {"test_textures": []},
}


def rendered(folder, scratch, processes):
    """Configuration, its simulations and their shards; those that are missing are made."""
    scratch.mkdir(parents=True, exist_ok=True)
    (scratch / "changes.yaml").write_text(yaml.safe_dump(CHANGES))
    files = [str(ROOT / "config.yaml"), str(ROOT / "config/paper.yaml")]
    files.append(str(scratch / "changes.yaml"))

    def make(one):
        out = scratch / f"{one.id}.parquet"
        if not out.exists():
            given = [word for file in files for word in ("--config", file)]
            run_slipstitch(
                "render", *given, "--trajectory", str(folder / out.name),
                "--viewpoint", "calibrated", "--out", str(out),
            )  # fmt: skip
        return out

    config = load_config(*files)
    grid = simulations(config)
    with ThreadPoolExecutor(processes) as pool:
        return config, list(zip(grid, pool.map(make, grid), strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--images", type=Path, required=True, help="folder for images")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    config, shards = rendered(arguments.folder, arguments.images, arguments.processes)
    folders = {split: PUBLISHED / "paper/models" / split / NETWORK / "seed0" for split in SPLITS}
    models = {split: load_model(folder) for split, folder in folders.items()}
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    readings = []
    for one, path in shards:
        shown = [video for _, video in videos(path, frames, config.render.pixels)]
        for split, model in models.items():
            seen = np.stack([resized(video, model.card["pixels"]) for video in shown])
            shares = predict(model.network, seen, bfloat16=model.card["bfloat16"])
            values = np.array([entry["value"] for entry in model.card["classes"]])
            errors = np.abs(values[shares.argmax(1)] - one.friction)
            readings.append(
                {
                    "simulation": one.id,
                    "friction": one.friction,
                    "bench": "own" if one.replicate else "paper",
                    "split": split,
                    "videos": len(errors),
                    "mean_absolute_error": float(errors.mean()),
                    "right": float((errors < 0.05).mean()),
                }
            )
    parts = pandas.DataFrame(readings).groupby(["friction", "bench", "split"], sort=False)
    rows = parts[["mean_absolute_error", "right"]].mean().reset_index().to_dict("records")
    for row in rows:
        print(row)
    used = [folder / "model.safetensors" for folder in folders.values()]
    record = provenance_record(
        "evaluate", inputs=[path.relative_to(Path.cwd()) for path in used], config=CHANGES
    )
    write_json(RESULT, {"rows": rows, "readings": readings}, record, indent=None)


if __name__ == "__main__":
    main()
