"""Simulations as files: those of the grid, with their ids; states of failed ones, for diagnosis."""

import os
from pathlib import Path

import numpy as np

from slipstitch.base.errors import NotConverged
from slipstitch.base.provenance import atomic_path, provenance_record, start_clock
from slipstitch.config import Config
from slipstitch.design.grid import find_simulation
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag
from slipstitch.physics.simulation.handed_out import take_handed_out
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory


def run_of_the_grid(config: Config, name: str) -> tuple[DropAndDrag, dict[str, str]]:
    """The run with an id, and what its file says about its place in the grid.

    Raises
    ------
    BadInput
        If the grid has no simulation of such a name.
    """
    one = find_simulation(config, name)
    ids = {
        "simulation": one.id,
        "material_id": one.material_id,
        "friction_id": one.friction_id,
        "replicate_id": one.replicate_id,
    }
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
    """Simulate a run, or take it from those handed out; write it.

    Of a run that cannot be solved the state is written.

    Parameters
    ----------
    config : Config
    run : DropAndDrag
    ids : dict
        What `run_of_the_grid` says of it, or an empty mapping.
    path : path
        Parquet file.
    device : str, optional
        Instead of the configured one.
    calibration : path, optional
        The file that settings were taken from, for the record.
    handed_out : path, optional
        Folder or release to take the run from if it is there; the configured one by default.

    Returns
    -------
    trajectory : Trajectory
    record : dict
        Its provenance; under ``handed_out`` where it was taken from, if it was.

    Raises
    ------
    BadInput
        See `slipstitch.physics.simulation.drop_and_drag.simulate_drop_and_drag` and
        `slipstitch.physics.simulation.handed_out.take_handed_out`.
    NotConverged
        A step could not be solved.
    """
    started = start_clock()
    settings = config.simulation
    folder = handed_out or config.compute.handed_out
    taken = take_handed_out(folder, run, ids, settings) if folder else None
    if taken:
        trajectory, columns, origin = taken
    else:
        try:
            trajectory, columns = simulate_drop_and_drag(
                run, settings, device=device or config.compute.device
            )
        except NotConverged as error:
            raise _with_state_saved(error, path) from None
        trajectory.metadata.update(ids)
    record = provenance_record(
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
    with atomic_path(path) as partial, open(partial, "wb") as stream:
        np.savez_compressed(stream, **error.state)
    return NotConverged(f"{error}; its state was saved to {path}")
