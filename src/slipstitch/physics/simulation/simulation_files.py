"""Simulations as files: those of the grid, with their ids; states of failed ones, for diagnosis."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slipstitch.base.errors import NotConverged
from slipstitch.base.provenance import atomic_path, provenance_record, start_clock
from slipstitch.config import Config
from slipstitch.design.grid import find_simulation
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_batch
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory

RunWithIds = tuple[DropAndDrag, dict[str, str]]


@dataclass(frozen=True)
class Written:
    """A simulation that was written; `cpu_s` is that of all that were simulated with it."""

    path: str | os.PathLike
    run: DropAndDrag
    trajectory: Trajectory
    cpu_s: float


def runs_of_the_grid(config: Config, names: Sequence[str]) -> list[RunWithIds]:
    """The runs with these ids, and what their files say about their place in the grid.

    Raises
    ------
    BadInput
        If the grid has no simulation of such a name.
    """
    found = [find_simulation(config, name) for name in names]
    return [
        (
            DropAndDrag(
                simulation.material, simulation.friction, simulation.seed, simulation.replicate
            ),
            {
                "simulation": simulation.id,
                "material_id": simulation.material_id,
                "friction_id": simulation.friction_id,
                "replicate_id": simulation.replicate_id,
            },
        )
        for simulation in found
    ]


def simulate_to_files(
    config: Config,
    runs: Sequence[RunWithIds],
    paths: Sequence[str | os.PathLike],
    *,
    device: str | None = None,
    calibration: str | os.PathLike | None = None,
) -> Iterator[Written]:
    """Simulate runs at once; write each, and the state of each that could not be solved.

    Parameters
    ----------
    config : Config
    runs : sequence
        With what `runs_of_the_grid` says of each, or an empty mapping.
    paths : sequence of path
        A Parquet file for each.
    device : str, optional
        Instead of the configured one.
    calibration : path, optional
        The file that settings were taken from, for the record.

    Raises
    ------
    BadInput
        See `slipstitch.physics.simulation.drop_and_drag.simulate_batch`.
    NotConverged
        After the others are written, if some could not be solved.
    """
    started = start_clock()
    settings = config.simulation
    outcomes = simulate_batch(
        [run for run, _ in runs], settings, device=device or config.compute.device
    )
    failed = []
    for (run, ids), path, outcome in zip(runs, paths, outcomes, strict=True):
        if isinstance(outcome, NotConverged):
            failed.append(_with_state_saved(outcome, path))
            continue
        trajectory, columns = outcome
        trajectory.metadata.update(ids, simulated_at_once=len(runs))
        record = provenance_record(
            "simulate",
            inputs=[file for file in (calibration, settings.model) if file],
            config={"simulation": settings, "catalogue": run.catalogue_entries()},
            seed=run.seed,
            started=started,
        )
        write_trajectory(path, trajectory, record, **columns)
        yield Written(path, run, trajectory, record["cpu_s"])
    if failed:
        raise NotConverged("; ".join(map(str, failed)))


def _with_state_saved(error: NotConverged, out: str | os.PathLike) -> NotConverged:
    """Keep what the solver had beside where the result would have been."""
    if not error.state:
        return error
    path = Path(out).with_suffix(".failed.npz")
    with atomic_path(path) as partial, open(partial, "wb") as stream:
        np.savez_compressed(stream, **error.state)
    return NotConverged(f"{error}; its state was saved to {path}")
