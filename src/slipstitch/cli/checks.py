"""Checks of what was given: files that are read and written, options that exclude each other."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace

import click

from slipstitch.base.errors import BadInput
from slipstitch.cli.parameter_types import Output

Arguments = SimpleNamespace


def refuse_overwriting(context: click.Context) -> None:
    """Refuse a file to be written that the command reads, or writes under another option, too."""
    writes = {
        one.name
        for one in context.command.params
        if isinstance(one.type, Output) and not one.type.folder
    }
    outputs: dict[Path, tuple[str, str]] = {}
    for name in sorted(writes):
        for file, text in _files(context.params.get(name)).items():
            if file in outputs:
                raise BadInput(f"{flag(name)} {text}: is the file of {outputs[file][0]}, too")
            outputs[file] = flag(name), text
    for name in sorted(set(context.params) - writes):
        for file in _files(context.params[name]):
            if file in outputs:
                raise BadInput(f"{' '.join(outputs[file])}: the command reads this file")


def _files(value: object) -> dict[Path, str]:
    """The files that an option's value may name -> the words that name them."""
    several = value if isinstance(value, list | tuple) else [value]
    return {
        Path(one).resolve(): str(one) for one in several if isinstance(one, str | Path) and str(one)
    }


def refuse(arguments: Arguments, names: Iterable[str], mode: str) -> None:
    """Refuse options, by their names in `arguments`, that were given and `mode` would ignore."""
    for name in names:
        if given(arguments, name):
            raise BadInput(f"{flag(name)} cannot be combined with {mode}")


def require(arguments: Arguments, names: Iterable[str], mode: str) -> None:
    """Refuse `mode` without all of these options, by their names in `arguments`."""
    for name in names:
        if not given(arguments, name):
            raise BadInput(f"{mode} requires {flag(name)}")


def exactly_one(arguments: Arguments, *names: str) -> str:
    """Return the name of the one of these options that was given; refuse none or several."""
    found = [name for name in names if given(arguments, name)]
    if len(found) > 1:
        raise BadInput(f"{flag(found[1])} cannot be combined with {flag(found[0])}")
    if not found:
        raise BadInput(f"one of {', '.join(map(flag, names))} is required")
    return found[0]


def given(arguments: Arguments, name: str) -> bool:
    """Return whether an option was given."""
    value = getattr(arguments, name)
    return value is not None and value is not False and value != ()


def flag(name: str) -> str:
    """An option as on the command line; the shards have none."""
    return "image shards" if name == "shards" else f"--{name.replace('_', '-')}"
