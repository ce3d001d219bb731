"""Options that several verbs have, declared once. Standard library only."""

import argparse


def add_config(
    parser: argparse.ArgumentParser, description: str = "YAML or JSON configuration"
) -> None:
    """``--config FILE``, once or more: ``arguments.config`` lists the files."""
    parser.add_argument(
        "--config",
        required=True,
        action="append",
        metavar="FILE",
        help=description,
    )


def add_threads(parser: argparse._ActionsContainer) -> None:
    """``--threads COUNT``, 1 by default; `parser` may be a group."""
    parser.add_argument("--threads", type=int, default=1, help="threads of the computation")
