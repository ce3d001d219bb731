"""The files of the study: one per case, the comparison of all, and the published results."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from slipstitch.config import Config
from slipstitch.convergence.cases import case_settings, cases
from slipstitch.convergence.study import describe
from slipstitch.errors import BadInput, Damaged
from slipstitch.provenance import (
    atomic_path,
    file_digest,
    provenance_record,
    read_json,
    reading,
    recorded_path,
    start_clock,
    write_json,
)
from slipstitch.provenance.reading import SIDECAR_SUFFIX
from slipstitch.simulate.convergence import MEASURED
from slipstitch.simulate.drop_and_drag import simulate_drop_and_drag
from slipstitch.simulate.trajectory import Trajectory, read_trajectory, write_trajectory

_AGAIN = "make study, picture and records with: snakemake --cores 2 convergence"


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
    trajectory, columns = simulate_drop_and_drag(
        case.material, case.friction, config.convergence.seed, settings
    )
    trajectory.metadata["case"] = case.id
    record = provenance_record(
        "convergence",
        inputs=[calibration] if calibration else [],
        config={"simulation": settings},
        seed=config.convergence.seed,
        started=started,
    )
    write_trajectory(out, trajectory, record, **columns)
    return trajectory, record["cpu_s"]


def compare_cases(
    config: Config,
    folder: str | os.PathLike,
    out: str | os.PathLike,
    picture: str | os.PathLike | None,
) -> dict[str, Any]:
    """Compare the cases that a folder holds; write and return what `describe` finds."""
    started = start_clock()
    files = {case.id: Path(folder) / f"{case.id}.parquet" for case in cases(config)}
    files = {name: file for name, file in files.items() if file.is_file()}
    study = describe(config, {name: read_trajectory(file) for name, file in files.items()})
    record = provenance_record(
        "convergence",
        inputs=files.values(),
        config={"convergence": config.convergence, "simulation": config.simulation},
        started=started,
    )
    write_json(out, study, record, indent=None)
    if picture:
        from slipstitch.convergence.distance_figure import convergence_figure

        with recorded_path(picture, record) as temporary:
            convergence_figure(study).savefig(temporary, dpi=110)
    return study


def publish(study_path: str | os.PathLike, folder: str | os.PathLike) -> int:
    """Copy a finished study to where it is kept, its summary to where simulations look it up.

    Returns
    -------
    int
        Cases of the summary.

    Raises
    ------
    BadInput
        If study, picture or a record of their origin is missing or damaged, or runs of the study
        are missing. Nothing is written then.
    """
    source = Path(study_path)
    files = [*_recorded(source), *_recorded(source.with_suffix(".png"))]
    study = read_json(source)
    with reading(source, "convergence study"):
        own, missing = study["settings"]["convergence"], study["missing"]
        table = {
            "studied": {
                "time_step_s": study["settings"]["time_step_s"],
                "window_s": own["window_s"],
                "mean_distance_m": own["mean_distance_m"],
                "simulation": study["settings"]["simulation"],
            },
            "cases": study["summary"],
        }
    if missing:
        raise BadInput(
            f"{source}: not finished: {missing[0]} is not run ({len(missing)} runs are missing); "
            f"only a whole study is published; {_AGAIN}"
        )
    for file in files:
        with atomic_path(Path(folder) / file.name) as temporary:
            temporary.write_bytes(file.read_bytes())
    write_json(MEASURED, table)
    return len(table["cases"])


def _recorded(file: Path) -> tuple[Path, Path]:
    """A file and the record of its origin, without which nothing is published."""
    side = file.with_name(file.name + SIDECAR_SUFFIX)
    for needed in (file, side):
        if not needed.is_file():
            raise BadInput(f"{needed}: no such file; {_AGAIN}")
    record = read_json(side)
    if not isinstance(record, dict) or record.get("sha256") != file_digest(file):
        raise Damaged(file, "its content does not match its record")
    return file, side
