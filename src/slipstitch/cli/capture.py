"""What is measured on a real bench: camera, videos, reference friction; and surrogates of it."""

import sys
from functools import partial

import click
from click import argument, option

from slipstitch.base.errors import BadInput
from slipstitch.cli import options

CAMERA_EXAMPLE = (
    "slipstitch capture camera --squares 10x7 --square-mm 20 --stage-view floor.png "
    "--place-mm 50 -60 --out camera.json --picture camera.png board/*.png"
)


@click.group(
    epilog=options.example(CAMERA_EXAMPLE),
    short_help="process measurements from a real bench: camera, videos, reference friction",
    subcommand_metavar="WHAT [options]",
)
def capture() -> None:
    """Process measurements from a real bench: camera, videos, reference friction."""


@options.verb(CAMERA_EXAMPLE, parent=capture)
@argument("views", nargs=-1, type=options.FILE, metavar="[FILE...]", help="images, or a video")
@option(
    "--from",
    "source",
    type=options.FILE,
    help="take the lens from a calibration of OpenCV (YAML, XML, JSON) or ROS (camera_info)",
)
@option("--board", type=click.Choice(("checkerboard", "charuco")), default="checkerboard")
@option("--squares", metavar="MxN", help="number of squares along the board's width and height")
@option("--square-mm", type=float, help="side length of a square")
@option("--marker-mm", type=float, help="ChArUco: side length of a marker")
@option("--dictionary", help="ChArUco: OpenCV's name of it (default: DICT_5X5_100)")
@option("--stage-view", type=options.FILE, help="the board on the floor, from the camera's place")
@option("--place-mm", nargs=2, type=float, metavar="X Y", help="its first corner on the stage")
@option("--angle-deg", type=float, help="from the stage to its width, counter-clockwise from above")
@option(
    "--thickness-mm",
    type=float,
    help="height of its face above the floor (default: 0); with the place it tells the clamps'",
)
@option("--out", required=True, type=options.JSON, help="camera file")
@option("--picture", type=options.PICTURE, help="the residuals (PNG or SVG)")
def camera(arguments: options.Arguments) -> None:
    """Calibrate a camera from images or a video of a checkerboard or ChArUco board."""
    from slipstitch.film.camera_calibration import FloorPlace, camera_to_file

    for name, most in (("place_mm", 10_000), ("angle_deg", 360), ("thickness_mm", 1000)):
        value = getattr(arguments, name)
        if value is None:
            continue
        options.require(arguments, ["stage_view"], options.flag(name))
        for one in value if isinstance(value, tuple) else [value]:
            if not abs(one) <= most:
                raise BadInput(f"{options.flag(name)}: {one:g}; must be from {-most} to {most}")
    if bool(arguments.source) == bool(arguments.views):
        raise BadInput("give images of the board, or the calibration of another program by --from")
    if arguments.source:
        options.refuse(arguments, ("picture",), "--from")
    board = _board(arguments)
    is_measured = None not in (arguments.place_mm, arguments.thickness_mm)
    x_mm, y_mm = arguments.place_mm or (0.0, 0.0)
    place = FloorPlace(
        x_mm, y_mm, arguments.angle_deg or 0.0, arguments.thickness_mm or 0.0, is_measured
    )
    source, out = arguments.source or list(arguments.views), arguments.out
    line = camera_to_file(source, board, arguments.stage_view, place, out, arguments.picture)
    print(f"{out}: {line}")


def _board(arguments: options.Arguments):
    """The board, None where no image shows one."""
    from slipstitch.film.board import Board

    is_board_seen = bool(arguments.views or arguments.stage_view)
    if is_board_seen:
        options.require(arguments, ["squares", "square_mm"], "an image of a board")
    if arguments.board == "checkerboard":
        options.refuse(arguments, ("dictionary",), "--board checkerboard")
    if not is_board_seen:
        return None
    sizes = arguments.squares, arguments.square_mm, arguments.marker_mm
    return Board.named(arguments.board, *sizes, arguments.dictionary or "DICT_5X5_100")


# As for an alarm: a result, but not a usable one.
OUTSIDE_EXIT_CODE = 3


@options.verb(
    "slipstitch capture check camera.json --model results/instrument/by_simulation/seed0 "
    "--picture check.png",
    parent=capture,
)
@argument("camera", type=options.FILE, metavar="CAMERA.json", help="as of capture camera")
@options.trained_instrument
@option("--picture", type=options.PICTURE, help="PNG or SVG")
def check(arguments: options.Arguments) -> int:
    """Check whether a camera sees the track, from a pose in the training range of an instrument.

    Exit code 3 if the camera cannot be used.
    """
    from slipstitch.base.page.figures import save_figure
    from slipstitch.base.provenance import provenance_record, recorded_path, start_clock
    from slipstitch.film.measure.camera_check import check_camera, check_figure

    started = start_clock()
    found = check_camera(arguments.camera, arguments.model, arguments.config)
    if arguments.picture:
        record = provenance_record("measure", inputs=found.read, started=started)
        with recorded_path(arguments.picture, record) as temporary:
            save_figure(check_figure(found), temporary, arguments.picture.suffix[1:])
    for line in found.lines():
        print(line)
    return OUTSIDE_EXIT_CODE if found.outside else 0


@options.verb(
    "slipstitch capture ingest bench/captures.csv --config results/config.json "
    "--reference bench/reference.csv --out-dir results/captures/dataset",
    parent=capture,
)
@argument(
    "table",
    type=options.FILE,
    metavar="CAPTURES.csv",
    help="columns video, material, substrate, repeat, mu_ref, mu_ref_error, reflective (yes or "
    "no), camera; optional: start_s, frame_rate_hz; paths are relative to its folder",
)
@options.config_files("configuration of the dataset the networks were trained on", one_each=True)
@option("--reference", type=options.FILE, help="as of capture reference, for rows without mu_ref")
@option("--out-dir", required=True, type=options.FOLDER, help="folder for the dataset")
def ingest(arguments: options.Arguments) -> None:
    """Convert videos of a bench to the format of the dataset: synchronised, rectified, cropped."""
    from slipstitch.base.progress import progress
    from slipstitch.film.ingest_videos import ingest as ingest_table

    bar = partial(progress, unit="video")
    config = options.configuration(arguments)
    rows = ingest_table(config, arguments.table, arguments.out_dir, arguments.reference, bar)
    for row in rows:
        how = "found" if row["start_found"] else "stated"
        print(
            f"{row['video']}: {row['material']} on {row['substrate']}, repeat {row['repeat']}; "
            f"the stage starts at {row['start_s']:.3f} s ({how})"
        )
        if row["notes"]:
            print(f"{row['video']}: {row['notes']}", file=sys.stderr)
    pairs = {row["pair"] for row in rows}
    print(f"{arguments.out_dir}: {len(rows)} videos of {len(pairs)} pairs")


@options.verb(
    "slipstitch capture reference bench/slip_angles.csv --out bench/reference.csv "
    "--json bench/reference.json --picture bench/reference.svg",
    parent=capture,
)
@argument(
    "table",
    type=options.FILE,
    metavar="ANGLES.csv",
    help="columns material, substrate, position, orientation, repeat, angle_deg, "
    "bench_error_deg (the largest error of the bench's angle)",
)
@option("--out", required=True, type=options.TABLE, help="CSV, one row per pair")
@option("--json", type=options.JSON, help="JSON with all details")
@option("--picture", type=options.PICTURE, help="PNG or SVG")
def reference(arguments: options.Arguments) -> None:
    """Compute the friction of each fabric and substrate from slip angles on an inclined plane."""
    from slipstitch.film.slip_angles import reference_to_files

    files = arguments.table, arguments.out, arguments.json, arguments.picture
    for pair in reference_to_files(*files):
        print(_pair_line(pair))


def _pair_line(pair) -> str:
    parts = [f"{pair.material} on {pair.substrate}: {pair.mu:.3f} ± {pair.error:.3f}"]
    for kind, means, p in (
        ("positions", pair.by_position, pair.position_p),
        ("orientations", pair.by_orientation, pair.orientation_p),
    ):
        if p is None:
            parts.append(f"{kind}: one only" if len(means) == 1 else f"{kind}: cannot be compared")
        else:
            differ = "differ" if p < 0.05 else "do not differ significantly"
            values = ", ".join(f"{name} {mean:.3f}" for name, (mean, _) in means.items())
            parts.append(f"{len(means)} {kind} {differ} (p = {p:.2g}: {values})")
    return "; ".join(parts)


@options.verb(
    "slipstitch capture surrogate --config results/config.json --film c00_r01 "
    "--out results/captures/bench/c00_r01.mp4",
    parent=capture,
)
@options.config_files()
@option("--bench", type=options.FOLDER, help="folder for the cameras' files and the tables")
@option("--film", metavar="ID", help="instead: simulate and render one video, c00_r01 ...")
@option("--out", type=options.Output(".mp4"), help="with --film: the video (MP4)")
def surrogate(arguments: options.Arguments) -> None:
    """Generate surrogate captures: simulated videos, labelled as surrogates."""
    mode = options.exactly_one(arguments, "bench", "film")
    config = options.configuration(arguments)
    if mode == "bench":
        if arguments.out:
            raise BadInput("--out requires --film")
        from slipstitch.film.surrogates import write_bench

        write_bench(config, arguments.bench)
        print(f"{arguments.bench}: {len(config.captures.surrogate_ids())} surrogate captures")
        return
    from slipstitch.base.progress import progress
    from slipstitch.film.surrogates import find_film, make_film

    if not arguments.out:
        raise BadInput("--film requires --out FILE.mp4")
    film = find_film(config, arguments.film)
    count = make_film(config, film, arguments.out, partial(progress, unit="frame"))
    print(
        f"{arguments.out}: {count} frames, {film.pair.material} on {film.pair.substrate}, "
        f"repeat {film.repeat} (surrogate)"
    )


@options.verb(
    "slipstitch capture trace export.csv --columns time=Zeit,force=Standardkraft --units N "
    "--out cases/linen-on-glass/spring_slider/t00.csv",
    parent=capture,
)
@argument("file", type=options.FILE, help="CSV of one run; lines above the names are left out")
@option(
    "--columns",
    required=True,
    metavar="KIND=NAME,...",
    help="names of the file's columns of time, force (or force_x, force_y) and extension",
)
@option(
    "--units",
    default="",
    metavar="UNIT,...",
    help="of the force (mN ... lbf), and of time and extension where they are not s and mm",
)
@option("--out", required=True, type=options.TABLE, help="CSV of a case")
def trace(arguments: options.Arguments) -> None:
    """Import the export of a testing machine as the trace of a case."""
    from slipstitch.criticise.trace_import import import_trace

    pairs = [part.partition("=") for part in arguments.columns.split(",")]
    columns = {kind.strip(): name.strip() for kind, _, name in pairs}
    if not all(columns.values()) or len(columns) < len(pairs):
        raise BadInput("--columns: must be KIND=NAME,KIND=NAME, each kind once")
    units = tuple(unit for unit in arguments.units.split(",") if unit)
    print(f"{arguments.out}: {import_trace(arguments.file, columns, units, arguments.out)}")
