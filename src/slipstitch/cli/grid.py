"""slipstitch grid: the table of ids and seeds."""

import argparse

from slipstitch.cli.options import add_config, output_parquet

SUMMARY = "write the table of ids and seeds"
EXAMPLE = "slipstitch grid --config results/config.json --out results/grid.parquet"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser)
    parser.add_argument("--out", type=output_parquet, required=True, help="Parquet file")


def run(arguments: argparse.Namespace) -> None:
    """Write the table."""
    from slipstitch.config import load_config
    from slipstitch.design.grid_table import write_grid

    write_grid(load_config(*arguments.config), arguments.out)
