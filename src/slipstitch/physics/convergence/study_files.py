"""The files of the study: the comparison of all cases, its picture, and the published results."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.page.figures import new_figure, save_figure, styled
from slipstitch.base.page.palette import FAINT, SOFT
from slipstitch.base.page.wording import evenly
from slipstitch.base.provenance.files import SIDECAR_SUFFIX, record_beside
from slipstitch.config import Config
from slipstitch.physics.convergence.cases import cases
from slipstitch.physics.convergence.study import describe
from slipstitch.physics.simulation.convergence import MEASURED
from slipstitch.physics.simulation.trajectory import read_trajectory

LEAST_MM = 1e-3
COLUMNS_MAX = 5
_AGAIN = "make study, picture and records with: snakemake --cores 2 convergence"


def compare_cases(
    config: Config,
    folder: str | os.PathLike,
    out: str | os.PathLike,
    picture: str | os.PathLike | None,
) -> dict[str, Any]:
    """Compare the cases that a folder holds; write and return what `describe` finds."""
    started = provenance.start_clock()
    files = {case.id: Path(folder) / f"{case.id}.parquet" for case in cases(config)}
    files = {name: file for name, file in files.items() if file.is_file()}
    study = describe(config, {name: read_trajectory(file) for name, file in files.items()})
    sections = {"convergence": config.convergence, "simulation": config.simulation}
    record = provenance.provenance_record(
        "convergence", inputs=files.values(), config=sections, started=started
    )
    provenance.write_json(out, study, record, indent=None)
    if picture:
        with provenance.recorded_path(picture, record) as temporary:
            save_figure(convergence_figure(study), temporary, dots_per_inch=110)
    return study


def publish(study_path: str | os.PathLike, folder: str | os.PathLike) -> int:
    """Copy a finished study to where it is kept, its summary to where simulations look it up.

    Return the number of cases; nothing is written of a study that is not whole.
    """
    source = Path(study_path)
    files = [*_recorded(source), *_recorded(source.with_suffix(".png"))]
    study = provenance.read_json(source)
    with provenance.reading(source, "convergence study"):
        own, missing = study["settings"]["convergence"], study["missing"]
        settings = study["settings"]
        table = {
            "studied": {
                "time_step_s": settings["time_step_s"],
                **{name: own[name] for name in ("window_s", "mean_distance_m")},
                "simulation": settings["simulation"],
            },
            "cases": study["summary"],
        }
    if missing:
        raise BadInput(
            f"{source}: not finished: {missing[0]} is not run ({len(missing)} runs are missing); "
            f"only a whole study is published; {_AGAIN}"
        )
    for file in files:
        with provenance.atomic_path(Path(folder) / file.name) as temporary:
            temporary.write_bytes(file.read_bytes())
    provenance.write_json(MEASURED, table)
    return len(table["cases"])


def _recorded(file: Path) -> tuple[Path, Path]:
    """A file and the record of its origin, without which nothing is published."""
    side = file.with_name(file.name + SIDECAR_SUFFIX)
    for needed in (file, side):
        if not needed.is_file():
            raise BadInput(f"{needed}: no such file; {_AGAIN}")
    if (record_beside(file) or {}).get("sha256") != provenance.file_digest(file):
        raise Damaged(file, "its content does not match its record")
    return file, side


@styled
def convergence_figure(study: Mapping[str, Any]) -> Figure:
    """Draw what `study.describe` returned: kinds of refinement, a panel per fabric."""
    compared = study["comparisons"]
    materials = list(dict.fromkeys(case["material"] for case in compared))
    columns = min(len(materials), COLUMNS_MAX)
    lines = [
        (kind, materials[first : first + columns])
        for kind in dict.fromkeys(case["kind"] for case in compared)
        for first in range(0, len(materials), columns)
    ]
    frictions = sorted({case["friction"] for case in compared})
    colours = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(frictions)))
    figure = new_figure(3.1 * columns + 0.6, 2.3 * len(lines) + 0.9)
    panels = figure.subplots(len(lines), columns, sharex=True, sharey=True, squeeze=False)
    for row, (kind, there) in zip(panels, lines, strict=True):
        row[0].set_ylabel(f"{kind}\nmean distance, mm", fontsize=8)
        for axes in row[len(there) :]:
            axes.remove()
        for axes, material in zip(row, there, strict=False):
            axes.set_title(material)
            shown = [
                case for case in compared if (case["kind"], case["material"]) == (kind, material)
            ]
            for case in shown:
                chosen = case is next(o for o in shown if o["friction"] == case["friction"])
                _draw(axes, case, colours[frictions.index(case["friction"])], chosen)
            axes.set_yscale("log")
            converged_mm = 1e3 * study["settings"]["convergence"]["mean_distance_m"]
            axes.axhline(converged_mm, color=FAINT, lw=0.8, ls=":")
            if not shown:
                axes.text(0.5, 0.5, "not run", transform=axes.transAxes, ha="center")
    figure.supxlabel("time, s", fontsize=8)
    coefficients = [
        Line2D([], [], color=colour, label=f"µ = {friction:g}")
        for colour, friction in zip(colours, frictions, strict=True)
    ]
    styles = [
        Line2D([], [], color=SOFT, ls=style, lw=width, label=name)
        for style, width, name in (
            ("-", 1.6, "chosen settings"),
            ("-", 0.7, "one refinement"),
            ("--", 0.9, "chosen, time shift allowed"),
            (":", 0.8, "counts as converged"),
        )
    ]
    look = {"ncols": 2, "frameon": False, "fontsize": 7.5}
    figure.legend(handles=evenly(coefficients), loc="outside upper left", **look)
    figure.legend(handles=styles, loc="outside upper right", **look)
    return figure


def _draw(axes, case: Mapping[str, Any], colour, chosen: bool) -> None:
    curve = case["curve"]
    mean_mm, shifted_mm = (
        np.maximum(1e3 * np.array(curve[name]), LEAST_MM) for name in ("mean_m", "shifted_mean_m")
    )
    axes.plot(curve["time_s"], mean_mm, color=colour, lw=1.6 if chosen else 0.7)
    if chosen:
        axes.plot(curve["time_s"], shifted_mm, color=colour, lw=0.9, ls="--")
