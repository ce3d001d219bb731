"""slipstitch init: a workflow folder, wherever the package is installed."""

import argparse

from slipstitch.cli.options import output_folder_path

SUMMARY = "create a workflow folder: Snakefile, rules, configurations, cases"
EXAMPLE = "slipstitch init friction && cd friction && snakemake --cores 2 all"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=output_folder_path, metavar="DIR", help="may exist")


def run(arguments: argparse.Namespace) -> None:
    """Copy the workflow's files and say what to do with them."""
    from slipstitch.base.project import lay_out

    lay_out(arguments.folder)
    print(f"{arguments.folder}: config.yaml is the demo; to run it there: snakemake --cores 2 all")
