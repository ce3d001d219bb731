"""Composed images against direct renders, on every floor from every training viewpoint.

    python benchmarks/composition.py --results composition.jsonl     # everything
    python benchmarks/composition.py --results composition.jsonl --viewpoints frontal
    python benchmarks/composition.py --results composition.jsonl --table

Simulates two of the paper's grid (or takes `--trajectories`), draws floors, frames and textures by
seed, renders each image at 256 paths a pixel with the texture on the cloth, and composes it from a
shading of its own. One line per image is appended to the results; existing ones are not repeated;
the table is made of them.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from slipstitch.config.catalogue import FLOORS, TEXTURES
from slipstitch.config.render import RenderSettings
from slipstitch.images.blender import ClothScene
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import encode_srgb
from slipstitch.images.packing import render_shadings
from slipstitch.images.surroundings import draw_surroundings, generator
from slipstitch.images.textures import texture
from slipstitch.images.verification import LEAST_PSNR_DB, LEAST_SSIM, psnr_db, ssim
from slipstitch.images.view import View, usable_trajectory

ROOT = Path(__file__).parents[1]
SIMULATIONS = ("m03_f0400_r00", "m08_f1100_r00")
VIEWPOINTS = ("calibrated", "frontal", "side")
SEED = 7


def simulated(folder: Path) -> list[Path]:
    """Trajectories of the paper's scale; those that lie in the folder are not made again."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.parquet" for name in SIMULATIONS]
    scale = ["--config", str(ROOT / "config.yaml"), "--config", str(ROOT / "config/paper.yaml")]
    for path in paths:
        if not path.exists():
            words = ["simulate", *scale, "--simulation", path.stem, "--out", str(path)]
            subprocess.run([sys.executable, "-m", "slipstitch", *words], check=True)
    return paths


def compare(path: Path, floor: str, viewpoint: str, pixels: int, images: int) -> list[dict]:
    """One frame of a simulation on a floor, in some textures."""
    trajectory = usable_trajectory(path)
    settings = RenderSettings(pixels=pixels, frames="all", floors=[floor])
    rng = generator(SEED, path.stem, floor, viewpoint)
    view = View(path, "v00", viewpoint, settings, 1, SEED)
    shot = view.shots(trajectory)[int(rng.integers(len(trajectory.frame)))]
    names = [str(name) for name in rng.choice(list(TEXTURES), images, replace=False)]
    surroundings = draw_surroundings(settings, SEED, f"{path.stem} {floor} {viewpoint}")
    ((_, shading, sight),) = render_shadings(trajectory, [shot], settings, surroundings)
    scene = ClothScene(trajectory.faces, trajectory.uv, surroundings)
    rows = []
    for name, light in zip(names, compose_light(join(shading, sight), names), strict=True):
        composed = encode_srgb(light)
        scene.wear(texture(name))
        positions, seed = trajectory.positions_m[shot.row], 2**20 + shot.frame
        direct = scene.render(positions, shot.camera, samples=256, seed=seed)
        reference = encode_srgb(direct.radiance.sum(axis=0))
        rows.append(
            {
                "simulation": path.stem,
                "frame": shot.frame,
                "texture": name,
                "floor": floor,
                "viewpoint": viewpoint,
                "pixels": pixels,
                "reflectance": surroundings.reflectance,
                "roughness": surroundings.roughness,
                "psnr_db": psnr_db(composed, reference),
                "ssim": ssim(composed, reference),
            }
        )
    return rows


def table(rows: list[dict]) -> str:
    """Lowest and mean PSNR of every floor and viewpoint, and the lowest SSIM."""
    lines = [
        f"| floor | demand | {' | '.join(VIEWPOINTS)} | lowest SSIM |",
        f"|---|---|{'---|' * len(VIEWPOINTS)}---|",
    ]
    for floor, look in FLOORS.items():
        of_floor = [row for row in rows if row["floor"] == floor]
        if not of_floor:
            continue
        cells = []
        for viewpoint in VIEWPOINTS:
            values = [row["psnr_db"] for row in of_floor if row["viewpoint"] == viewpoint]
            cells.append(f"{min(values):.1f}, {np.mean(values):.1f}" if values else "")
        similar = min(row["ssim"] for row in of_floor)
        demand = LEAST_PSNR_DB[look.reflectance[1] > 0]
        lines.append(f"| {floor} | {demand:g} | {' | '.join(cells)} | {similar:.3f} |")
    return "\n".join(lines)


def falls_short(row: dict) -> bool:
    """Whether an image is further from the direct one than the verification allows."""
    least = LEAST_PSNR_DB[FLOORS[row["floor"]].reflectance[1] > 0]
    return row["psnr_db"] < least or row["ssim"] < LEAST_SSIM


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="JSON lines, added to")
    parser.add_argument("--trajectories", type=Path, help="folder to keep the simulations in")
    parser.add_argument("--floors", nargs="+", default=list(FLOORS), choices=FLOORS)
    parser.add_argument("--viewpoints", nargs="+", default=VIEWPOINTS, choices=VIEWPOINTS)
    parser.add_argument("--pixels", type=int, default=112)
    parser.add_argument("--images", type=int, default=2, help="textures a frame")
    parser.add_argument("--table", action="store_true", help="only show what there is")
    chosen = parser.parse_args()
    done = chosen.results.read_text().splitlines() if chosen.results.exists() else []
    rows = [json.loads(line) for line in done]
    if not chosen.table:
        there = {(row["simulation"], row["floor"], row["viewpoint"]) for row in rows}
        paths = simulated(chosen.trajectories or chosen.results.parent / "trajectories")
        for viewpoint in chosen.viewpoints:
            for floor in chosen.floors:
                for path in paths:
                    if (path.stem, floor, viewpoint) in there:
                        continue
                    new = compare(path, floor, viewpoint, chosen.pixels, chosen.images)
                    with chosen.results.open("a") as stream:
                        stream.writelines(json.dumps(row) + "\n" for row in new)
                    rows += new
    print(table(rows))
    return int(any(map(falls_short, rows)))


if __name__ == "__main__":
    sys.exit(main())
