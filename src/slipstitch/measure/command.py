"""slipstitch measure: a video in, friction with its error bar out."""

import argparse
from pathlib import Path

SUMMARY = "read the friction coefficient off a video, with its error bar, the fabric and an alarm"
EXAMPLE = (
    "slipstitch measure bench/glass_1.mp4 --camera bench/camera.json "
    "--model results/instrument/by_simulation/seed0 --out glass_1.html"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("video", type=Path, metavar="VIDEO", help="the whole protocol, filmed")
    parser.add_argument(
        "--camera",
        required=True,
        type=Path,
        metavar="FILE",
        help="camera file of slipstitch capture camera, with the camera's place at the stage",
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
    parser.add_argument("--out", type=Path, metavar="FILE", help="page (HTML) to write")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all numbers, to write")
    parser.add_argument(
        "--start-s",
        type=float,
        metavar="S",
        help="time in the video at which the stage starts (default: found in the frames)",
    )
    parser.add_argument(
        "--frame-rate-hz",
        type=float,
        metavar="HZ",
        help="of the camera, if the file's own times are wrong",
    )
    parser.add_argument("--threads", type=int, default=2, help="threads of the computation")


def run(arguments: argparse.Namespace) -> None:
    """Measure, write the page, print the result."""
    import json
    import math

    from slipstitch.errors import BadInput
    from slipstitch.measure.measuring import measure_video
    from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar

    started = start_clock()
    if arguments.threads < 1:
        raise BadInput("--threads must be at least 1")
    for name, lowest in (("start_s", 0.0), ("frame_rate_hz", 1e-6)):
        value = getattr(arguments, name)
        if value is not None and not (math.isfinite(value) and value >= lowest):
            raise BadInput(f"--{name.replace('_', '-')}: {value:g}; must be greater than 0")
    result = measure_video(
        arguments.video,
        arguments.camera,
        arguments.model,
        arguments.config,
        start_s=arguments.start_s,
        frame_rate_hz=arguments.frame_rate_hz,
        threads=arguments.threads,
    )
    record = None
    if arguments.out or arguments.json:
        inputs = [arguments.video, arguments.camera, result.config_path]
        record = provenance_record("measure", inputs=inputs, started=started)
        record["instrument"] = result.instrument
    if arguments.out:
        from slipstitch.measure.measurement_page import page

        with atomic_path(arguments.out) as temporary:
            temporary.write_text(page(result), encoding="utf-8")
        write_sidecar(arguments.out, record)
    if arguments.json:
        with atomic_path(arguments.json) as temporary:
            text = json.dumps(result.numbers(), indent=1, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")
        write_sidecar(arguments.json, record)
    for line in result.lines():
        print(line)
