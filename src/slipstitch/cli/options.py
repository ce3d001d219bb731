"""Verbs as click commands: types of options, options shared by several verbs, checks of all."""

import inspect
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click

from slipstitch.base.errors import BadInput

THREADS_MAX = 1024
Arguments = SimpleNamespace


class Output(click.ParamType):
    """A file to write, by its endings, or a folder: refused before any work if it cannot be."""

    def __init__(self, *endings: str, folder: bool = False, or_stdout: bool = False):
        self.endings, self.folder, self.or_stdout = endings, folder, or_stdout
        self.name = "dir" if folder else "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path."""
        path = Path(value)
        if self.or_stdout and str(value) == "-":
            return path
        problem = _unwritable(path, self.folder)
        if problem is None and self.endings and path.suffix.lower() not in self.endings:
            problem = f"must end in {' or '.join(self.endings)}"
        if problem:
            self.fail(f"{value}: {problem}", param, ctx)
        return path


def _unwritable(path: Path, folder: bool) -> str | None:
    """Why an output path cannot be written; None if it can."""
    if path.exists() and (not path.is_dir() if folder else not path.is_file()):
        found = "file" if folder else "folder" if path.is_dir() else "device or a pipe"
        return f"is a {found}; must be a {'folder' if folder else 'file'}"
    above = next((parent for parent in path.absolute().parents if parent.exists()), path)
    if not above.is_dir():
        return f"{above} is a file, not a folder"
    try:  # permissions alone do not tell of a read-only disk, or of /proc
        with tempfile.TemporaryDirectory(prefix=".", dir=above):
            return None
    except OSError as error:
        return f"cannot be written: {(error.strerror or 'refused').lower()}"


FILE = click.Path(dir_okay=False, path_type=Path)
DIR = click.Path(file_okay=False, path_type=Path)
FOLDER = Output(folder=True)
PAGE = Output(".html", ".htm")
JSON = Output(".json")
TABLE = Output(".csv")
PARQUET = Output(".parquet")
PICTURE = Output(".png", ".svg")


def refuse_overwriting(context: click.Context) -> None:
    """Refuse a file to be written that the command reads, or writes under another option, too."""
    writes = written(context.command)
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


def written(command: click.Command) -> set[str]:
    """Return the names of the options of a command that name a file to write."""
    outs = (one for one in command.params if isinstance(one.type, Output) and not one.type.folder)
    return {one.name for one in outs if one.name}


def _files(value: object) -> dict[Path, str]:
    """The files that an option's value may name -> the words that name them."""
    several = value if isinstance(value, list | tuple) else [value]
    named = (one for one in several if isinstance(one, str | Path) and str(one))
    return {Path(one).resolve(): str(one) for one in named}


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


class Verb(click.Command):
    """A command with options of several values; it never overwrites what it reads."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read ``--config A B`` as ``--config A --config B``, then as click does."""
        several = {name for one in self.params if isinstance(one, Several) for name in one.opts}
        spelled: list[str] = []
        current = None
        for word in args:
            if word.startswith("-") and word != "-":
                current = word if word in several else None
            elif current is not None and spelled[-1] != current:
                spelled.append(current)
            spelled.append(word)
        return super().parse_args(ctx, spelled)

    def invoke(self, ctx: click.Context) -> Any:
        """Refuse to overwrite what is read, then run."""
        refuse_overwriting(ctx)
        return super().invoke(ctx)


def example(words: str) -> str:
    """Return the end of a help text: an example as it stands, which can be copied."""
    return f"\b\nexample:\n  {words}"


def verb(shown: str, *, parent: click.Group | None = None, **settings: Any):
    """Make a verb of a function that takes `Arguments`: its name and help text are the function's.

    `shown` is the example at the end of the help text.
    """

    def decorate(run: Callable[[Arguments], int | None]) -> Verb:
        words = inspect.cleandoc(run.__doc__ or "")
        summary = " ".join(words.partition("\n\n")[0].split()).rstrip(".")
        command = Verb(
            run.__name__,
            callback=lambda **given: run(Arguments(**given)),
            params=list(reversed(getattr(run, "__click_params__", ()))),
            help=words,
            short_help=summary[0].lower() + summary[1:],
            epilog=example(shown),
            context_settings={"max_content_width": 100},
            **settings,
        )
        if parent is not None:
            parent.add_command(command)
        return command

    return decorate


class Several(click.Option):
    """An option that takes several values, ``--config A B``, and may be repeated."""

    def __init__(self, *args: Any, **settings: Any):
        super().__init__(*args, **{**settings, "multiple": True})

    def make_metavar(self, ctx: click.Context) -> str:
        """Return the name of a value and dots."""
        return f"{super().make_metavar(ctx)} ..."


def several(*names: str, **settings: Any):
    """Declare an option that takes several values."""
    return click.option(*names, cls=Several, **settings)


def switch(name: str, help: str):
    """Declare an option without a value."""
    return click.option(name, is_flag=True, help=help)


def config_files(
    help: str = "YAML or JSON configuration; later files override earlier ones key by key",
    required: bool = True,
    one_each: bool = False,
):
    """Declare ``--config FILE ...``: a tuple of the files, empty if optional and not given.

    With `one_each`, for verbs that take other files without an option, ``--config`` takes one, and
    is repeated.
    """
    kind = {"multiple": True} if one_each else {"cls": Several}
    return click.option("--config", required=required, metavar="FILE", help=help, **kind)


def configuration(arguments: Arguments, **more: Any):
    """Read the files of ``--config``; ``more`` as `load_config` takes it."""
    from slipstitch.config import load_config

    return load_config(*arguments.config, **more)


calibration_file = click.option(
    "--calibration", metavar="FILE", help="take this calibration's settings"
)


def thread_count(default: int = 1):
    """Declare ``--threads COUNT``."""
    return click.option(
        "--threads",
        type=click.IntRange(1, THREADS_MAX),
        default=default,
        metavar="COUNT",
        help=f"number of threads (default: {default})",
    )


def trained_instrument(run: Callable):
    """Declare ``--model DIR`` and ``--config FILE`` of a trained instrument."""
    words = "its configuration (default: config.json in the nearest folder above the model)"
    run = click.option("--config", type=FILE, help=words)(run)
    words = "a trained instrument (default: the one that comes with Slipstitch)"
    return click.option("--model", type=DIR, help=words)(run)
