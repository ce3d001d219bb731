"""Sensitivity of an instrument's estimates to rectification errors of its images.

    python benchmarks/rectification.py --instrument results/instrument/by_simulation/seed0 \
        --dataset results/sample

Test videos of held-out simulations are moved, turned, enlarged and blurred by parts of a pixel, as
by a camera file that errs. Prints, for every error: bias and mean absolute error of mu, coverage of
the 90 % intervals, share of alarms.
"""

import argparse

import numpy as np

from slipstitch.dataset.videos import read_videos, takes_part
from slipstitch.learning.instrument import load_instrument
from slipstitch.learning.instrument.augmentation import phased, rectified_with_errors
from slipstitch.learning.torch_setup import set_up_torch

# Corners' moves in pixels (upper left, upper right, lower left; across and down), blur in pixels.
SIDEWAYS, DOWN = np.array([[1.0, 0.0]] * 3), np.array([[0.0, 1.0]] * 3)
LARGER = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
TURNED = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, -1.0]])
ERRORS = {
    "none": (0.0 * DOWN, 0.0),
    **{f"{size:+g} px across": (size * SIDEWAYS, 0.0) for size in (-0.5, -0.25, 0.25, 0.5)},
    **{f"{size:+g} px down": (size * DOWN, 0.0) for size in (-0.5, -0.25, 0.25, 0.5)},
    **{f"corners {size:+g} px outward": (size * LARGER, 0.0) for size in (-0.25, 0.25)},
    **{f"corners {size:+g} px around": (size * TURNED, 0.0) for size in (-0.25, 0.25)},
    "blur 0.5 px": (0.0 * DOWN, 0.5),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instrument", required=True, nargs="+", help="folders of instruments")
    parser.add_argument("--dataset", required=True, help="folder that `slipstitch sample` wrote")
    parser.add_argument("--every", type=int, default=1, help="measure every so many videos")
    arguments = parser.parse_args()
    set_up_torch(1)
    print(f"{'instrument':<40} {'error':<26} {'bias':>7} {'|error|':>7} {'cover':>6} {'alarm':>6}")
    for folder in arguments.instrument:
        instrument = load_instrument(folder)
        split, view = instrument.card["split"], instrument.card["viewpoints"]
        videos = read_videos(
            arguments.dataset,
            lambda row, split=split, view=view: (
                takes_part(row) and row[f"split_{split}"] == "test" and row["viewpoint"] in view
            ),
            instrument.card["pixels"],
        )
        frames = phased(videos.pixels, instrument.card["frames"], None)[:: arguments.every]
        true = np.array([row["friction"] for row in videos.rows])[:: arguments.every]
        for name, (corners, blur) in ERRORS.items():
            measurements = [
                instrument.measure(
                    np.stack([rectified_with_errors(frame, corners, blur) for frame in video])
                )
                for video in frames
            ]
            away = np.array([measured.friction_coefficient for measured in measurements]) - true
            low, high = np.array([measured.interval_90 for measured in measurements]).T
            print(
                f"{folder:<40} {name:<26} {away.mean():>+7.3f} {abs(away).mean():>7.3f} "
                f"{np.mean((low <= true) & (true <= high)):>6.0%} "
                f"{np.mean([measured.alarm for measured in measurements]):>6.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
