"""Whether artefacts match the current code, configuration and catalogue."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from slipstitch.base.page.wording import shortened
from slipstitch.base.provenance import code_digest
from slipstitch.base.provenance.code import RESULT_PACKAGES
from slipstitch.config import Config, resolve_config
from slipstitch.config.catalogue import catalogue_entries
from slipstitch.config.load import calibrated_settings
from slipstitch.config.simulation import SimulationSettings
from slipstitch.dataset.release.code import LOCK
from slipstitch.dataset.release.records import Artefact
from slipstitch.physics.fabric import fabric_digest

# Which viewpoints there are decides which shards there are, not what one shard holds
# (rules/render.smk); a shard's own viewpoint is compared by its id.
NOT_IN_A_SHARD = frozenset({"viewpoints", "test_viewpoints", "test_viewpoint_videos"})
ONE_VIEW = "viewpoint"
NO_INPUT = frozenset({"threads"})
CALIBRATION = "calibration.json"
_RESULT_PACKAGES = tuple(sorted(RESULT_PACKAGES.values()))


# What sources that somebody else wrote may make of reading them.
_NO_SOURCES = (
    ModuleNotFoundError,
    SyntaxError,
    ValueError,
    OSError,
    RecursionError,
    MemoryError,
    AttributeError,
)


def current_digest(
    stage: str, root: str | Path | None = None, versions: Mapping[str, Any] | None = None
) -> str | None:
    """Digest of the stage's code; None if there is no such stage, or it cannot be read.

    Parameters
    ----------
    stage : str
    root : path, optional
        Folder of the package; the running one's by default.
    versions : mapping, optional
        Package -> version, as a record states them; by default what is installed.
    """
    stated = None
    if versions is not None:
        counting = (str(versions.get(package)) for package in _RESULT_PACKAGES)
        stated = tuple(zip(_RESULT_PACKAGES, counting, strict=True))
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


def _plain(config: Config | SimulationSettings) -> dict[str, Any]:
    return config.model_dump(mode="json")


def config_changes(
    artefact: Artefact, config: Config, calibrated: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    """Configuration values that the artefact was made with and that are others now.

    Parameters
    ----------
    artefact : Artefact
    config : Config
    calibrated : mapping
        Path of a calibration, as records call it -> the settings that it chose. A simulation that
        was made from it was told to use these instead of those of `config`.

    Returns
    -------
    list of str
        ``key: recorded -> now``. Only keys that the record holds, and that there still are, are
        compared.
    """
    recorded = artefact.record.get("config", {})
    now = _plain(config)
    now["simulation"] = _plain(calibrated_simulation(artefact, config, calibrated))
    changes: list[str] = []
    for section, value in recorded.items():
        if section in now and isinstance(value, Mapping) == isinstance(now[section], Mapping):
            of_others = section == "render" and ONE_VIEW in recorded
            skip = NO_INPUT | (NOT_IN_A_SHARD if of_others else frozenset())
            if isinstance(value, Mapping):  # keys of before have become part of the code
                skip |= set(value) - set(now[section])
            changes += _differences(section, value, now[section], skip)
    return changes


def calibrated_simulation(
    artefact: Artefact, config: Config, calibrated: Mapping[str, Mapping[str, Any]]
) -> SimulationSettings:
    """What a simulation was told to use: the configured settings, as its calibration chose.

    Raises
    ------
    BadInput
        If the calibration's settings are none.
    """
    told = _plain(config.simulation)
    for path in artefact.inputs:
        told |= calibrated.get(path, {})
    # With the other sections: fewer frames than the default samples would be refused alone.
    return resolve_config({**_plain(config), "simulation": told}).simulation


def calibrated_by(artefacts: Iterable[str], place: Callable[[str], Path]) -> dict[str, dict]:
    """The settings that calibrations among artefacts chose, by path.

    Parameters
    ----------
    artefacts : iterable of str
        Paths as records call them.
    place : callable
        Where the file of such a path is.

    Raises
    ------
    BadInput
        If a calibration is missing or damaged.
    """
    return {
        path: calibrated_settings(place(path))
        for path in artefacts
        if PurePosixPath(path).name == CALIBRATION
    }


def recorded_entries(artefact: Artefact) -> dict[str, dict[str, Any]]:
    """The entries of the catalogue that the artefact was made with, by kind and name."""
    entries = artefact.record.get("config", {}).get("catalogue", {})
    kinds = entries.items() if isinstance(entries, Mapping) else ()
    return {kind: dict(of_kind) for kind, of_kind in kinds if isinstance(of_kind, Mapping)}


def catalogue_changes(artefact: Artefact) -> list[str]:
    """Entries of the catalogue that the artefact was made with and that are others now.

    Returns
    -------
    list of str
        ``catalogue.kind.name: recorded -> now``.
    """
    then = recorded_entries(artefact)
    named = {kind: then.get(kind, ()) for kind in ("viewpoints", "textures", "floors")}
    now = {
        "fabrics": {name: fabric_digest(name) for name in then.get("fabrics", ())},
        **catalogue_entries(**named),
    }
    return list(_differences("catalogue", then, now, frozenset()))


def _differences(name: str, then: Any, now: Any, skip: frozenset[str]) -> Iterator[str]:
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for key in then:
            if key not in skip:
                yield from _differences(
                    f"{name}.{key}", then[key], now.get(key, "no such key"), frozenset()
                )
    elif then != now:
        yield f"{name}: {shortened(str(then), 60)} -> {shortened(str(now), 60)}"
