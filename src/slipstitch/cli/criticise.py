"""slipstitch criticise: find what the model gets wrong in measured data, and why."""

import argparse
import sys
from pathlib import Path

from slipstitch.cli.options import output_json, output_named, output_page

SUMMARY = "find what the friction model gets wrong in a measured case, and why"
EXAMPLE = "slipstitch criticise cases/linen-on-glass --out verdict.json --report verdict.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "case", metavar="CASE_DIR", help="folder of one case (docs/measurements.md)"
    )
    parser.add_argument(
        "--out", type=output_json, required=True, metavar="FILE", help="verdict as JSON"
    )
    parser.add_argument(
        "--report", type=output_page, metavar="FILE", help="the verdict as an HTML page"
    )
    parser.add_argument(
        "--picture",
        type=output_named(".svg"),
        metavar="FILE",
        help="what is left over, drawn, as SVG",
    )
    parser.add_argument(
        "--model",
        type=output_named(".yaml", ".yml"),
        metavar="FILE",
        help="the extended model as YAML",
    )
    parser.add_argument(
        "--resimulate",
        type=output_json,
        metavar="FILE",
        help="simulate the drop-and-drag runs with the null and the extended law in the cloth "
        "simulator (about a second per run); errors and gain as JSON, and on the page",
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the simulated maxima (default 1)"
    )
    parser.add_argument(
        "--replicates",
        type=int,
        default=300,
        help="simulated data sets for each family-wise p (default 300)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Criticise one case; exit code 0 whatever the verdict."""
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.criticism_files import criticise_to_files
    from slipstitch.errors import BadInput

    if arguments.replicates < 50:
        raise BadInput(f"--replicates: {arguments.replicates}; must be at least 50")
    case = read_case(arguments.case)
    for name in case.ignored_files:
        print(
            f"{Path(arguments.case) / name}: not a table of any protocol, ignored", file=sys.stderr
        )
    line = criticise_to_files(
        case,
        arguments.seed,
        arguments.replicates,
        verdict_path=arguments.out,
        page_path=arguments.report,
        picture_path=arguments.picture,
        model_path=arguments.model,
        resimulation_path=arguments.resimulate,
    )
    print(line)
    return 0
