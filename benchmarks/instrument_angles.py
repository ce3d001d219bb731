"""The published instruments on the same held-out simulations from every side.

    python benchmarks/instrument_angles.py --folder FOLDER --trajectories FOLDER [--processes 2]

The second folder holds the trajectories of config/instrument.yaml (results/simulate). Each of the
simulations that test is filmed once at every angle of the table, by cameras, floors, lamps and
cloths drawn as for training, but from other numbers. Goes to results/published/camera/angles.json.
"""

import argparse
import json
from pathlib import Path

from filmed import (
    CONFIGS,
    ROOT,
    SHIPPED,
    FilmedSet,
    answering,
    film,
    models,
    publish,
    readings,
    turns_deg,
)
from instrument_reach import scores

from slipstitch.config import load_config
from slipstitch.design.splits import sides_of_simulations

ANGLES_DEG = (-15, -10, -5, 0, 5, 10, 15)
NEAR_DEG = 1.0
SEEDS = range(1001, 1101)
FAMILY = {"bench_camera": {"calibrated_share": 0.0}}
TEXTURES = ("cloth_1", "cloth_2", "cloth_3", "cloth_4")
TRAJECTORIES = "held_out"


def sets():
    """One for each seed of cameras: those that stand at an angle where none did before."""
    config = load_config(*(str(ROOT / name) for name in CONFIGS))
    sides = sides_of_simulations(config)
    wanted = {
        (name, angle) for name, side in sides.items() if side == "test" for angle in ANGLES_DEG
    }
    camera = config.render.bench_camera.model_copy(update=FAMILY["bench_camera"])
    render = config.render.model_copy(update={"bench_camera": camera})
    found = []
    for seed in SEEDS:
        drawn = config.model_copy(update={"seed": seed, "render": render})
        only = {}
        for name in sorted({name for name, _ in wanted}):
            for number, turn in enumerate(turns_deg(drawn, name)):
                angle = 5 * round(turn / 5)
                if (name, angle) in wanted and abs(turn - angle) <= NEAR_DEG:
                    wanted.remove((name, angle))
                    only.setdefault(name, []).append(number)
        if only:
            changes = {"seed": seed, "render": FAMILY}
            found.append(
                FilmedSet(
                    f"angles_{seed}", changes, None, TRAJECTORIES, textures=TEXTURES, only=only
                )
            )
    if wanted:
        raise SystemExit(f"no camera of {SEEDS} films {min(wanted)}")
    return found


def of_angles(rows):
    """Scores at every angle."""
    return {
        f"{angle:+d}": scores([row for row in rows if row["angle_deg"] == angle])
        for angle in ANGLES_DEG
    }


def result_of(every):
    """Scores of the average, and of the trainings, together and at every angle."""
    rows = answering(every)
    return {
        "all": scores(rows),
        "angles": of_angles(rows),
        "trainings": of_angles([row for row in every if row["seed"] is not None]),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="for videos")
    parser.add_argument("--trajectories", type=Path, required=True, help="results/simulate")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    link = arguments.folder / TRAJECTORIES
    if not link.exists():
        link.symlink_to(arguments.trajectories.resolve())
    configs = film(sets(), arguments.folder, arguments.processes)
    every = readings(configs, arguments.folder, models(arguments.run))
    for row in every:
        row["angle_deg"] = 5 * round(row["pose_yaw_deg"] / 5)
        # One simulation, whichever camera films it.
        row["simulation"] = row["simulation"].partition(" ")[2]
    result = result_of(every)
    publish("angles", result, sets(), every, arguments.run)
    print(json.dumps({name: result[name] for name in ("all", "angles")}, indent=1))


if __name__ == "__main__":
    main()
