"""Simulations as files: those of the grid, and those that are handed out instead of computed.

A handed out simulation, of a release or a folder of trajectories, is taken if fabric, friction
coefficient, seed and settings are those of the run. A file that claims to be the run and is not is
refused; what no file claims to be is simulated.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.base.provenance.record import DIGEST_KEY
from slipstitch.config import Config
from slipstitch.config.section import FormerKeyError, without_former_keys
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import find_simulation
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation import drop_and_drag as bench
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag
from slipstitch.physics.simulation.trajectory import Trajectory, read_with_columns, write_trajectory

CHECKSUMS = "SHA256SUMS"
SIMULATIONS = "simulations"  # where a release has them


def _of_the_run(run: DropAndDrag) -> dict[str, Any]:
    return {name: getattr(run, name) for name in ("material", "friction", "seed")}


def run_of_the_grid(config: Config, name: str) -> tuple[DropAndDrag, dict[str, str]]:
    """The run with an id, and what its file says about its place in the grid."""
    one = find_simulation(config, name)
    ids = {key: getattr(one, key) for key in ("material_id", "friction_id", "replicate_id")}
    ids = {"simulation": one.id, **ids}
    return DropAndDrag(one.material, one.friction, one.seed, one.replicate), ids


def simulate_to_file(
    config: Config,
    run: DropAndDrag,
    ids: dict[str, str],
    path: str | os.PathLike,
    *,
    device: str | None = None,
    calibration: str | os.PathLike | None = None,
    handed_out: str | os.PathLike | None = None,
) -> tuple[Trajectory, dict]:
    """Simulate a run, or take it from those handed out; write it, or the state that is unsolved.

    Ids are what `run_of_the_grid` says, or empty; device and folder go before the configured ones.
    Return the run and its record, which names the calibration, and under ``handed_out`` the origin.
    """
    started = provenance.start_clock()
    settings = config.simulation
    folder = handed_out or config.compute.handed_out
    taken = take_handed_out(folder, run, ids, settings) if folder else None
    if taken:
        trajectory, columns, origin = taken
    else:
        try:
            trajectory, columns = bench.simulate_drop_and_drag(
                run, settings, device=device or config.compute.device
            )
        except NotConverged as error:
            raise _with_state_saved(error, path) from None
        trajectory.metadata.update(ids)
    record = provenance.provenance_record(
        "simulate",
        inputs=[file for file in (calibration, settings.model) if file],
        config={"simulation": settings, "catalogue": run.catalogue_entries()},
        seed=run.seed,
        started=started,
    )
    if taken:
        record["handed_out"] = origin
    write_trajectory(path, trajectory, record, **columns)
    return trajectory, record


def _with_state_saved(error: NotConverged, out: str | os.PathLike) -> NotConverged:
    """Keep what the solver had beside where the result would have been."""
    if not error.state:
        return error
    path = Path(out).with_suffix(".failed.npz")
    with provenance.atomic_path(path) as partial, open(partial, "wb") as stream:
        np.savez_compressed(stream, **error.state)
    return NotConverged(f"{error}; its state was saved to {path}")


def take_handed_out(
    folder: str | os.PathLike, run: DropAndDrag, ids: dict[str, str], settings: SimulationSettings
) -> tuple[Trajectory, dict[str, np.ndarray], dict[str, Any]] | None:
    """Read a run from a folder of simulations or from a release; None if no file claims to be it.

    BadInput if two do, or it is damaged or of other settings. Return run, columns, origin.
    """
    asked = {"simulation": ids["simulation"]} if ids else _of_the_run(run)
    claims = [
        path
        for path, metadata in _simulations(Path(folder))
        if all(metadata.get(name) == value for name, value in asked.items())
    ]
    if not claims:
        return None
    name = ids.get("simulation") or f"{run.material} at friction {run.friction:g}, seed {run.seed}"
    if len(claims) > 1:
        raise BadInput(f"{claims[0]}: claims to be {name}, and so does {claims[1].name}")
    (path,) = claims
    sha256 = _checked_digest(path)
    trajectory, columns = read_with_columns(path)
    for difference in _differences(trajectory, run, settings):
        raise BadInput(f"{path}: is not {name} of this configuration: {difference}")
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
        metadata = provenance.read_metadata(path)
        if "material" in metadata and "friction" in metadata:
            yield path, metadata


def _checked_digest(path: Path) -> str:
    """SHA-256 of a file, as listed beside or above, unless its own pages carry checksums."""
    digest = provenance.file_digest(path)
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
    with provenance.open_parquet(path) as file:
        if DIGEST_KEY not in (file.schema_arrow.metadata or {}):
            raise BadInput(f"{path}: cannot be checked: no {CHECKSUMS} beside lists it")
    return digest


def _differences(
    trajectory: Trajectory, run: DropAndDrag, settings: SimulationSettings
) -> Iterator[str]:
    """What a simulation was made with other than a run is to be made with, in words."""
    its = trajectory.metadata
    for name, value in _of_the_run(run).items():
        if its.get(name) != value:
            yield f"{name} {its.get(name)}, not {value}"
    own, theirs = settings.model_dump(mode="json"), its.get("settings") or {}
    try:
        theirs = without_former_keys("simulation", theirs)
    except FormerKeyError as error:
        yield str(error)
    for name in sorted({*own, *theirs} - {"model"}):
        if own.get(name) != theirs.get(name):
            yield f"{name} {theirs.get(name, 'not stated')}, not {own.get(name, 'stated')}"
    model = asdict(read_extended_model(settings.model)) if settings.model else None
    recorded = ((its.get("provenance") or {}).get("config") or {}).get("catalogue")
    perturbation = asdict(bench.draw_perturbation(settings, run.seed, run.replicate))
    for name, expected, stated in (
        ("perturbation of the bench", perturbation, its.get("perturbation")),
        ("extended model", json.loads(json.dumps(model)), its.get("extended_model")),
        ("fabric data", run.catalogue_entries(), recorded),
    ):
        if expected != stated:
            yield f"another {name}"
    for name, array in bench.described_mesh(*bench.cloth_mesh(settings)).items():
        stated = getattr(trajectory, name)
        if np.shape(array) != np.shape(stated) or not np.allclose(array, stated, 0, 1e-12):
            yield "another mesh"
    if len(trajectory.frame) != settings.frames:
        yield f"{len(trajectory.frame)} frames, not {settings.frames}"
