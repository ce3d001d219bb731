"""Friction with its error bar from videos of one pair, or of all pairs of a table."""

import math
from pathlib import Path

from click import argument, option

from slipstitch.base.errors import BadInput
from slipstitch.cli import options

# A program must not mistake a result with an alarm for a measurement.
ALARM_EXIT_CODE = 3
BAD_INPUT_EXIT_CODE = 2


@options.verb("slipstitch measure bench/glass_1.mp4 --camera bench/camera.json --out glass_1.html")
@argument("videos", nargs=-1, type=options.FILE, metavar="[VIDEO...]", help="repeats of one pair")
@option("--captures", type=options.FILE, help="table of videos, pairs and what is told of each")
@options.switch("--example", "measure the video that comes with Slipstitch, a simulated one")
@option("--camera", type=options.FILE, help="file that slipstitch capture camera wrote")
@options.trained_instrument
@option("--out", type=options.PAGE, help="write the result as an HTML page")
@option("--json", type=options.JSON, help="write all numbers as JSON")
@option("--csv", type=options.TABLE, help="write a table, one row per video")
@option("--start-s", type=float, help="start of the stage's motion (default: found in the frames)")
@option("--frame-rate-hz", type=float, help="frame rate, if the file's timestamps are wrong")
@option("--clamp-height-mm", type=float, help="measured height of the lowered clamps: corrects µ")
@option("--clamp-height-error-mm", type=float, help="its standard deviation (default: 0.2)")
@option("--areal-density-g-m2", type=float, help="weighed: the alarm says if it was never tested")
@option("--bending-length-mm", type=float, help="by Peirce's cantilever (ISO 9073-7): likewise")
@options.switch("--force", "measure, with an alarm, also outside the range of camera poses")
@options.thread_count(default=2)
def measure(arguments: options.Arguments) -> int:
    """Measure the friction coefficient in a video, with an error bar, the fabric and an alarm.

    Exit code 3 if a video raised the alarm, 2 if one of several could not be measured.
    """
    from slipstitch.base.provenance import start_clock
    from slipstitch.film.measure import known_of_example
    from slipstitch.film.measure.pages import write_measurements

    _check(arguments)
    started = start_clock()
    result, read = (_captures if arguments.captures else _videos)(arguments)
    # Before the files: should one of them fail, the result is not lost.
    for line in result.lines():
        print(line)
    if arguments.example:
        print(known_of_example())
    files = {"page_path": arguments.out, "numbers_path": arguments.json}
    write_measurements(result, read, started, **files, table_path=arguments.csv)
    if result.refused:
        return BAD_INPUT_EXIT_CODE
    return ALARM_EXIT_CODE if any(video.alarm_reason for video in result.videos) else 0


def _bench(arguments: options.Arguments, camera):
    """The bench behind a camera."""
    from slipstitch.film.measure.measuring_bench import measuring_bench

    how = {"threads": arguments.threads, "force": arguments.force}
    return measuring_bench(camera, arguments.model, arguments.config, **how)


def _videos(arguments: options.Arguments):
    """Measure videos of one pair, and return what was read."""
    from slipstitch.film.captures_table import TOLD
    from slipstitch.film.measure import EXAMPLE_CAMERA, EXAMPLE_VIDEO
    from slipstitch.film.measure.measurements import Film, measured_repeats

    videos, camera = list(arguments.videos), arguments.camera
    if arguments.example:
        videos, camera = [EXAMPLE_VIDEO], EXAMPLE_CAMERA
    told = {name: getattr(arguments, name) for name in TOLD}
    bench = _bench(arguments, camera).told(**told)
    clock = {"start_s": arguments.start_s, "frame_rate_hz": arguments.frame_rate_hz}
    pair = measured_repeats([Film(video, bench, **clock) for video in videos])
    return pair, [*videos, camera, bench.config_path]


def _captures(arguments: options.Arguments):
    """Measure the videos of a captures table, and return what was read."""
    from functools import partial

    from slipstitch.base.progress import progress
    from slipstitch.film.measure.measurements import measured_captures

    bar = partial(progress, unit="pair")
    return measured_captures(arguments.captures, partial(_bench, arguments), bar)


def _check_captures(arguments: options.Arguments) -> None:
    """Refuse what the table's rows say themselves, and to write over a file that they name."""
    from slipstitch.film.captures_table import TOLD, files_named

    if arguments.videos:
        raise BadInput("--captures has its own videos: give none with it")
    of_rows = ("example", "camera", "start_s", "frame_rate_hz", *TOLD)
    options.refuse(arguments, of_rows, "--captures")
    named = {Path(file).resolve() for file in files_named(arguments.captures)}
    for name in sorted(options.written(measure)):
        file = getattr(arguments, name)
        if file is not None and Path(file).resolve() in named:
            raise BadInput(f"{options.flag(name)} {file}: {arguments.captures} names this file")


def _check(arguments: options.Arguments) -> None:
    if arguments.captures:
        _check_captures(arguments)
    elif arguments.example:
        if arguments.videos or arguments.camera:
            raise BadInput("--example has its own video and camera: give neither with it")
    elif not arguments.videos:
        raise BadInput("no video: give one, --captures or --example")
    elif not arguments.camera:
        raise BadInput("--camera FILE is required: `slipstitch capture camera` writes one")
    for name, lowest in (("start_s", 0.0), ("frame_rate_hz", 1e-6)):
        value = getattr(arguments, name)
        if value is not None and not (math.isfinite(value) and value >= lowest):
            least = "at least 0" if lowest == 0 else "greater than 0"
            raise BadInput(f"{options.flag(name)} {value:g}: must be {least}")
    if arguments.start_s is not None and len(arguments.videos) > 1:
        raise BadInput("--start-s cannot be combined with several videos")
