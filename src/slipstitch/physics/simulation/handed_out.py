"""Simulations that are handed out: a release's, or a folder of trajectories, instead of computing.

A simulation is taken if fabric, friction coefficient, seed and settings are those of the run. A
file that claims to be the run and is not is refused; what no file claims to be is simulated.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import open_parquet, read_metadata
from slipstitch.base.provenance.record import DIGEST_KEY
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.drop_and_drag import (
    DropAndDrag,
    cloth_mesh,
    described_mesh,
    draw_perturbation,
)
from slipstitch.physics.simulation.trajectory import Trajectory, read_with_columns

CHECKSUMS = "SHA256SUMS"
SIMULATIONS = "simulations"  # where a release has them
_OF_THE_RUN = ("material", "friction", "seed")


def take_handed_out(
    folder: str | os.PathLike, run: DropAndDrag, ids: dict[str, str], settings: SimulationSettings
) -> tuple[Trajectory, dict[str, np.ndarray], dict[str, Any]] | None:
    """Read a run from a folder of simulations or from a release.

    Parameters
    ----------
    folder : path
    run : DropAndDrag
    ids : dict
        What its file says about its place in the grid; of a run by hand empty.
    settings : SimulationSettings

    Returns
    -------
    trajectory, columns
        As `slipstitch.physics.simulation.drop_and_drag.simulate_drop_and_drag` returns them.
    origin : dict
        For the record: ``file``, its ``sha256``, and its own ``provenance``.

    None instead where no file claims to be the run.

    Raises
    ------
    BadInput
        If there is no such folder, or it has no simulations; if two files claim to be the run; if
        the file that does is damaged, or of another fabric, coefficient, seed, mesh or settings.
    """
    claims = [
        path
        for path, metadata in _simulations(Path(folder))
        if (
            metadata.get("simulation") == ids["simulation"]
            if ids
            else all(metadata.get(name) == getattr(run, name) for name in _OF_THE_RUN)
        )
    ]
    if not claims:
        return None
    name = ids.get("simulation") or f"{run.material} at friction {run.friction:g}, seed {run.seed}"
    if len(claims) > 1:
        raise BadInput(f"{claims[0]}: claims to be {name}, and so does {claims[1].name}")
    (path,) = claims
    sha256 = _checked_digest(path)
    trajectory, columns = read_with_columns(path)
    differ = _differences(trajectory, run, settings)
    if differ:
        raise BadInput(f"{path}: is not {name} of this configuration: {differ[0]}")
    metadata = trajectory.metadata
    origin = {"file": path.name, "sha256": sha256, "provenance": metadata.pop("provenance", None)}
    # What the study says now; a newer study may say something else.
    known = measured_convergence(run.material, run.friction, settings)
    metadata |= {**ids, "convergence": known}
    return trajectory, columns, origin


def _simulations(folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Files of a folder, or of a release, that hold a simulation, and their metadata."""
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder; must have simulations, or be a release")
    inside = folder / SIMULATIONS
    paths = sorted((inside if inside.is_dir() else folder).glob("*.parquet"))
    if not paths:
        raise BadInput(f"{folder}: has no simulations (*.parquet)")
    for path in paths:
        with open_parquet(path) as file:
            metadata = read_metadata(file.schema_arrow)
        if "material" in metadata and "friction" in metadata:
            yield path, metadata


def _checked_digest(path: Path) -> str:
    """SHA-256 of a file, which must be the one that is listed beside it or above.

    A file whose pages carry checksums, as Slipstitch writes them, needs no list.
    """
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    for folder in (path.parent, path.parent.parent):
        listed = folder / CHECKSUMS
        if not listed.is_file():
            continue
        lines = [line.split(maxsplit=1) for line in listed.read_text("utf-8").splitlines()]
        known = {name.lstrip("*./"): sha256 for sha256, name in (one for one in lines if one[1:])}
        name = path.relative_to(folder).as_posix()
        if name in known:
            if known[name] != digest:
                raise BadInput(f"{path}: damaged: its SHA-256 is not the one in {listed.name}")
            return digest
    with open_parquet(path) as file:
        if DIGEST_KEY not in (file.schema_arrow.metadata or {}):
            raise BadInput(f"{path}: cannot be checked: no {CHECKSUMS} beside lists it")
    return digest


def _differences(
    trajectory: Trajectory, run: DropAndDrag, settings: SimulationSettings
) -> list[str]:
    """What a simulation was made with other than a run is to be made with, in words."""
    its = trajectory.metadata
    found = [
        f"{name} {its.get(name)}, not {getattr(run, name)}"
        for name in _OF_THE_RUN
        if its.get(name) != getattr(run, name)
    ]
    own, theirs = settings.model_dump(mode="json"), its.get("settings") or {}
    found += [
        f"{name} {theirs.get(name, 'not stated')}, not {own.get(name, 'stated')}"
        for name in sorted({*own, *theirs} - {"model"})
        if own.get(name) != theirs.get(name)
    ]
    perturbation = asdict(draw_perturbation(settings, run.seed, run.replicate))
    model = asdict(read_extended_model(settings.model)) if settings.model else None
    model = json.loads(json.dumps(model))
    catalogue = run.catalogue_entries()
    recorded = ((its.get("provenance") or {}).get("config") or {}).get("catalogue")
    for name, expected, stated in (
        ("perturbation of the bench", perturbation, its.get("perturbation")),
        ("extended model", model, its.get("extended_model")),
        ("fabric data", catalogue, recorded),
    ):
        if expected != stated:
            found.append(f"another {name}")
    if not found and not _same_mesh(trajectory, settings):
        found.append("another mesh")
    if not found and len(trajectory.frame) != settings.frames:
        found.append(f"{len(trajectory.frame)} frames, not {settings.frames}")
    return found


def _same_mesh(trajectory: Trajectory, settings: SimulationSettings) -> bool:
    expected = described_mesh(*cloth_mesh(settings))
    return all(
        np.shape(array) == np.shape(getattr(trajectory, name))
        and np.allclose(array, getattr(trajectory, name), rtol=0, atol=1e-12)
        for name, array in expected.items()
    )
