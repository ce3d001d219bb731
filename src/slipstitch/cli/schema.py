"""slipstitch schema: the JSON schema of the configuration."""

import argparse

SUMMARY = "print the JSON schema of the configuration"
EXAMPLE = "slipstitch schema > workflow/schemas/config.schema.json"


def configure(parser: argparse.ArgumentParser) -> None:
    """No options."""


def run(arguments: argparse.Namespace) -> None:
    """Print it."""
    from slipstitch.config.schema import schema_text

    print(schema_text(), end="")
