"""slipstitch sample: from rendered images to the dataset."""

import argparse
from collections import Counter

from slipstitch.cli.options import add_config, output_folder

SUMMARY = "select frames of the rendered videos, draw the splits, write the dataset"
EXAMPLE = (
    "slipstitch sample --config results/config.json --out-dir results/sample "
    "results/render/*_v*.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser, one_each=True)
    parser.add_argument(
        "--out-dir", type=output_folder, required=True, help="folder for the dataset"
    )
    parser.add_argument("shards", nargs="+", metavar="SHARD", help="all image shards of the grid")


def run(arguments: argparse.Namespace) -> None:
    """Write the dataset; print its content."""
    from slipstitch.config import load_config
    from slipstitch.dataset.dataset import write_dataset

    rows = write_dataset(load_config(*arguments.config), arguments.shards, arguments.out_dir)
    simulations = {row["simulation"] for row in rows}
    print(f"{len(rows)} videos of {len(simulations)} simulations, {rows[0]['frames']} frames each")
    for split in ("split_by_video", "split_by_simulation"):
        sides = Counter(row[split] for row in rows)
        parts = ", ".join(f"{sides[side]} {side}" for side in ("train", "validation", "test"))
        print(f"{split.removeprefix('split_')}: {parts}")
