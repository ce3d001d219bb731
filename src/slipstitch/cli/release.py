"""slipstitch release: the dataset as a folder to distribute."""

import argparse

from slipstitch.base.project import project_folder
from slipstitch.cli.options import add_config, output_folder

SUMMARY = "write the dataset as a folder to distribute: shards, splits, card, metadata, records"
EXAMPLE = (
    "slipstitch release --config results/config.json --results results --out-dir results/release"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser, "YAML or JSON configuration of the results")
    parser.add_argument("--results", default="results", help="results folder")
    parser.add_argument(
        "--out-dir",
        type=output_folder,
        required=True,
        help="folder for the release; must not exist yet",
    )
    parser.add_argument(
        "--project",
        default=project_folder(),
        help="folder of the workflow that was run (default: the one of the package)",
    )
    parser.add_argument(
        "--sign", metavar="KEY", help="SSH key for a signature; slipstitch audit --verify checks it"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the release; print its content and digest."""
    from slipstitch.config import load_config
    from slipstitch.dataset.release.assembly import write_release

    done = write_release(
        load_config(*arguments.config),
        arguments.results,
        arguments.out_dir,
        arguments.project,
        arguments.sign,
    )
    print(
        f"{arguments.out_dir}: {done.videos} videos, {done.images} images, {done.files} files, "
        f"{done.size_bytes / 1e6:.1f} MB"
    )
    print(f"SHA-256 of SHA256SUMS, to be published separately: {done.sums_sha256}")
