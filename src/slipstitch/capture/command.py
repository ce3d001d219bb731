"""slipstitch capture: what is measured on a real bench; each kind is a word after the verb."""

import argparse
import importlib
from pathlib import Path

SUMMARY = "bring in what is measured on a real bench: camera, films, reference friction"
EXAMPLE = (
    "slipstitch capture camera --squares 10x7 --square-mm 20 --stage-view floor.png "
    "--place-mm 50 -60 --out camera.json --picture camera.png board/*.png"
)


def _kinds() -> list[str]:
    return sorted(path.parent.name for path in Path(__file__).parent.glob("*/command.py"))


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare what can be captured, each with its own options."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name in _kinds():
        module = importlib.import_module(f"slipstitch.capture.{name}.command")
        one = kinds.add_parser(
            name,
            help=module.SUMMARY,
            description=module.SUMMARY,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(one)


def run(arguments: argparse.Namespace) -> None:
    """Run the one that was asked for."""
    importlib.import_module(f"slipstitch.capture.{arguments.kind}.command").run(arguments)
