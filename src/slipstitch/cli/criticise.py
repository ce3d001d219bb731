"""slipstitch criticise: what the model gets wrong in measured data, and why."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

SUMMARY = "say what the model gets wrong in a measured case, and why"
EXAMPLE = "slipstitch criticise cases/linen-on-glass --out verdict.json --report verdict.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument(
        "case", metavar="CASE_DIR", help="folder of one case (docs/measurements.md)"
    )
    parser.add_argument("--out", required=True, metavar="FILE", help="verdict as JSON")
    parser.add_argument("--report", metavar="FILE", help="the verdict as an HTML page")
    parser.add_argument("--model", metavar="FILE", help="the extended model as YAML")
    parser.add_argument(
        "--resimulate",
        metavar="FILE",
        help="simulate the drop-and-drag runs again with null and extended law in the cloth "
        "simulator (about a second a run); errors and gain as JSON, and on the page",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the simulated maxima (default 1)")
    parser.add_argument(
        "--replicates",
        type=int,
        default=300,
        help="simulated data sets behind each family-wise p (default 300)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Criticise one case; exit code 0 whatever the verdict."""
    from slipstitch import __version__
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.inference.analysis import analyse
    from slipstitch.criticise.measurements import assemble
    from slipstitch.criticise.verdict import sentence, verdict_of
    from slipstitch.errors import BadInput
    from slipstitch.provenance import atomic_path

    if arguments.replicates < 50:
        raise BadInput(f"--replicates: {arguments.replicates}; at least 50 are needed")
    case = read_case(arguments.case)
    for name in case.ignored_files:
        print(f"{Path(arguments.case) / name}: no table of any protocol, not read", file=sys.stderr)
    analysis = analyse(assemble(case), arguments.seed, arguments.replicates)
    verdict = verdict_of(case, analysis, arguments.seed, __version__)
    with atomic_path(Path(arguments.out)) as temporary:
        temporary.write_text(json.dumps(verdict, indent=1) + "\n", encoding="utf-8")
    again = None
    if arguments.resimulate:
        from slipstitch.criticise.resimulation import resimulate

        summary = {"case": case.name, "reason": "no drop-and-drag runs to simulate again"}
        if "drop_drag" in case.protocols:
            again = resimulate(case, verdict)
            summary = again.summary
        with atomic_path(Path(arguments.resimulate)) as temporary:
            temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if arguments.report:
        from slipstitch.criticise.report import page

        with atomic_path(Path(arguments.report)) as temporary:
            temporary.write_text(page(verdict, analysis, again), encoding="utf-8")
    if arguments.model:
        from slipstitch.criticise.extended_model import write_extended_model

        write_extended_model(verdict, Path(arguments.model))
    print(sentence(verdict))
    return 0
