"""The dataset: from rendered images to a release."""

from collections import Counter

from click import argument, option

from slipstitch.base.project import project_folder
from slipstitch.cli.options import Arguments, config_files, configuration, verb
from slipstitch.cli.parameter_types import FOLDER


@verb(
    "select frames of the rendered videos, draw the splits, write the dataset",
    "slipstitch sample --config results/config.json --out-dir results/sample "
    "results/render/*_v*.parquet",
)
@config_files(one_each=True)
@option("--out-dir", type=FOLDER, required=True, help="folder for the dataset")
@argument(
    "shards", nargs=-1, required=True, metavar="SHARD...", help="all image shards of the grid"
)
def sample(arguments: Arguments) -> None:
    """Write the dataset; print its content."""
    from slipstitch.dataset.dataset import write_dataset

    rows = write_dataset(configuration(arguments), arguments.shards, arguments.out_dir)
    simulations = {row["simulation"] for row in rows}
    print(f"{len(rows)} videos of {len(simulations)} simulations, {rows[0]['frames']} frames each")
    for split in ("split_by_video", "split_by_simulation"):
        sides = Counter(row[split] for row in rows)
        parts = ", ".join(f"{sides[side]} {side}" for side in ("train", "validation", "test"))
        print(f"{split.removeprefix('split_')}: {parts}")


@verb(
    "write the dataset as a folder to distribute: shards, splits, card, metadata, records",
    "slipstitch release --config results/config.json --results results --out-dir results/release",
)
@config_files("YAML or JSON configuration of the results")
@option("--results", default="results", show_default=True, help="results folder")
@option("--out-dir", type=FOLDER, required=True, help="folder for the release; must not exist yet")
@option(
    "--project",
    default=project_folder,
    help="folder of the workflow that was run (default: the one of the package)",
)
@option(
    "--sign", metavar="KEY", help="SSH key for a signature; slipstitch audit --verify checks it"
)
def release(arguments: Arguments) -> None:
    """Write the release; print its content and digest."""
    from slipstitch.dataset.release.assembly import write_release

    done = write_release(
        configuration(arguments),
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
