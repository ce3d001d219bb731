"""slipstitch capture reference: slip angles in, friction with its error out."""

import argparse
from pathlib import Path

SUMMARY = "friction of each fabric and substrate from slip angles on an inclined plane"
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
    parser.add_argument("--out", required=True, type=Path, metavar="FILE", help="CSV, a row a pair")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the same with all details")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="PNG or SVG")


def run(arguments: argparse.Namespace) -> None:
    """Estimate, write, print one line a pair."""
    import csv
    import json
    from dataclasses import asdict

    from slipstitch.capture.reference.angles import read_angles
    from slipstitch.capture.reference.estimate import estimate
    from slipstitch.errors import BadInput
    from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar

    started = start_clock()
    if arguments.picture and arguments.picture.suffix not in (".png", ".svg"):
        raise BadInput(f"{arguments.picture}: a picture's name must end in .png or .svg")
    table = read_angles(arguments.table)
    found = [(angles, estimate(angles)) for angles in table]
    record = provenance_record("capture", inputs=[arguments.table], started=started)
    columns = ("material", "substrate", "mu", "error", "standard_error", "position_sd",
               "bench_error", "positions", "orientations", "measurements", "position_p",
               "orientation_p")  # fmt: skip
    with atomic_path(arguments.out) as temporary, open(temporary, "w", newline="") as stream:
        writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        for _, one in found:
            counts = {
                "positions": len(one.by_position),
                "orientations": len(one.by_orientation),
            }
            values = asdict(one) | counts
            writer.writerow({key: _shown(values[key]) for key in columns})
    write_sidecar(arguments.out, record)
    if arguments.json:
        with atomic_path(arguments.json) as temporary:
            text = json.dumps([asdict(one) for _, one in found], indent=1, allow_nan=False)
            temporary.write_text(text + "\n", encoding="utf-8")
        write_sidecar(arguments.json, record)
    if arguments.picture:
        from slipstitch.capture.reference.angles_figure import draw_references

        with atomic_path(arguments.picture) as temporary:
            draw_references(found, temporary, arguments.picture.suffix[1:])
        write_sidecar(arguments.picture, record)
    for _, one in found:
        print(_line(one))


def _shown(value):
    return f"{value:.6g}" if isinstance(value, float) else value


def _line(one) -> str:
    parts = [f"{one.material} on {one.substrate}: {one.mu:.3f} ± {one.error:.3f}"]
    for kind, means, p in (
        ("positions", one.by_position, one.position_p),
        ("orientations", one.by_orientation, one.orientation_p),
    ):
        if p is None:
            parts.append(f"{kind}: one only" if len(means) == 1 else f"{kind}: not comparable")
        else:
            differ = "differ" if p < 0.05 else "do not differ"
            values = ", ".join(f"{name} {mean:.3f}" for name, (mean, _) in means.items())
            parts.append(f"{len(means)} {kind} {differ} (p = {p:.2g}: {values})")
    return "; ".join(parts)
