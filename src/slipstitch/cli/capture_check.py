"""slipstitch capture check: whether a camera is suitable for an instrument."""

import argparse
from pathlib import Path

from slipstitch.cli.options import add_instrument, output_path

SUMMARY = (
    "check whether a camera sees the track, from a pose in the training range of an instrument"
)
EXAMPLE = (
    "slipstitch capture check camera.json --model results/instrument/by_simulation/seed0 "
    "--picture check.png"
)

# As for an alarm: a result, but not a usable one.
OUTSIDE_EXIT_CODE = 3


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "camera",
        type=Path,
        metavar="CAMERA.json",
        help="camera file written by slipstitch capture camera",
    )
    add_instrument(parser)
    parser.add_argument(
        "--picture", type=output_path(".png", ".svg"), metavar="FILE", help="PNG or SVG"
    )


def run(arguments: argparse.Namespace) -> int:
    """Compare, draw, print; exit code 3 if the camera cannot be used."""
    from slipstitch.base.page.figures import save_figure
    from slipstitch.base.provenance import provenance_record, recorded_path, start_clock
    from slipstitch.film.measure.camera_check import check_camera, check_figure

    started = start_clock()
    check = check_camera(arguments.camera, arguments.model, arguments.config)
    if arguments.picture:
        record = provenance_record("measure", inputs=check.read, started=started)
        with recorded_path(arguments.picture, record) as temporary:
            save_figure(check_figure(check), temporary, arguments.picture.suffix[1:])
    for line in check.lines():
        print(line)
    return OUTSIDE_EXIT_CODE if check.outside else 0
