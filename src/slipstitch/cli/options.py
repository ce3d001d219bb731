"""Options shared by several verbs, and checks common to all."""

import argparse
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from slipstitch.base.errors import BadInput

THREADS_MAX = 1024


def _refuse_target(text: str, folder: bool) -> None:
    """Refuse an output path that cannot be written, before any work is done."""
    path = Path(text)
    if folder and path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: is a file; must be a folder")
    if not folder and path.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: is a folder; must be a file")
    if not folder and path.exists() and not path.is_file():
        raise argparse.ArgumentTypeError(f"{text}: is a device or a pipe; must be a file")
    above = next((parent for parent in path.absolute().parents if parent.exists()), path)
    if not above.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: {above} is a file, not a folder")
    try:  # permissions alone do not tell of a read-only disk, or of /proc
        with tempfile.TemporaryDirectory(prefix=".", dir=above):
            pass
    except OSError as error:
        reason = (error.strerror or "refused").lower()
        raise argparse.ArgumentTypeError(f"{text}: cannot be written: {reason}") from None


def refuse_overwriting(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Refuse a file to be written that the command reads, or writes under another option, too."""
    writes = {action.dest for action in _actions(parser) if hasattr(action.type, "writes")}
    outputs: dict[Path, tuple[str, str]] = {}
    for name in sorted(writes & set(vars(arguments))):
        for file, text in _files(getattr(arguments, name)).items():
            if file in outputs:
                raise BadInput(f"{flag(name)} {text}: is the file of {outputs[file][0]}, too")
            outputs[file] = flag(name), text
    for name in sorted(set(vars(arguments)) - writes):
        for file in _files(getattr(arguments, name)):
            if file in outputs:
                raise BadInput(f"{' '.join(outputs[file])}: the command reads this file")


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)


def _files(value: object) -> dict[Path, str]:
    """The files that an option's value may name -> the words that name them."""
    several = value if isinstance(value, list | tuple) else [value]
    return {
        Path(one).resolve(): str(one) for one in several if isinstance(one, str | Path) and str(one)
    }


def output_named(*endings: str) -> Callable[[str], str]:
    """The type of an option that names a file to write, of a format: other endings are refused."""

    def check(text: str) -> str:
        _refuse_target(text, folder=False)
        if Path(text).suffix.lower() not in endings:
            raise argparse.ArgumentTypeError(f"{text}: must end in {' or '.join(endings)}")
        return text

    return writing(check)


def writing(check: Callable) -> Callable:
    """An option's type, marked as one of files to be written."""
    check.writes = True  # type: ignore[attr-defined]
    return check


output_page = output_named(".html", ".htm")
output_json = output_named(".json")
output_table = output_named(".csv")
output_parquet = output_named(".parquet")
output_picture = output_named(".png", ".svg")


def output_path(*endings: str) -> Callable[[str], Path]:
    """As `output_named`, as a path."""
    check = output_named(*endings)
    return writing(lambda text: Path(check(text)))


def output_folder(text: str) -> str:
    """The type of an option that names a folder to write."""
    _refuse_target(text, folder=True)
    return text


def output_folder_path(text: str) -> Path:
    """The type of an option that names a folder to write, as a path."""
    return Path(output_folder(text))


def add_config(
    parser: argparse.ArgumentParser,
    description: str = "YAML or JSON configuration; later files override earlier ones key by key",
    *,
    required: bool = True,
    one_each: bool = False,
) -> None:
    """``--config FILE ...``: ``arguments.config`` lists the files, empty if optional and not given.

    Parameters
    ----------
    one_each : bool
        For verbs that take other files without an option: ``--config`` takes one, and is repeated.
    """
    several = {"action": "append"} if one_each else {"action": "extend", "nargs": "+"}
    parser.add_argument(
        "--config", required=required, default=[], metavar="FILE", help=description, **several
    )


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """``--calibration FILE``."""
    parser.add_argument("--calibration", help="use the numerical settings of this calibration file")


def _thread_count(text: str) -> int:
    """A whole number that the libraries underneath can take."""
    if not re.fullmatch(r"[+-]?\d+", text):
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number")
    if len(text) > 9 or int(text) > THREADS_MAX:
        raise argparse.ArgumentTypeError(f"{text}: must be at most {THREADS_MAX}")
    return int(text)


def add_threads(parser: argparse._ActionsContainer, default: int = 1) -> None:
    """``--threads COUNT``; `parser` may be a group."""
    parser.add_argument(
        "--threads",
        type=_thread_count,
        default=default,
        metavar="COUNT",
        help="number of threads (default: %(default)s)",
    )


def add_instrument(parser: argparse.ArgumentParser) -> None:
    """``--model DIR`` and ``--config FILE`` of a trained instrument."""
    parser.add_argument(
        "--model",
        type=Path,
        metavar="DIR",
        help="a trained instrument (default: the one that comes with Slipstitch)",
    )
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="configuration the instrument was trained with (default: config.json in the "
        "nearest folder above the model)",
    )


def add_training(
    parser: argparse.ArgumentParser, out: str, seed: argparse._ActionsContainer | None = None
) -> None:
    """Dataset, split, seed and folder of one training.

    Parameters
    ----------
    seed : group of `parser`, optional
        Gets ``--seed``, of which that group says whether it is required. What else a training
        requires is then optional too.
    """
    from slipstitch.config.train import TRAINED_ON

    alone = seed is None
    add_config(parser, required=alone)
    parser.add_argument("--dataset", required=alone, help="folder written by `slipstitch sample`")
    parser.add_argument("--split", required=alone, choices=TRAINED_ON)
    if seed is None:
        parser.add_argument("--seed", required=True, type=int)
    else:
        seed.add_argument("--seed", type=int)
    parser.add_argument("--out-dir", type=output_folder, required=True, help=out)
    add_threads(parser)


def check_at_least(arguments: argparse.Namespace, **smallest: int) -> None:
    """Refuse options, by their names in `arguments`, that are below their minimum."""
    for name, least in smallest.items():
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise BadInput(f"{flag(name)} must be at least {least}")


def refuse(arguments: argparse.Namespace, names: Iterable[str], mode: str) -> None:
    """Refuse options, by their names in `arguments`, that were given and `mode` would ignore."""
    for name in names:
        if _given(arguments, name):
            raise BadInput(f"{flag(name)} cannot be combined with {mode}")


def require(arguments: argparse.Namespace, names: Iterable[str], mode: str) -> None:
    """Refuse `mode` without all of these options, by their names in `arguments`."""
    for name in names:
        if not _given(arguments, name):
            raise BadInput(f"{mode} requires {flag(name)}")


def _given(arguments: argparse.Namespace, name: str) -> bool:
    value = getattr(arguments, name)
    return value is not None and value is not False and value != []


def flag(name: str) -> str:
    """An option as on the command line; the shards have none."""
    return "image shards" if name == "shards" else f"--{name.replace('_', '-')}"
