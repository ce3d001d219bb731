"""slipstitch capture: what is measured on a real bench; each kind is a word after the verb."""

import argparse
import importlib

SUMMARY = "process measurements from a real bench: camera, videos, reference friction"
EXAMPLE = (
    "slipstitch capture camera --squares 10x7 --square-mm 20 --stage-view floor.png "
    "--place-mm 50 -60 --out camera.json --picture camera.png board/*.png"
)


KINDS = ("camera", "check", "ingest", "reference", "surrogate", "trace")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare what can be captured, each with its own options."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name in KINDS:
        module = _module(name)
        verb = kinds.add_parser(
            name,
            help=module.SUMMARY,
            description=module.SUMMARY,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.configure(verb)


def run(arguments: argparse.Namespace) -> int | None:
    """Run the one that was asked for; its exit code."""
    return _module(arguments.kind).run(arguments)


def _module(kind: str):
    return importlib.import_module(f"slipstitch.cli.capture_{kind}")
