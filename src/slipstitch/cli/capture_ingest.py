"""slipstitch capture ingest: videos of a bench in, dataset out."""

import argparse
import sys
from functools import partial
from pathlib import Path

from slipstitch.cli.options import add_config, output_folder_path

SUMMARY = "convert videos of a bench to the format of the dataset: synchronised, rectified, cropped"
EXAMPLE = (
    "slipstitch capture ingest bench/captures.csv --config results/config.json "
    "--reference bench/reference.csv --out-dir results/captures/dataset"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "table",
        type=Path,
        metavar="CAPTURES.csv",
        help="columns video, material, substrate, repeat, mu_ref, mu_ref_error, reflective (yes or "
        "no), camera; optional: start_s, frame_rate_hz; paths are relative to its folder",
    )
    add_config(parser, "configuration of the dataset the networks were trained on", one_each=True)
    parser.add_argument(
        "--reference",
        type=Path,
        metavar="FILE",
        help="file written by slipstitch capture reference, for rows with an empty mu_ref",
    )
    parser.add_argument(
        "--out-dir", required=True, type=output_folder_path, help="folder for the dataset"
    )


def run(arguments: argparse.Namespace) -> None:
    """Ingest all videos of the table; say of each where it starts."""
    from slipstitch.base.progress import progress
    from slipstitch.config import load_config
    from slipstitch.film.ingest_videos import ingest

    bar = partial(progress, unit="video")
    config = load_config(*arguments.config)
    rows = ingest(config, arguments.table, arguments.out_dir, arguments.reference, bar)
    for row in rows:
        how = "found" if row["start_found"] else "stated"
        print(
            f"{row['video']}: {row['material']} on {row['substrate']}, repeat {row['repeat']}; "
            f"the stage starts at {row['start_s']:.3f} s ({how})"
        )
        if row["notes"]:
            print(f"{row['video']}: {row['notes']}", file=sys.stderr)
    pairs = {row["pair"] for row in rows}
    print(f"{arguments.out_dir}: {len(rows)} videos of {len(pairs)} pairs")
