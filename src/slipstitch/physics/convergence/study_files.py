"""The files of the study: the comparison of all cases, and the published results."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import (
    atomic_path,
    file_digest,
    provenance_record,
    read_json,
    reading,
    recorded_path,
    start_clock,
    write_json,
)
from slipstitch.base.provenance.reading import SIDECAR_SUFFIX
from slipstitch.config import Config
from slipstitch.physics.convergence.cases import cases
from slipstitch.physics.convergence.study import describe
from slipstitch.physics.simulation.convergence import MEASURED
from slipstitch.physics.simulation.trajectory import read_trajectory

_AGAIN = "make study, picture and records with: snakemake --cores 2 convergence"


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
        from slipstitch.physics.convergence.distance_figure import convergence_figure

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
