"""slipstitch capture camera: pictures of a board in, camera file out."""

import argparse
from pathlib import Path

from slipstitch.cli.options import flag, output_path, refuse, require

SUMMARY = "calibrate a camera from images or a video of a checkerboard or ChArUco board"
EXAMPLE = (
    "slipstitch capture camera --squares 10x7 --square-mm 20 --stage-view floor.png "
    "--place-mm 50 -60 --out camera.json --picture camera.png board/*.png"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "views", nargs="*", type=Path, metavar="FILE", help="images of the board, or one video"
    )
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="FILE",
        help="take the lens from a calibration of OpenCV (YAML, XML, JSON) or ROS (camera_info) "
        "in place of images of the board",
    )
    parser.add_argument("--board", choices=("checkerboard", "charuco"), default="checkerboard")
    parser.add_argument(
        "--squares", metavar="MxN", help="number of squares along the board's width and height"
    )
    parser.add_argument("--square-mm", type=float, help="side length of a square")
    parser.add_argument("--marker-mm", type=float, help="ChArUco: side length of a marker")
    parser.add_argument(
        "--dictionary",
        help="ChArUco: OpenCV's name of the marker dictionary (default: DICT_5X5_100)",
    )
    parser.add_argument(
        "--stage-view",
        type=Path,
        metavar="IMAGE",
        help="image of the board flat on the floor, from the camera's position on the bench; "
        "without it the file lacks the camera's position and cannot be used for rendering",
    )
    parser.add_argument(
        "--place-mm",
        nargs=2,
        type=float,
        metavar=("X", "Y"),
        help="position of the board's first corner in that image, in the stage's coordinates",
    )
    parser.add_argument(
        "--angle-deg",
        type=float,
        help="angle from the stage's direction to the board's width, counter-clockwise from above",
    )
    parser.add_argument(
        "--thickness-mm", type=float, help="height of the board's face above the floor (default: 0)"
    )
    parser.add_argument(
        "--out", required=True, type=output_path(".json"), metavar="FILE", help="camera file"
    )
    parser.add_argument(
        "--picture",
        type=output_path(".png", ".svg"),
        metavar="FILE",
        help="the residuals (PNG or SVG)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, write the camera file and the picture, print the result in one line."""
    from slipstitch.base.errors import BadInput
    from slipstitch.film.board import Board
    from slipstitch.film.calibration_files import calibrate_to_file, import_to_file
    from slipstitch.film.stage_pose import FloorPlace

    for name in ("place_mm", "angle_deg", "thickness_mm"):
        if getattr(arguments, name) is not None:
            require(arguments, ["stage_view"], flag(name))
    for name, most in (("place_mm", 10_000), ("angle_deg", 360), ("thickness_mm", 1000)):
        given = getattr(arguments, name) or 0.0
        for value in given if isinstance(given, list) else [given]:
            if not abs(value) <= most:
                raise BadInput(f"{flag(name)}: {value:g}; must be from {-most} to {most}")
    if bool(arguments.source) == bool(arguments.views):
        raise BadInput("give images of the board, or the calibration of another program by --from")
    if arguments.source:
        refuse(arguments, ("picture",), "--from")
    is_board_seen = bool(arguments.views or arguments.stage_view)
    if is_board_seen:
        require(arguments, ["squares", "square_mm"], "an image of a board")
    if arguments.board == "checkerboard":
        refuse(arguments, ("dictionary",), "--board checkerboard")
    board = None
    if is_board_seen:
        board = Board.named(
            arguments.board,
            arguments.squares,
            arguments.square_mm,
            arguments.marker_mm,
            arguments.dictionary or "DICT_5X5_100",
        )
    x_mm, y_mm = arguments.place_mm or (0.0, 0.0)
    place = FloorPlace(x_mm, y_mm, arguments.angle_deg or 0.0, arguments.thickness_mm or 0.0)
    stage_view, out = arguments.stage_view, arguments.out
    if board and arguments.views:
        line = calibrate_to_file(board, arguments.views, stage_view, place, out, arguments.picture)
    else:
        line = import_to_file(arguments.source, board, stage_view, place, out)
    print(f"{arguments.out}: {line}")
