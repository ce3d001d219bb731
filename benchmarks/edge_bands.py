"""What an instrument reads of a gingham by where its bands end.

    python benchmarks/edge_bands.py --folder FOLDER [--processes 2]

The simulations, cameras, floors and lamps of `instrument_reach.py` off the grid, in ginghams that
differ by one thing each, and in plain cloths. Goes to results/published/camera/edge_bands.json.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from filmed import SHIPPED, film, models, publish, readings
from instrument_reach import sets

TEXELS = 512
PERIOD = 0.2  # of the cloth: the texture `checks`
WHITE, GREEN = (245, 243, 238), (47, 125, 79)
GREYS = {"plain_white": WHITE, "plain_grey": (128, 128, 128), "plain_black": (48, 48, 48)}
#: Period, turn in degrees, shift of the bands along both edges; light and dark are exchanged.
GINGHAMS = {
    "gingham": (PERIOD, 0, 0.0, False),
    "shifted_half_a_band": (PERIOD, 0, PERIOD / 4, False),
    "colours_exchanged": (PERIOD, 0, 0.0, True),
    "turned_45": (PERIOD, 45, 0.0, False),
    "half_as_large": (PERIOD / 2, 0, 0.0, False),
}


def gingham(period, turn_deg, shift, exchanged):
    """sRGB of bands half a period wide both ways, dark first from either edge at u = v = 0."""
    centres = (np.arange(TEXELS) + 0.5) / TEXELS
    u, v = np.meshgrid(centres, centres)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    along = [cos * u + sin * v + shift, cos * v - sin * u + shift]
    dark = sum(np.mod(one, period) < period / 2 for one in along)[..., None] / 2
    first, second = (WHITE, GREEN) if exchanged else (GREEN, WHITE)
    return dark * np.array(first) + (1 - dark) * np.array(second)


def write_textures(folder):
    """Image files of all, by name."""
    folder.mkdir(parents=True, exist_ok=True)
    images = {name: gingham(*how) for name, how in GINGHAMS.items()}
    images |= {name: np.full((TEXELS, TEXELS, 3), colour) for name, colour in GREYS.items()}
    for name, image in images.items():
        cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1].round().astype(np.uint8))
    return [str(folder / f"{name}.png") for name in images]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True, help="that of instrument_reach.py")
    parser.add_argument("--run", default=SHIPPED, help="folder of results/published")
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    files = write_textures(arguments.folder / "textures")
    off_grid = next(one for one in sets() if one.name == "off_grid")
    banded = replace(off_grid, name="edge_bands", simulated_as="off_grid", textures=tuple(files))
    configs = film([banded], arguments.folder, arguments.processes)
    rows = readings(configs, arguments.folder, models(arguments.run)[-1:])  # the average
    for row in rows:
        row["texture"] = Path(row["texture"]).stem
    result = {
        name: {
            str(friction): {"mean_error": float(np.mean(off)), "videos": len(off)}
            for friction in sorted({row["friction"] for row in rows})
            if (
                off := [
                    row["reading"] - friction
                    for row in rows
                    if row["texture"] == name and row["friction"] == friction
                ]
            )
        }
        for name in (Path(file).stem for file in files)
    }
    publish("edge_bands", {"textures": result}, [off_grid], rows, arguments.run)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
