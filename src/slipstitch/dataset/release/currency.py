"""Sources that a release carries; whether artefacts match code, configuration and catalogue."""

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import shortened
from slipstitch.base.project import PACKAGE
from slipstitch.base.provenance import code_digest
from slipstitch.base.provenance.code import RESULT_PACKAGES
from slipstitch.config import Config, resolve_config
from slipstitch.config.catalogue import catalogue_entries
from slipstitch.dataset.release.records import Artefact
from slipstitch.physics.fabric import fabric_digest

CODE = "code"
SNAKEFILE = f"{CODE}/Snakefile"
SOURCES = f"{CODE}/src"
_PACKAGE = "src/slipstitch"
PACKAGE_SOURCES = f"{CODE}/{_PACKAGE}"
_NEEDED = ("Snakefile", "config.yaml", "LICENSE", "CITATION.cff")
_TOO = ("Makefile", "config", "envs", "profiles", "pyproject.toml", "rules", "workflow")
LOCK = "envs/requirements.lock"
_IGNORED = shutil.ignore_patterns("__pycache__", "*.pyc", "*.tmp", "*.swp", "*~", ".*")


def check_project(project: str | os.PathLike) -> Path:
    """The folder of the Snakefile; BadInput if it is none, or of other code than runs."""
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


# Which viewpoints there are decides which shards there are, not what one shard holds
# (rules/render.smk); a shard's own viewpoint is compared by its id.
NOT_IN_A_SHARD = frozenset({"viewpoints", "test_viewpoints", "test_viewpoint_videos"})
ONE_VIEW = "viewpoint"
NO_INPUT = frozenset({"threads"})
_RESULT_PACKAGES = tuple(sorted(RESULT_PACKAGES.values()))


# What sources that somebody else wrote may make of reading them.
_NO_SOURCES = (
    *(ModuleNotFoundError, SyntaxError, ValueError, AttributeError),
    *(OSError, RecursionError, MemoryError),
)


def current_digest(
    stage: str, root: str | Path | None = None, versions: Mapping[str, Any] | None = None
) -> str | None:
    """Digest of the stage's code below a root, with versions; None if it cannot be had."""
    stated = None
    if versions is not None:
        stated = tuple((package, str(versions.get(package))) for package in _RESULT_PACKAGES)
    try:
        return code_digest(stage, root, stated) if stage else None
    except _NO_SOURCES:
        return None


def other_versions(record: Mapping[str, Any], lock: Mapping[str, str]) -> Iterator[str]:
    """Packages of a record that have other versions than a lock file names."""
    versions = record.get("versions")
    for package, version in sorted(versions.items() if isinstance(versions, Mapping) else ()):
        locked = lock.get(package.lower())
        if locked is not None and str(version).partition("+")[0] != locked:
            yield f"was made with {package} {version}; {LOCK} has {locked}"


def config_changes(
    artefact: Artefact, config: Config, calibrated: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    """Configuration values that the artefact was made with and that are others now.

    As ``key: recorded -> now``, of keys that the record holds and that there still are.
    `calibrated` has, by the path of a calibration, the settings that it chose: a simulation made
    from it was told to use these instead of those of `config`.
    """
    recorded = artefact.record.get("config", {})
    now = config.model_dump(mode="json")
    for path in artefact.inputs:
        now["simulation"] |= calibrated.get(path, {})
    # With the other sections: fewer frames than the default samples would be refused alone.
    now["simulation"] = resolve_config(now).simulation.model_dump(mode="json")
    changes: list[str] = []
    for section, value in recorded.items():
        if section in now and isinstance(value, Mapping) == isinstance(now[section], Mapping):
            of_others = section == "render" and ONE_VIEW in recorded
            skip = NO_INPUT | (NOT_IN_A_SHARD if of_others else frozenset())
            changes += _differences(section, value, now[section], skip, gone=False)
    return changes


def recorded_entries(artefact: Artefact) -> dict[str, dict[str, Any]]:
    """The entries of the catalogue that the artefact was made with, by kind and name."""
    entries = artefact.record.get("config", {}).get("catalogue", {})
    kinds = entries.items() if isinstance(entries, Mapping) else ()
    return {kind: dict(of_kind) for kind, of_kind in kinds if isinstance(of_kind, Mapping)}


def catalogue_changes(artefact: Artefact) -> list[str]:
    """Entries of the catalogue that are others now, as ``catalogue.kind.name: recorded -> now``."""
    then = recorded_entries(artefact)
    named = {kind: then.get(kind, ()) for kind in ("viewpoints", "textures", "floors")}
    fabrics = {name: fabric_digest(name) for name in then.get("fabrics", ())}
    now = {"fabrics": fabrics, **catalogue_entries(**named)}
    return list(_differences("catalogue", then, now))


def _differences(
    name: str, then: Any, now: Any, skip: frozenset[str] = frozenset(), gone: bool = True
) -> Iterator[str]:
    """Values that differ; where `gone`, also keys of before that are part of the code now."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for key in then:
            if key not in skip and (gone or key in now):
                other = now.get(key, "no such key")
                yield from _differences(f"{name}.{key}", then[key], other, gone=gone)
    elif then != now:
        yield f"{name}: {shortened(str(then), 60)} -> {shortened(str(now), 60)}"
