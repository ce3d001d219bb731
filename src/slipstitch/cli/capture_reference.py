"""slipstitch capture reference: slip angles in, friction with its error out."""

import argparse
from pathlib import Path

from slipstitch.cli.options import output_path

SUMMARY = "compute the friction of each fabric and substrate from slip angles on an inclined plane"
EXAMPLE = (
    "slipstitch capture reference bench/slip_angles.csv --out bench/reference.csv "
    "--json bench/reference.json --picture bench/reference.svg"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "table",
        type=Path,
        metavar="ANGLES.csv",
        help="columns material, substrate, position, orientation, repeat, angle_deg, "
        "bench_error_deg (the largest error of the bench's angle)",
    )
    parser.add_argument(
        "--out",
        required=True,
        type=output_path(".csv"),
        metavar="FILE",
        help="CSV, one row per pair",
    )
    parser.add_argument(
        "--json", type=output_path(".json"), metavar="FILE", help="JSON with all details"
    )
    parser.add_argument(
        "--picture", type=output_path(".png", ".svg"), metavar="FILE", help="PNG or SVG"
    )


def run(arguments: argparse.Namespace) -> None:
    """Estimate, write, print one line per pair."""
    from slipstitch.film.reference.reference_files import reference_to_files

    for pair in reference_to_files(
        arguments.table, arguments.out, arguments.json, arguments.picture
    ):
        print(_line(pair))


def _line(pair) -> str:
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
