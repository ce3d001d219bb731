"""slipstitch publish: a run's results as a small folder to keep."""

import argparse

from slipstitch.cli.options import add_config, output_folder

SUMMARY = "copy scores, predictions, curves, costs, the model that ships and provenance of a run"
EXAMPLE = (
    "slipstitch publish --config results/config.json --results results "
    "--out-dir results/published/demo"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser, "YAML or JSON configuration that the results were made with")
    parser.add_argument("--results", default="results", help="folder of the results")
    parser.add_argument(
        "--out-dir",
        type=output_folder,
        required=True,
        help="folder: new, empty, or published before and then replaced entirely",
    )
    parser.add_argument(
        "--partial",
        action="store_true",
        help="publish an unfinished run; the index names what it lacks",
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="keep what the folder has and the results have no longer (images deleted since)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the folder and say what it holds."""
    from slipstitch.config import load_config
    from slipstitch.report.publishing import publish

    config = load_config(*arguments.config)
    index = publish(
        config, arguments.results, arguments.out_dir, arguments.partial, arguments.update
    )
    lacking = f", partial: {len(index['missing'])} lacking" if index["partial"] else ""
    print(f"{arguments.out_dir}: {len(index['files'])} files{lacking}")
