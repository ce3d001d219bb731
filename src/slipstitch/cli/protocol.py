"""slipstitch protocol: one known-answer experiment in the simulator, compared with theory."""

import argparse
import re
import sys

from slipstitch.cli.options import flag, output_json

SUMMARY = "run a known-answer experiment in the simulator and compare it with theory"
EXAMPLE = "slipstitch protocol incline --friction 0.5 --slope-deg 30 --out incline.json"
NAMES = (
    "incline",
    "tilt",
    "flat-drag",
    "strip-drag",
    "strip",
    "landed-strip",
    "cantilever",
    "lateral-buckling",
    "capstan",
)
OPTIONS = (
    "friction",
    "slope_deg",
    "static_kinetic",
    "gravity_length_m",
    "gamma",
    "strain",
    "width_over_length",
    "wrap_deg",
    "vertices",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("name", metavar="NAME", choices=NAMES, help=", ".join(NAMES))
    parser.add_argument(
        "--out",
        type=output_json,
        required=True,
        help="JSON file with measured and theoretical values",
    )
    parser.add_argument("--friction", type=float, help="friction coefficient")
    parser.add_argument("--slope-deg", type=float, help="incline: slope in degrees")
    parser.add_argument(
        "--static-kinetic",
        type=float,
        help="tilt: static coefficient over the kinetic, less 1 (default 0)",
    )
    parser.add_argument(
        "--gravity-length-m",
        type=float,
        help="strip-drag, landed-strip: (B/w)^(1/3), in m (default 0.02)",
    )
    parser.add_argument(
        "--vertices", type=int, help="strip, landed-strip, strip-drag: vertices along it"
    )
    parser.add_argument(
        "--gamma", type=float, help="strip, cantilever: areal density x gravity x length^3 / B"
    )
    parser.add_argument(
        "--strain", type=float, help="strip: displacement of the push, relative to its length"
    )
    parser.add_argument(
        "--width-over-length",
        type=float,
        help="lateral-buckling: width of the strip over its length",
    )
    parser.add_argument("--wrap-deg", type=float, help="capstan: contact angle in degrees")
    parser.add_argument("--time-step", type=float, metavar="S", help="time step in s")


def run(arguments: argparse.Namespace) -> int:
    """Run it, write the result, print it; exit code 1 if it does not meet its demands."""
    import json

    from slipstitch.base.errors import BadInput
    from slipstitch.config.load import resolve_config
    from slipstitch.physics.experiments.registry import run_protocol_to_file

    options = {name: getattr(arguments, name) for name in OPTIONS}
    options = {name: value for name, value in options.items() if value is not None}
    if arguments.slope_deg is not None and not arguments.slope_deg < 90:
        raise BadInput(f"--slope-deg {arguments.slope_deg:g}: must be below 90")
    given = {"time_step_s": arguments.time_step}
    if arguments.name == "strip-drag":  # as many as along a side of the simulated cloth
        given["vertices_per_side"] = options.pop("vertices", None)
    overrides = {key: value for key, value in given.items() if value is not None}
    settings = resolve_config({"simulation": overrides}, sources=("command line",)).simulation
    try:
        result = run_protocol_to_file(arguments.name, options, settings, arguments.out)
    except BadInput as error:
        raise BadInput(_with_flags(str(error))) from None
    # Curves and histories are in the file only.
    numbers = {key: value for key, value in result.items() if not isinstance(value, list)}
    print(json.dumps(numbers, indent=1))
    for key, demand in result["demands"].items():
        print(_line(key, demand), file=sys.stderr)
    return 0 if result["passed"] else 1


def _with_flags(message: str) -> str:
    """A message with the options called as on the command line."""
    return re.sub(rf"\b({'|'.join(OPTIONS)})\b", lambda m: flag(m[0]), message)


def _line(key: str, demand: dict) -> str:
    shown = "passed" if demand["met"] else "FAILED"
    if demand["error"] is None:
        return f"{shown}: {key} is not theory's"
    scale, unit = (100.0, " %") if demand["relative"] else (1.0, "")
    off, allowed = scale * demand["error"], scale * demand["allowed"]
    difference = f"differs from theory by {off:.2g}{unit}, allowed {allowed:g}{unit}"
    return f"{shown}: {key} {difference}"
