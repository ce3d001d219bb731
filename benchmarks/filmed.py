"""Small sets of simulations, filmed by benches that no instrument was trained on.

A set is the instrument's configuration (config/paper.yaml, config/instrument.yaml) with changes.
What is finished is not made again. Its cameras are `VIEWPOINTS`: the shipped instrument had others.
"""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from slipstitch.base.provenance import provenance_record, read_metadata, write_json
from slipstitch.config import load_config
from slipstitch.dataset.shards import decode, read_shard
from slipstitch.design.grid import simulations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.images.bench_camera import draw_bench_camera
from slipstitch.images.camera import POSE
from slipstitch.learning.evaluation.instruments import measured
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.measuring import load_instrument

ROOT = Path(__file__).parents[1]
PUBLISHED = ROOT / "results" / "published"
SHIPPED = "instrument"  # the published run whose instrument ships
CONFIGS = ("config.yaml", "config/paper.yaml", "config/instrument.yaml")
VIEWPOINTS = ["bench_5", "bench_6", "bench_7", "bench_8"]
TEXTURES = ["checks", "tartan", "dots", "floral"]
UNSEEN_TEXTURE = "chevron"  # filmed once a simulation more; no published instrument trained in it


@dataclass(frozen=True)
class FilmedSet:
    """Simulations and cameras: a name, and what differs from the instrument's configuration."""

    name: str
    changes: dict = field(default_factory=dict)
    model: dict | None = None  # of simulation.model
    simulated_as: str = ""  # the set whose simulations these are, filmed by other cameras
    yaw_deg: tuple = (0.0, 180.0)  # only cameras turned by so much, either way
    only: dict = field(default_factory=dict)  # simulations, and the numbers of their cameras
    cameras: int = len(VIEWPOINTS)
    textures: tuple = ()  # others than `TEXTURES` and `UNSEEN_TEXTURE`


def film(sets, folder, processes):
    """Simulate and film what is missing; the configuration of each set."""
    folder.mkdir(parents=True, exist_ok=True)
    configs, jobs = {}, []
    for one in sets:
        place = folder / one.name
        place.mkdir(exist_ok=True)
        simulated = folder / (one.simulated_as or one.name)
        changes = deepcopy(one.changes)
        shown = {
            "viewpoints": VIEWPOINTS,
            "textures": list(one.textures) or TEXTURES,
            "test_textures": [] if one.textures else [UNSEEN_TEXTURE],
            "interpolation": {"share": 0.0},
        }
        changes.setdefault("render", {}).update(shown)
        # None of these trains.
        changes["sample"] = {"validation_materials": [], "train_only_frictions": []}
        changes.setdefault("instrument", {})["viewpoints"] = VIEWPOINTS
        if one.model is not None:
            (place / "model.yaml").write_text(yaml.safe_dump(one.model))
            changes.setdefault("simulation", {})["model"] = str(place / "model.yaml")
        (place / "changes.yaml").write_text(yaml.safe_dump(changes))
        files = [*(str(ROOT / name) for name in CONFIGS), str(place / "changes.yaml")]
        configs[one.name] = load_config(*files)
        config = configs[one.name]
        for each in simulations(config):
            low, high = one.yaw_deg
            numbers = [
                k
                for k, turn in enumerate(turns_deg(config, each.id)[: one.cameras])
                if low <= abs(turn) <= high and (not one.only or k in one.only.get(each.id, ()))
            ]
            if numbers:
                views = [f"v{k:02d}" for k in numbers]
                jobs.append((place, simulated, files, each.id, views))
    with ThreadPoolExecutor(processes) as pool:
        for number, _ in enumerate(pool.map(lambda job: _film_one(*job), jobs), 1):
            print(f"{number} of {len(jobs)} simulations filmed", file=sys.stderr)
    return configs


def turns_deg(config, simulation):
    """By how much each of the `VIEWPOINTS` is turned about the vertical for a simulation."""
    return [
        draw_bench_camera(config.render, config.seed, simulation, name).yaw_deg
        for name in VIEWPOINTS
    ]


def _film_one(place, simulated, files, simulation, views):
    trajectory = simulated / f"{simulation}.parquet"
    if all((place / "images" / f"{simulation}_{view}.parquet").exists() for view in views):
        return
    given = [word for file in files for word in ("--config", file)]
    if not trajectory.exists():
        calibrated = ["--calibration", str(PUBLISHED / SHIPPED / "calibration.json")]
        run_slipstitch(
            "simulate", "--config", *files, *calibrated, "--simulation", simulation,
            "--out", str(trajectory),
        )  # fmt: skip
    packs = [place / "shading" / f"{simulation}_{view}.parquet" for view in views]
    for view, pack in zip(views, packs, strict=True):
        pack.parent.mkdir(exist_ok=True)
        if not pack.exists():
            run_slipstitch(
                "render", *given, "--trajectory", str(trajectory), "--viewpoint", view,
                "--shading", str(pack),
            )  # fmt: skip
    (place / "images").mkdir(exist_ok=True)
    run_slipstitch(
        "render", *given, "--trajectory", str(trajectory), "--from-shading", *map(str, packs),
        "--out-dir", str(place / "images"),
    )  # fmt: skip


def run_slipstitch(*words):
    """Run the command line in a process of one thread; ends the program where it fails."""
    command = [str(Path(sys.executable).with_name("slipstitch")), *words]
    done = subprocess.run(
        command, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words[:3])}: {done.stderr[-2000:]}")


def trainings(run=SHIPPED):
    """Weights of the instruments of a published run, one a seed."""
    return sorted((PUBLISHED / run / "models/by_simulation/instrument").glob("seed*/*.safetensors"))


def models(run=SHIPPED):
    """Weights of the trainings, and of their average, if there is one: its card has no seed."""
    ensemble = PUBLISHED / run / "models/by_simulation/instrument/ensemble"
    return [*trainings(run), *ensemble.glob("*.safetensors")]


def answering(rows):
    """The rows of the average; of all trainings where there is none."""
    return [row for row in rows if row["seed"] is None] or rows


def publish(name, result, sets, rows, run=SHIPPED):
    """Write a result and its readings to results/published/camera, with the record of its origin.

    The readings are rounded to 1e-4, a hundredth of the instruments' own step. Of another run than
    the one that ships, the file's name ends with the run's.
    """
    brief = [
        {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}
        for row in rows
    ]
    used = [*models(run), PUBLISHED / SHIPPED / "calibration.json"]
    record = provenance_record(
        "evaluate",
        inputs=[path.relative_to(Path.cwd()) for path in used],
        config={one.name: one.changes | {"model": one.model} for one in sets},
    )
    path = PUBLISHED / "camera" / f"{name if run == SHIPPED else f'{name}_{run}'}.json"
    write_json(path, result | {"readings": brief}, record, indent=None)


def readings(configs, folder, measuring):
    """One row a video and instrument: what is true of it, and what the instrument reads.

    `measuring` lists the instruments' weights.
    """
    measuring = [load_instrument(path) for path in measuring]
    rows = []
    for name, config in configs.items():
        frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
        names = config.render.texture_ids()
        for simulation in simulations(config):
            for path in sorted((folder / name / "images").glob(f"{simulation.id}_*.parquet")):
                known = read_metadata(path)
                pose = known.get("pose") or dict.fromkeys(POSE, 0.0)
                row = {
                    "set": name,
                    "simulation": f"{name} {simulation.id}",
                    "material": simulation.material,
                    "friction": simulation.friction,
                    "floor": known["surroundings"]["floor"],
                } | {f"pose_{key}": pose[key] for key in POSE}
                for texture, video in videos(path, frames, config.render.pixels):
                    rows += [
                        row
                        | {"texture": names[texture], "seed": one.card.get("seed")}
                        | reading(one, video, row)
                        for one in measuring
                    ]
    return rows


def videos(path, frames, pixels):
    """Texture's id and images (frames, pixels, pixels, 3) of every video of a shard."""
    for (_, texture, _), images in sorted(read_shard(path, frames).items()):
        yield texture, np.stack([decode(image.png, str(path), pixels) for image in images])


def of_each_simulation(rows):
    """The rows of each simulation, in the order of their first."""
    found = {}
    for row in rows:
        found.setdefault(row["simulation"], []).append(row)
    return list(found.values())


def reading(instrument, video, row):
    """What an instrument says of a video, whose row of the manifest tells its pose."""
    frames = phased(video[None], instrument.card["frames"], None)
    (measurement,) = measured(instrument, frames, [row])
    low, high = measurement.interval_90
    return {
        "reading": measurement.friction_coefficient,
        "low": low,
        "high": high,
        "alarm": measurement.alarm,
    }
