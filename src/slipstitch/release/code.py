"""The sources that made a release, carried in it: what its code digests are digests of."""

import os
import shutil
from pathlib import Path

from slipstitch.errors import BadInput
from slipstitch.project import PACKAGE

CODE = "code"
SNAKEFILE = f"{CODE}/Snakefile"
SOURCES = f"{CODE}/src"
_PACKAGE = "src/slipstitch"
_NEEDED = ("Snakefile", "config.yaml", "LICENSE", "CITATION.cff")
_TOO = ("Makefile", "config", "envs", "profiles", "pyproject.toml", "rules", "workflow")
_IGNORED = shutil.ignore_patterns("__pycache__", "*.pyc", "*.tmp", "*.swp", "*~", ".*")


def check_project(project: str | os.PathLike) -> Path:
    """The folder of the Snakefile.

    Raises
    ------
    BadInput
        If it is none, or a checkout that the running code does not come from.
    """
    folder = Path(project).resolve()
    for name in _NEEDED:
        if not (folder / name).exists():
            raise BadInput(f"{project}: no workflow folder of Slipstitch: it has no {name}")
    if (folder / _PACKAGE).exists() and (folder / _PACKAGE).resolve() != PACKAGE:
        raise BadInput(f"{project}: the code that runs comes from another folder")
    return folder


def copy_code(project: Path, release: Path) -> None:
    """Copy workflow and sources to ``code/`` in the release, licence and citation beside it."""
    target = release / CODE
    sources = {name: project / name for name in (*_NEEDED, *_TOO)} | {_PACKAGE: PACKAGE}
    for name, source in sources.items():
        copy = target / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, copy, ignore=_IGNORED, copy_function=shutil.copyfile)
        elif source.is_file():
            shutil.copyfile(source, copy)
    for name in ("LICENSE", "CITATION.cff"):
        shutil.copyfile(project / name, release / name)
