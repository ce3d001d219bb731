"""Types of options: names from a list, files to read, files to write."""

import importlib
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click


class ChoiceOf(click.ParamType):
    """One of the names that an attribute of a wing holds; imported when needed."""

    name = "choice"

    def __init__(self, module: str, attribute: str):
        self.place = f"slipstitch.{module}", attribute

    def names(self) -> Sequence[str]:
        """Return the names."""
        module, attribute = self.place
        return getattr(importlib.import_module(module), attribute)

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return the names."""
        return f"[{'|'.join(self.names())}]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name, if it is one of them."""
        if value not in self.names():
            self.fail(f"{value!r} is not one of {', '.join(self.names())}", param, ctx)
        return value


class Output(click.ParamType):
    """A file to write, by its endings, or a folder: refused before any work if it cannot be."""

    name = "file"

    def __init__(self, *endings: str, folder: bool = False, or_stdout: bool = False):
        self.endings = endings
        self.folder = folder
        self.or_stdout = or_stdout
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
    if folder and path.exists() and not path.is_dir():
        return "is a file; must be a folder"
    if not folder and path.is_dir():
        return "is a folder; must be a file"
    if not folder and path.exists() and not path.is_file():
        return "is a device or a pipe; must be a file"
    above = next((parent for parent in path.absolute().parents if parent.exists()), path)
    if not above.is_dir():
        return f"{above} is a file, not a folder"
    try:  # permissions alone do not tell of a read-only disk, or of /proc
        with tempfile.TemporaryDirectory(prefix=".", dir=above):
            return None
    except OSError as error:
        return f"cannot be written: {(error.strerror or 'refused').lower()}"


class _Input(click.Path):
    """A path, called FILE or DIR in the help."""

    def __init__(self, name: str):
        super().__init__(path_type=Path)
        self.name = name


FILE, DIR = _Input("file"), _Input("dir")
FOLDER = Output(folder=True)
PAGE = Output(".html", ".htm")
JSON = Output(".json")
TABLE = Output(".csv")
PARQUET = Output(".parquet")
PICTURE = Output(".png", ".svg")
