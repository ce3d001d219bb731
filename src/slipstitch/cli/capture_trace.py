"""slipstitch capture trace: a testing machine's export in, a case's trace out."""

import argparse
from pathlib import Path

from slipstitch.cli.options import output_path

SUMMARY = "import the export of a testing machine as the trace of a case"
EXAMPLE = (
    "slipstitch capture trace export.csv --columns time=Zeit,force=Standardkraft --units N "
    "--out cases/linen-on-glass/spring_slider/t00.csv"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="CSV of one run; lines above the names are left out"
    )
    parser.add_argument(
        "--columns",
        required=True,
        metavar="KIND=NAME,...",
        help="names of the file's columns of time, force (or force_x, force_y) and extension",
    )
    parser.add_argument(
        "--units",
        default="",
        metavar="UNIT,...",
        help="of the force (mN, N, kN, cN, gf, kgf, lbf) and, where they are not s and mm, of time "
        "and extension; a row of units in the file must say the same",
    )
    parser.add_argument(
        "--out", required=True, type=output_path(".csv"), metavar="FILE", help="CSV of a case"
    )


def run(arguments: argparse.Namespace) -> None:
    """Import, write, say what was read."""
    from slipstitch.base.errors import BadInput
    from slipstitch.criticise.trace_import import import_trace

    pairs = [part.partition("=") for part in arguments.columns.split(",")]
    columns = {kind.strip(): name.strip() for kind, _, name in pairs}
    if not all(columns.values()) or len(columns) < len(pairs):
        raise BadInput("--columns: must be KIND=NAME,KIND=NAME, each kind once")
    units = tuple(unit for unit in arguments.units.split(",") if unit)
    print(f"{arguments.out}: {import_trace(arguments.file, columns, units, arguments.out)}")
