"""Verbs as click commands: options shared by several verbs, and checks common to all."""

from collections.abc import Callable
from typing import Any

import click

from slipstitch.cli.checks import Arguments, refuse_overwriting
from slipstitch.cli.parameter_types import DIR, FILE

THREADS_MAX = 1024


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


def verb(summary: str, shown: str, *, parent: click.Group | None = None, **settings: Any):
    """Make a verb of a function that takes `Arguments`; its name is the function's.

    `summary` is the first line of the help text, `shown` its example.
    """

    def decorate(run: Callable[[Arguments], int | None]) -> Verb:
        command = Verb(
            run.__name__,
            callback=lambda **given: run(Arguments(**given)),
            params=list(reversed(getattr(run, "__click_params__", ()))),
            help=summary,
            short_help=summary,
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
    *,
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


def calibration_file():
    """Declare ``--calibration FILE``."""
    return click.option(
        "--calibration", metavar="FILE", help="use the numerical settings of this calibration file"
    )


def thread_count(default: int = 1):
    """Declare ``--threads COUNT``."""
    return click.option(
        "--threads",
        type=click.IntRange(1, THREADS_MAX),
        default=default,
        show_default=True,
        metavar="COUNT",
        help="number of threads",
    )


def trained_instrument(run: Callable):
    """Declare ``--model DIR`` and ``--config FILE`` of a trained instrument."""
    run = click.option(
        "--config",
        type=FILE,
        help="configuration the instrument was trained with (default: config.json in the "
        "nearest folder above the model)",
    )(run)
    return click.option(
        "--model",
        type=DIR,
        help="a trained instrument (default: the one that comes with Slipstitch)",
    )(run)
