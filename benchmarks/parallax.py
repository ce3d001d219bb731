"""How far a displaced camera shifts the cloth that is seen through a surface: a Markdown table.

``python benchmarks/parallax.py results/simulate/m05_f0500_r00.parquet ...``: root mean square over
the vertices of all frames from the landing on, in pixels of a 112-pixel crop; least and largest of
the trajectories. No occlusion: vertices that no camera sees count as well.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design.stage_path import StagePath
from slipstitch.images.calibrated_view import cloth_room, cloth_size, crop_to
from slipstitch.images.camera import pose
from slipstitch.images.mean_cloth import MeanCloth, Plane, lags_m
from slipstitch.physics.simulation.trajectory import read_trajectory

CALIBRATED = VIEWPOINTS["calibrated"]
CAMERAS = {
    "camera 5° aside": replace(CALIBRATED, azimuth_deg=CALIBRATED.azimuth_deg + 5),
    "10° aside": replace(CALIBRATED, azimuth_deg=CALIBRATED.azimuth_deg + 10),
    "5° higher": replace(CALIBRATED, elevation_deg=CALIBRATED.elevation_deg + 5),
    "30 cm farther": replace(CALIBRATED, distance_m=CALIBRATED.distance_m + 0.3),
}
SURFACES = {
    "mean cloth and floor (used)": MeanCloth,
    "upright plane, across the track": lambda x, z, lag: Plane((1.0, 0.0, 0.0), x),
    "upright plane and floor": lambda x, z, lag: MeanCloth(x, z, 0.0),
}
PARTS = {"all": lambda v: v >= 0, "lower edge, lying in front": lambda v: v > 0.99}


def shifts_px(trajectory, surface, camera):
    """Root mean square over all vertices, and over the lower edge while it lies in front."""
    size_m = cloth_size(trajectory)
    lags = lags_m(trajectory.stage_x_m, trajectory.stage_z_m, size_m[1])
    rotation, translation_m = pose(camera)
    eye = -rotation.T @ translation_m
    squares = {part: [] for part in PARTS}
    landed = np.searchsorted(trajectory.time_s, StagePath().drop_duration_s)
    for row in range(landed, len(trajectory.time_s), 5):
        x, z = trajectory.stage_x_m[row], trajectory.stage_z_m[row]
        crop = crop_to(pose(CALIBRATED), cloth_room(x, z, *size_m), 112)
        points = trajectory.positions_m[row].astype(float)
        seen = crop.project(surface(x, z, lags[row]).seen(eye, points - eye))
        square = np.sum((seen - crop.project(points)) ** 2, axis=1)
        for part, chosen in PARTS.items():
            if part == "all" or lags[row] > 0.05:
                squares[part].append(square[chosen(trajectory.uv[:, 1])])
    return {part: float(np.sqrt(np.mean(np.concatenate(s)))) for part, s in squares.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trajectories", type=Path, nargs="+")
    trajectories = [read_trajectory(path) for path in parser.parse_args().trajectories]
    print("| surface | part | " + " | ".join(CAMERAS) + " |")
    print("|---|---|" + "---|" * len(CAMERAS))
    for name, surface in SURFACES.items():
        of = [[shifts_px(t, surface, camera) for t in trajectories] for camera in CAMERAS.values()]
        for part in PARTS:
            cells = [[shifts[part] for shifts in column] for column in of]
            shown = [f"{min(cell):.2f} … {max(cell):.2f}" for cell in cells]
            print(f"| {name} | {part} | " + " | ".join(shown) + " |")


if __name__ == "__main__":
    main()
