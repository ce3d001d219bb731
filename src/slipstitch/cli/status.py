"""slipstitch status: the state of a workflow run."""

import argparse

from slipstitch.cli.options import add_config

SUMMARY = "show the state of a run: jobs done, running and failed, cost, time remaining, disk use"
EXAMPLE = "slipstitch status --results results"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--results", default="results", help="results folder (default: results)")
    add_config(
        parser,
        "YAML or JSON configuration (default: config.json in the results folder)",
        required=False,
    )
    parser.add_argument(
        "--lines", type=int, default=12, help="lines of a failed job's log to show (default: 12)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print; return 1 if the last run failed or was interrupted, else 0."""
    from pathlib import Path

    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config
    from slipstitch.report.status.state import status
    from slipstitch.report.status.status_text import text

    folder = Path(arguments.results)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder; give the results folder of the snakemake run")
    if arguments.lines < 0:
        raise BadInput(f"--lines {arguments.lines}: must be at least 0")
    resolved = folder / "config.json"
    files = arguments.config or ([str(resolved)] if resolved.is_file() else [])
    found = status(folder, load_config(*files) if files else None)
    print(text(folder, found, arguments.lines))
    stopped = found.run is not None and found.alive is False and found.run.success is not True
    return 1 if stopped else 0
