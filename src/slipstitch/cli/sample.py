"""slipstitch sample: images in, dataset out."""

import argparse
from collections import Counter

from slipstitch.cli.options import add_config, output_folder

SUMMARY = "choose frames of the rendered videos, split them, write the dataset"
EXAMPLE = (
    "slipstitch sample --config results/config.json --out-dir results/sample "
    "results/render/*_v*.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser, one_each=True)
    parser.add_argument(
        "--out-dir", type=output_folder, required=True, help="folder of the dataset"
    )
    parser.add_argument("shards", nargs="+", metavar="SHARD", help="image shards, all of the grid")


def run(arguments: argparse.Namespace) -> None:
    """Write the dataset and say what it holds."""
    from slipstitch.config import load_config
    from slipstitch.sample.dataset import write_dataset

    rows = write_dataset(load_config(*arguments.config), arguments.shards, arguments.out_dir)
    simulations = {row["simulation"] for row in rows}
    print(f"{len(rows)} videos of {len(simulations)} simulations, {rows[0]['frames']} frames each")
    for split in ("split_by_video", "split_by_simulation"):
        sides = Counter(row[split] for row in rows)
        parts = ", ".join(f"{sides[side]} {side}" for side in ("train", "validation", "test"))
        print(f"{split.removeprefix('split_')}: {parts}")
