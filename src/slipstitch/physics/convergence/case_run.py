"""One case of the study and its file; apart from the comparison, which runs nothing again."""

from __future__ import annotations

import os

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock
from slipstitch.config import Config
from slipstitch.physics.convergence.cases import case_settings, cases
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory

SEED = 0  # of the perturbation of the bench, the same for all runs


def simulate_case(
    config: Config, name: str, out: str | os.PathLike, calibration: str | os.PathLike | None
) -> tuple[Trajectory, float]:
    """Simulate one case and write it; the run, and its CPU time in s.

    Parameters
    ----------
    config : Config
    name : str
        The case's id.
    out : path
        Parquet file, one row per frame.
    calibration : path, optional
        The file that settings were taken from, for the record.

    Raises
    ------
    BadInput
        If the study has no such case.
    NotConverged
        If it cannot be solved.
    """
    started = start_clock()
    case = {case.id: case for case in cases(config)}.get(name)
    if case is None:
        raise BadInput(f"the study has no case {name!r}; its ids look like {cases(config)[0].id}")
    settings = case_settings(case, config, config.simulation)
    run = DropAndDrag(case.material, case.friction, SEED)
    trajectory, columns = simulate_drop_and_drag(run, settings)
    trajectory.metadata["case"] = case.id
    record = provenance_record(
        "convergence",
        inputs=[calibration] if calibration else [],
        config={"simulation": settings},
        seed=SEED,
        started=started,
    )
    write_trajectory(out, trajectory, record, **columns)
    return trajectory, record["cpu_s"]
