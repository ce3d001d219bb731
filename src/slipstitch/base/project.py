"""The workflow's own files: beside the sources of a checkout, or installed with the package."""

import functools
import importlib.metadata
import shutil
from pathlib import Path

from slipstitch.base.errors import BadInput

# What a workflow folder consists of; setup.py puts the same into the wheel.
PARTS = (
    "Snakefile",
    "config.yaml",
    "config",
    "data/cases",
    "envs",
    "profiles",
    "rules",
    "workflow",
    "CITATION.cff",
    "LICENSE",
)
INSTALLED = "slipstitch_workflow"  # beside the package: no stage's code digest covers it
PACKAGE = Path(__file__).resolve().parents[1]


def project_folder() -> Path:
    """The checkout, or what the installed package brought with it."""
    installed = PACKAGE.with_name(INSTALLED)
    return installed if installed.is_dir() else PACKAGE.parents[1]


def pinned_versions(requirements: Path) -> dict[str, str]:
    """Package -> version that a file of requirements pins; empty if there is no such file."""
    lines = requirements.read_text(encoding="utf-8").splitlines() if requirements.is_file() else []
    pinned = (line.partition("#")[0].partition(";")[0].split("==") for line in lines)
    return {pair[0].strip(): pair[1].strip() for pair in pinned if len(pair) == 2}


@functools.cache
def installed_version(package: str) -> str | None:
    """Return the version of an installed package; None if the package is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def copy_parts(source: Path, target: Path) -> None:
    """Copy the workflow's files from folder to folder."""
    for part in PARTS:
        (target / part).parent.mkdir(parents=True, exist_ok=True)
        if (source / part).is_dir():
            shutil.copytree(source / part, target / part, copy_function=shutil.copyfile)
        else:
            shutil.copyfile(source / part, target / part)


def lay_out(folder: Path) -> None:
    """Make a workflow folder, in which ``snakemake`` is run.

    BadInput if something of that name is there already.
    """
    there = [part for part in PARTS if (folder / part).exists()]
    if there:
        raise BadInput(f"{folder / there[0]}: already exists; nothing is overwritten")
    copy_parts(project_folder(), folder)
