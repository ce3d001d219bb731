"""slipstitch predict: predictions of the null and the extended model for a new case."""

from __future__ import annotations

import argparse

from slipstitch.cli.options import output_table

SUMMARY = "predict a new case with the null and the extended model of a verdict"
EXAMPLE = "slipstitch predict verdict.json cases/linen-next-week --out predictions.csv"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("verdict", metavar="VERDICT", help="JSON written by slipstitch criticise")
    parser.add_argument(
        "case", metavar="CASE_DIR", help="folder of the new case; its measured values are ignored"
    )
    parser.add_argument(
        "--out", type=output_table, required=True, metavar="FILE", help="predictions as CSV"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write one line per run and quantity."""
    from pathlib import Path

    from slipstitch.base.progress import note
    from slipstitch.base.provenance import atomic_path
    from slipstitch.criticise.case import read_case
    from slipstitch.criticise.prediction.predictive import predictions, read_verdict

    verdict = read_verdict(Path(arguments.verdict))
    case = read_case(arguments.case, with_measurements=False)
    note(*case.notes)
    table = predictions(verdict, case)
    with atomic_path(Path(arguments.out)) as temporary:
        table.to_csv(temporary, index=False)
    print(f"{len(table)} predictions written to {arguments.out}")
