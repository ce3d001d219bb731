"""The sources that generated a release, included in it: its code digests refer to them."""

import os
import shutil
from pathlib import Path

from slipstitch.base.errors import BadInput
from slipstitch.base.project import PACKAGE

CODE = "code"
SNAKEFILE = f"{CODE}/Snakefile"
SOURCES = f"{CODE}/src"
_PACKAGE = "src/slipstitch"
PACKAGE_SOURCES = f"{CODE}/{_PACKAGE}"
_NEEDED = ("Snakefile", "config.yaml", "LICENSE", "CITATION.cff")
_TOO = ("Makefile", "config", "envs", "profiles", "pyproject.toml", "rules", "workflow")
#: Files and folders of a checkout that a release carries.
COPIED = (*_NEEDED, *_TOO, "src/slipstitch")
LOCK = "envs/requirements.lock"
_IGNORED = shutil.ignore_patterns("__pycache__", "*.pyc", "*.tmp", "*.swp", "*~", ".*")


def locked_versions(project: Path) -> dict[str, str]:
    """Package, in lower case -> version that the project's lock names; empty without one."""
    try:
        text = (project / LOCK).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return {}
    lines = (line.partition(";")[0].strip() for line in text.splitlines())
    pairs = (line.split("==") for line in lines if line.count("==") == 1 and line[0] != "#")
    return {name.strip().lower(): version.strip() for name, version in pairs}


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
            raise BadInput(f"{project}: not a workflow folder of Slipstitch: no {name}")
    if (folder / _PACKAGE).exists() and (folder / _PACKAGE).resolve() != PACKAGE:
        raise BadInput(f"{project}: the running code is in another folder")
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
