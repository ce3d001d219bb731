"""What misleads the instrument in surrogate videos: what it sees, or how the cloth moves?

    python benchmarks/surrogate_places.py --folder FOLDER [--processes 2]

FOLDER is that of benchmarks/instrument_surrogates.py. Every surrogate's simulation is known, and
made again here; so is the one with clamps, curl and fabric as in the paper's experiment. An
instrument that reads friction from places of the cloth reads from those in the video, from those
of its simulation, and from those of that other one. Goes to
results/published/camera/surrogate_places.json; surrogate_places_one_side.json is of an instrument
that had learnt from the paper's bench alone.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import torch
import yaml
from filmed import CONFIGS, ROOT, SHIPPED, FilmedSet, publish, trainings
from scipy.interpolate import RegularGridInterpolator

from slipstitch.base.errors import BadInput
from slipstitch.config import load_config
from slipstitch.film.measure.measuring import measuring_bench
from slipstitch.film.surrogate.bench import films, surrogate_simulation
from slipstitch.images.keypoints import KEYPOINTS_UV, keypoint_vertices_uv
from slipstitch.learning.instrument.distribution import medians, mixture_cumulative
from slipstitch.physics.simulation.drop_and_drag import draw_perturbation, simulate_drop_and_drag

BENCHES = ("surrogate", "ideal")
LOWER_EDGE = KEYPOINTS_UV[:, 1] == 1.0


def settings_of(config, bench):
    """Of the surrogates' simulations, perturbed or with clamps, curl and fabric of the paper's."""
    perturbed = surrogate_simulation(config)
    if bench == "surrogate":
        return perturbed
    return perturbed.model_copy(update={"ideal_replicates": 1, "curl_side": "same"})


def places_of(config, film, bench, trained_vertices):
    """Times (T,) and places (T, 9, 3) of the points that training marks, relative to the clamps."""
    settings = settings_of(config, bench)
    trajectory, _ = simulate_drop_and_drag(film.pair.material, film.friction, film.seed, settings)
    side = settings.vertices_per_side
    grid = trajectory.positions_m.reshape(-1, side, side, 3).transpose(1, 2, 0, 3)
    uv = trajectory.uv.reshape(side, side, 2)
    down, across = uv[:, 0, 1], uv[0, :, 0]
    marked = keypoint_vertices_uv(trained_vertices)  # vertices of another mesh than this one's
    places = RegularGridInterpolator((down, across), grid)(marked[:, ::-1]).transpose(1, 0, 2)
    places[..., 0] -= trajectory.stage_x_m[:, None]
    return trajectory.time_s, places


def made(config, folder, processes):
    """Places by video and bench; simulated where a file of them is missing."""
    jobs = [(film, bench) for film in films(config) for bench in BENCHES]
    paths = [folder / f"{film.id}_{bench}_places.npz" for film, bench in jobs]
    missing = [k for k, path in enumerate(paths) if not path.exists()]
    with ProcessPoolExecutor(processes) as pool:
        count = config.simulation.vertices_per_side
        running = {k: pool.submit(places_of, config, *jobs[k], count) for k in missing}
        for k in missing:
            time_s, places_m = running[k].result()
            np.savez_compressed(paths[k], time_s=time_s, places_m=places_m.astype(np.float32))
            print(f"{jobs[k][0].id}, {jobs[k][1]} bench: simulated", flush=True)
    read = [np.load(path) for path in paths]
    return {
        (film.id, bench): (one["time_s"], one["places_m"].astype(float))
        for (film, bench), one in zip(jobs, read, strict=True)
    }


def at(times_s, known):
    """Places at some times, float32 tensor of shape (1, n, 9, 3)."""
    time_s, places_m = known
    flat = places_m.reshape(len(places_m), -1)
    found = [np.interp(times_s, time_s, column) for column in flat.T]
    return torch.from_numpy(np.stack(found, axis=1).reshape(1, len(times_s), 9, 3)).float()


def reading(network, places_m):
    """Median of what the recurrent layer reads from places."""
    unit = (places_m - network.points_mean_m) / network.points_spread_m
    with torch.inference_mode():
        cumulative = mixture_cumulative(network.of_places(unit)["friction"], network.middles)
    return float(medians(cumulative, network.grid))


def places_off(found_m, true_m):
    """How far places (n, 9, 3) are from the true ones, mean over the axes, and along the track."""
    off_mm = 1e3 * (found_m - true_m)
    return {
        "places_off_mm": float(np.abs(off_mm).mean()),
        "lower_edge_off_mm": float(np.abs(off_mm[:, LOWER_EDGE, 0]).mean()),
    }


def mean_errors(rows, names):
    """Mean error of each of these readings."""
    return {
        name: float(np.mean([abs(row[name] - row["friction"]) for row in rows])) for name in names
    }


def rows_of(config, film, folder, places, run):
    """One row an instrument; none if the video is refused."""
    settings = surrogate_simulation(config)
    curl = draw_perturbation(settings, film.seed).natural_curl_per_m
    for model in trainings(run):
        bench = measuring_bench(folder / f"{film.id}.json", model.parent)
        try:
            result = bench.measure(folder / f"{film.id}.mp4")
        except BadInput:
            return
        true_m, ideal_m = (at(result.video.time_s, places[film.id, one]) for one in BENCHES)
        moved_m = (true_m - ideal_m)[0]
        yield {
            "simulation": film.id,
            "seed": bench.instrument.card["seed"],
            "material": film.pair.material,
            "friction": film.friction,
            "curl_per_m": curl,
            "reading": float(result.measurement.friction_coefficient),
            "from_its_places": reading(bench.instrument.networks[0], true_m),
            "from_ideal_places": reading(bench.instrument.networks[0], ideal_m),
            **places_off(result.measurement.points_m, true_m[0].numpy()),
            "lower_edge_elsewhere_mm": float(1e3 * moved_m[:, LOWER_EDGE, 0].abs().mean()),
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    changes = arguments.folder / "changes.yaml"
    config = load_config(*(str(ROOT / name) for name in CONFIGS), str(changes))
    places = made(config, arguments.folder, arguments.processes)
    rows = [
        row
        for film in films(config)
        for row in rows_of(config, film, arguments.folder, places, arguments.run)
    ]
    summary = mean_errors(rows, ("reading", "from_its_places", "from_ideal_places"))
    sets = [FilmedSet("surrogates", yaml.safe_load(changes.read_text()))]
    publish("surrogate_places", {"errors": summary}, sets, rows, arguments.run)
    for row in rows:
        print(json.dumps(row))
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
