"""slipstitch criticise: what the model gets wrong in measured data, and why."""

import argparse
import sys
from pathlib import Path

from slipstitch.cli.options import output_file

SUMMARY = "say what the model gets wrong in a measured case, and why"
EXAMPLE = "slipstitch criticise cases/linen-on-glass --out verdict.json --report verdict.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "case", metavar="CASE_DIR", help="folder of one case (docs/measurements.md)"
    )
    parser.add_argument(
        "--out", type=output_file, required=True, metavar="FILE", help="verdict as JSON"
    )
    parser.add_argument(
        "--report", type=output_file, metavar="FILE", help="the verdict as an HTML page"
    )
    parser.add_argument(
        "--model", type=output_file, metavar="FILE", help="the extended model as YAML"
    )
    parser.add_argument(
        "--resimulate",
        type=output_file,
        metavar="FILE",
        help="simulate the drop-and-drag runs again with null and extended law in the cloth "
        "simulator (about a second a run); errors and gain as JSON, and on the page",
    )
    parser.add_argument(
        "--power",
        action="store_true",
        help="say what the design could show, before it is measured: run tables only are read, "
        "and --out has the smallest detectable effect of every mechanism",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the simulated maxima (default 1)")
    parser.add_argument(
        "--replicates",
        type=int,
        default=300,
        help="simulated data sets behind each family-wise p (default 300)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Criticise one case, or what its design could show; exit code 0 whatever the verdict."""
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.criticism_files import criticise_to_files
    from slipstitch.errors import BadInput

    if arguments.replicates < 50:
        raise BadInput(f"--replicates: {arguments.replicates}; at least 50 are needed")
    if arguments.power:
        from slipstitch.criticise.criticism_files import power_to_file

        case = read_case(arguments.case, with_measurements=False)
        print(power_to_file(case, arguments.seed, arguments.replicates, arguments.out))
        return 0
    case = read_case(arguments.case)
    for name in case.ignored_files:
        print(f"{Path(arguments.case) / name}: no table of any protocol, not read", file=sys.stderr)
    line = criticise_to_files(
        case,
        arguments.seed,
        arguments.replicates,
        verdict_path=arguments.out,
        page_path=arguments.report,
        model_path=arguments.model,
        resimulation_path=arguments.resimulate,
    )
    print(line)
    return 0
