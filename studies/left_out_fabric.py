"""How well a fabric is read that nothing was learnt from, and what its bending length adds.

    python studies/left_out_fabric.py SIMULATIONS --out left_out_fabric.json

SIMULATIONS is a folder of trajectories of one bench, ten fabrics at many coefficients. Friction is
read from the places of the instrument's nine keypoints, as simulated and with the noise of a
finder: their first principal components, through a Gaussian process whose lengths maximise the
likelihood. Either single simulations are left out, or whole fabrics, of which nothing is told, the
bending length, or the areal density too. How far apart the keypoints of a fabric and of the one
most like it are, coefficient by coefficient, is measured beside. A study: asked once, not
maintained.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config import load_config
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.measure import SHIPPED
from slipstitch.film.measure.told_fabric import bending_length_m
from slipstitch.images.camera import keypoints_m
from slipstitch.physics.fabric import load_fabric
from slipstitch.physics.simulation.trajectory import read_trajectory

FRICTION_MIN = 0.3  # below, a cloth that is pushed has another shape
COMPONENTS = 8
NOISES_M = (0.0, 0.0005, 0.001)  # of each coordinate in each frame
TOLD = {"nothing": (), "bending length": (0,), "bending length and areal density": (0, 1)}


def kernel(one, other, lengths, variance):
    """Return the squared exponential of two sets of points."""
    apart = ((one[:, None] - other[None]) / lengths) ** 2
    return variance * np.exp(-0.5 * apart.sum(-1))


def fitted(places, logs):
    """Return lengths, variance and noise of the likeliest Gaussian process."""
    size = places.shape[1]

    def loss(parameters):
        lengths, variance, noise = np.split(np.exp(parameters), [size, size + 1])
        matrix = kernel(places, places, lengths, variance) + noise * np.eye(len(logs))
        factor = cho_factor(matrix, lower=True)
        return 0.5 * logs @ cho_solve(factor, logs) + np.log(np.diag(factor[0])).sum()

    bounds = [(-2, 6)] * size + [(-4, 6), (np.log(1e-5), 0)]
    start = np.r_[np.ones(size), 0.0, np.log(1e-3)]
    found = minimize(loss, start, bounds=bounds, options={"maxiter": 60}).x
    return np.split(np.exp(found), [size, size + 1])


def predicted(places, logs, new):
    """Return the logarithms at new places."""
    mean = logs.mean()
    lengths, variance, noise = fitted(places, logs - mean)
    matrix = kernel(places, places, lengths, variance) + noise * np.eye(len(logs))
    weights = cho_solve(cho_factor(matrix, lower=True), logs - mean)
    return mean + kernel(new, places, lengths, variance) @ weights


def errors(keypoints, friction, told, groups):
    """Return errors of the friction of each group, read from the others."""
    found = np.empty(len(friction))
    for group in np.unique(groups):
        out = groups == group
        mean = keypoints[~out].mean(0)
        _, sizes, axes = np.linalg.svd(keypoints[~out] - mean, full_matrices=False)
        spread = sizes[:COMPONENTS] / np.sqrt((~out).sum())
        places = (keypoints - mean) @ axes[:COMPONENTS].T / spread
        known = (told - told[~out].mean(0)) / told[~out].std(0)
        places = np.hstack([places, known])
        found[out] = np.exp(predicted(places[~out], np.log(friction[~out]), places[out]))
    return found - friction


def nearest_fabric_mm(keypoints, friction):
    """Return the distance to the fabric most like each, its median over fabrics, by friction.

    Root mean square over keypoints and frames; keypoints (n, frames * 9 * 3) in metres.
    """
    found = {}
    for value in np.unique(friction):
        mine = keypoints[friction == value]
        apart_m = cdist(mine, mine) / np.sqrt(mine.shape[1] / 3)
        np.fill_diagonal(apart_m, np.inf)
        found[f"{value:g}"] = 1e3 * float(np.median(apart_m.min(1)))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("simulations", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    started = start_clock()
    config = load_config(SHIPPED / "config.json")
    frames = Schedule.of(config).frame
    files = sorted(chosen.simulations.glob("*.parquet"))
    runs = [read_trajectory(path) for path in files]
    friction = np.array([run.metadata["friction"] for run in runs])
    material = np.array([run.metadata["material"] for run in runs])
    fabrics = [load_fabric(name) for name in material]
    told = np.log([[bending_length_m(one), one.areal_density_kg_m2] for one in fabrics])
    places = [keypoints_m(run.positions_m, run.uv, run.stage_x_m)[frames] for run in runs]
    keypoints = np.array(places).reshape(len(runs), -1)
    nearest_mm = nearest_fabric_mm(keypoints, friction)
    use = friction >= FRICTION_MIN
    keypoints, friction, material, told = (
        array[use] for array in (keypoints, friction, material, told)
    )
    # One simulation of every fabric, along diagonals of fabrics and coefficients.
    number, place = (np.unique(one, return_inverse=True)[1] for one in (material, friction))
    diagonal = (number + place) % (place.max() + 1)
    result = {
        "simulations": int(use.sum()),
        "fabrics": len(set(material)),
        "noise_mm": {},
        "nearest_fabric_mm": nearest_mm,
    }
    for noise_m in NOISES_M:
        noise = np.random.default_rng(0).normal(0.0, noise_m, keypoints.shape)
        cases = {"fabric known": (told[:, :0], diagonal)}
        cases |= {
            f"fabric left out, {name}": (told[:, list(of)], material) for name, of in TOLD.items()
        }
        result["noise_mm"][f"{1e3 * noise_m:g}"] = {
            name: float(np.abs(errors(keypoints + noise, friction, *case)).mean())
            for name, case in cases.items()
        }
        print(noise_m, result["noise_mm"][f"{1e3 * noise_m:g}"], flush=True)
    write_json(chosen.out, result, provenance_record("measure", inputs=files, started=started))


if __name__ == "__main__":
    main()
