"""slipstitch evaluate: metrics and predictions of the trained networks."""

import argparse

from slipstitch.cli.options import (
    add_config,
    add_threads,
    check_at_least,
    output_json,
    output_page,
    output_parquet,
    refuse,
)

SUMMARY = "evaluate the trained networks: metrics, confusion, predictions"
EXAMPLE = (
    "slipstitch evaluate --config results/config.json --dataset results/sample "
    "--models results/train --out results/evaluate/metrics.json "
    "--predictions results/evaluate/predictions.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser)
    parser.add_argument("--dataset", required=True, help="folder written by `slipstitch sample`")
    parser.add_argument("--models", help="folder {split}/{network}/seed{seed}/")
    parser.add_argument("--instruments", help="folder {split}/seed{seed}/ of instruments")
    parser.add_argument("--out", type=output_json, required=True, help="metrics.json")
    parser.add_argument(
        "--predictions", type=output_parquet, required=True, help="predictions.parquet"
    )
    parser.add_argument(
        "--details",
        type=output_json,
        help="chance level, seeds, viewpoints, confusion (default: details.json beside --out)",
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="keep the scores of models that are unchanged since --out was written",
    )
    add_threads(parser)
    captures = parser.add_argument_group("evaluation on captures, real or surrogate")
    captures.add_argument(
        "--captures",
        action="store_true",
        help="the dataset was written by `slipstitch capture ingest`",
    )
    captures.add_argument("--page", type=output_page, help="tables and plots (HTML)")


def run(arguments: argparse.Namespace) -> None:
    """Evaluate, write, print the table."""
    from pathlib import Path

    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config
    from slipstitch.learning.evaluation.evaluation import Outputs, write_evaluation
    from slipstitch.learning.evaluation.text_table import test_set_lines
    from slipstitch.learning.evaluation.trained import Trained

    check_at_least(arguments, threads=1)
    config = load_config(*arguments.config)
    if not (arguments.models or arguments.instruments):
        raise BadInput("--models, --instruments or both are required")
    trained = Trained(
        arguments.models, arguments.instruments, config.train, config.instrument.seeds
    )
    if arguments.captures:
        _captures(config, arguments, trained)
        return
    if arguments.page:
        raise BadInput("--page requires --captures")
    metrics = write_evaluation(
        config.evaluate,
        arguments.dataset,
        trained,
        Outputs(
            arguments.out,
            arguments.predictions,
            arguments.details or Path(arguments.out).with_name("details.json"),
        ),
        calibrated=config.calibrated_view,
        update=arguments.update,
        threads=arguments.threads,
    )
    print(*test_set_lines(metrics), sep="\n")


def _captures(config, arguments: argparse.Namespace, trained) -> None:
    """Evaluate on captures; print one line per model and subset."""
    from slipstitch.film.captures.evaluation import write_captures_evaluation
    from slipstitch.learning.evaluation.text_table import capture_lines

    refuse(arguments, ("details", "update"), "--captures")
    metrics = write_captures_evaluation(
        config.evaluate,
        arguments.dataset,
        trained,
        arguments.out,
        arguments.predictions,
        arguments.page,
        threads=arguments.threads,
    )
    print(*capture_lines(metrics), sep="\n")
