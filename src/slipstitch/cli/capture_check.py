"""slipstitch capture check: may this camera film for that instrument?"""

import argparse
from pathlib import Path

from slipstitch.cli.options import check_picture, output_path

SUMMARY = "whether a camera stands where an instrument was trained, before anything is filmed"
EXAMPLE = (
    "slipstitch capture check camera.json --model results/instrument/by_simulation/seed0 "
    "--picture check.png"
)

# As of an alarm: an answer, but none to film by.
OUTSIDE_EXIT_CODE = 3


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "camera", type=Path, metavar="CAMERA.json", help="file of slipstitch capture camera"
    )
    parser.add_argument(
        "--model", required=True, type=Path, metavar="DIR", help="a trained instrument"
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration that the instrument was trained with (default: config.json in the "
        "nearest folder above the model)",
    )
    parser.add_argument("--picture", type=output_path, metavar="FILE", help="PNG or SVG")


def run(arguments: argparse.Namespace) -> int:
    """Compare, draw, print; exit code 3 if the camera stands outside."""
    from slipstitch.measure.camera_check import check_camera, check_figure
    from slipstitch.page.figures import save_figure

    check_picture(arguments.picture)
    check = check_camera(arguments.camera, arguments.model, arguments.config)
    if arguments.picture:
        save_figure(check_figure(check), arguments.picture, arguments.picture.suffix[1:])
    for line in check.lines():
        print(line)
    return OUTSIDE_EXIT_CODE if check.outside else 0
