"""slipstitch report: write the report."""

import argparse

from slipstitch.cli.options import add_config, output_page

SUMMARY = "write a self-contained HTML report on a results folder"
EXAMPLE = (
    "slipstitch report --config results/config.json --results results "
    "--out results/report/index.html"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser)
    parser.add_argument("--results", required=True, help="results folder; may be incomplete")
    parser.add_argument("--out", type=output_page, required=True, help="HTML file")


def run(arguments: argparse.Namespace) -> None:
    """Write the page; print its path and the missing stages."""
    from pathlib import Path

    from slipstitch.config import load_config
    from slipstitch.report.page import write_report

    context = write_report(load_config(*arguments.config), arguments.results, arguments.out)
    missing = [
        name
        for name, there in {
            "calibrate": context["physics"],
            "simulate": context["simulations"]["done"],
            "render": context["rendered"],
            "sample": context["dataset"],
            "train": context["networks"],
            "evaluate": context["test_sets"],
            "criticise": context["criticism"],
            "release": context["release"],
        }.items()
        if not there
    ]
    size = Path(arguments.out).stat().st_size / 1e6
    print(
        f"{arguments.out}: {size:.1f} MB" + (f"; not run: {', '.join(missing)}" if missing else "")
    )
