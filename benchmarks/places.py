"""How well the places of nine points of the cloth tell its friction, by the error of the places.

    python benchmarks/places.py FOLDER

FOLDER holds the trajectories of config/instrument.yaml (results/simulate). The recurrent
part of the instrument's network learns from the places in the simulations that train, and between
them as films lie, with errors of the cloth's shift, of each point and of each frame; it is tested
on coefficients held out of fabrics that train, and on a fabric that does not; once it learns from
simulations of the ideal bench alone. No image is rendered: what an instrument errs beyond this
comes from seeing, not from the cloth.
Goes to results/published/camera/places.json.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import torch
from filmed import CONFIGS, ROOT
from interpolation import HEIGHT_M, digests

from slipstitch.base.provenance import provenance_record, write_json
from slipstitch.config import load_config
from slipstitch.design.grid import simulations
from slipstitch.design.interpolation import between
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.splits import sides_of_simulations
from slipstitch.images.keypoints import keypoints_m
from slipstitch.learning.instrument.distribution import (
    medians,
    mixture_cumulative,
    ranked_probability_score,
)
from slipstitch.learning.instrument.network import InstrumentNetwork
from slipstitch.learning.instrument.training import learning_rate, noisy_places, unit_of_points
from slipstitch.physics.simulation.trajectory import read_trajectory

RESULT = ROOT / "results" / "published" / "camera" / "places.json"
NOISE_MM = (0.5, 1.0, 2.0, 3.0)
STEPS, BATCH, VIEWS = 1500, 32, 20


class Places:
    """Simulations with their places; draws examples to learn from."""

    def __init__(self, config, folder):
        sides = sides_of_simulations(config)
        self.places, self.of = {}, defaultdict(list)
        for one in simulations(config):
            trajectory = read_trajectory(folder / f"{one.id}.parquet")
            places = keypoints_m(trajectory.positions_m, trajectory.uv, trajectory.stage_x_m)
            self.places[one.id] = places[sampled_frames(len(places), config.sample.frames)]
            side = sides[one.id]
            if side == "validation" and one.material in config.sample.validation_materials:
                side = "unseen fabric"
            self.of[side].append(one)
        self.fabrics = sorted({one.material for one in self.of["train"]})
        lowest = config.render.interpolation.from_friction
        self.rows = defaultdict(list)
        for one in self.of["train"]:
            if one.friction >= lowest:
                self.rows[one.material, one.replicate].append(one)
        trained = np.stack([self.places[one.id] for one in self.of["train"]])
        self.mean_m, self.spread_m = unit_of_points(torch.from_numpy(trained))

    def unit(self, places):
        return ((torch.from_numpy(np.stack(places)) - self.mean_m) / self.spread_m).float()

    def drawn(self, generator, interpolated, training):
        """Places, friction and fabric's number of one simulation of these, or between two."""
        one = training[generator.integers(len(training))]
        places, friction = self.places[one.id], one.friction
        row = self.rows[one.material, one.replicate]
        if interpolated and one in row:
            friction = generator.uniform(row[0].friction, row[-1].friction)
            parts = between(row, friction, HEIGHT_M)
            places = sum(share * self.places[name] for name, share in parts.items())
        return places, friction, self.fabrics.index(one.material)


def errors(settings, data, noise_mm, interpolated, replicates, seed):
    """Mean error of every simulation that does not train, by its id."""
    torch.manual_seed(seed)
    generator = np.random.default_rng(seed)
    network = InstrumentNetwork(settings, len(data.fabrics), 64)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=settings.weight_decay)
    spread_m = data.spread_m.float()

    def cumulative_of(places):
        seen = noisy_places(data.unit(places), spread_m, noise_mm / 1e3, generator)
        answers = network.of_places(seen)
        return mixture_cumulative(answers["friction"], network.middles), answers["material"]

    training = [one for one in data.of["train"] if one.replicate < replicates]
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(settings, step / STEPS)
        places, frictions, fabrics = zip(
            *(data.drawn(generator, interpolated, training) for _ in range(BATCH)), strict=True
        )
        cumulative, logits = cumulative_of(places)
        truth = torch.tensor(frictions, dtype=torch.float32)
        score = ranked_probability_score(cumulative, truth, network.grid).mean()
        fabric = torch.nn.functional.cross_entropy(logits, torch.tensor(fabrics))
        loss = score / 0.25 + settings.material_weight * fabric
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
    network.eval()
    found = {}
    with torch.inference_mode():
        for side in ("validation", "test", "unseen fabric"):
            for one in data.of[side]:
                cumulative, _ = cumulative_of([data.places[one.id]] * VIEWS)
                error = medians(cumulative, network.grid) - one.friction
                found[one.id] = float(error.abs().mean())
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = load_config(*(str(ROOT / name) for name in CONFIGS))
    settings = config.instrument
    data = Places(config, arguments.folder)
    unseen = {one.id for one in data.of["unseen fabric"]}
    rows = []
    every = config.grid.replicates
    cases = [(one, True, every) for one in NOISE_MM] + [(1.0, False, every), (1.0, True, 1)]
    for noise_mm, interpolated, replicates in cases:
        each = [
            errors(settings, data, noise_mm, interpolated, replicates, seed)
            for seed in range(arguments.seeds)
        ]
        of_simulation = {name: float(np.mean([one[name] for one in each])) for name in each[0]}
        known = {name: error for name, error in of_simulation.items() if name not in unseen}
        ideal = [error for name, error in known.items() if name.endswith("_r00")]
        own = [error for name, error in known.items() if not name.endswith("_r00")]
        rows.append(
            {
                "noise_mm": noise_mm,
                "interpolated": interpolated,
                "replicates": replicates,
                "held_out_ideal": float(np.mean(ideal)),
                "held_out_own": float(np.mean(own)),
                "held_out_worst": max(known.values()),
                "unseen_fabric": float(np.mean([of_simulation[name] for name in unseen])),
                "by_simulation": of_simulation,
            }
        )
        print(json.dumps({k: v for k, v in rows[-1].items() if k != "by_simulation"}), flush=True)
    result = {
        "train": len(data.of["train"]),
        "held_out": len(data.of["validation"]) + len(data.of["test"]),
        "unseen_fabric": len(unseen),
        "seeds": arguments.seeds,
        "rows": rows,
    }
    record = provenance_record(
        "instrument",
        inputs=[],
        config={
            "instrument": settings.model_dump(mode="json"),
            "simulations": digests(arguments.folder),
        },
    )
    write_json(RESULT, result, record, indent=None)


if __name__ == "__main__":
    main()
