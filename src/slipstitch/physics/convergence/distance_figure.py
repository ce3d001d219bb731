"""Distance of the runs from the finest over time."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipstitch.base.page.figures import a_few
from slipstitch.base.page.palette import FAINT, SOFT

LEAST_MM = 1e-3
COLUMNS_MAX = 5


def convergence_figure(study: Mapping[str, Any]) -> Figure:
    """Draw a study: a row per kind of refinement, a panel per fabric, a colour per friction.

    Parameters
    ----------
    study : mapping
        What `slipstitch.physics.convergence.study.describe` returned.
    """
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
    figure = Figure(figsize=(3.1 * columns + 0.6, 2.3 * len(lines) + 0.9), layout="constrained")
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
            axes.axhline(
                1e3 * study["settings"]["convergence"]["mean_distance_m"],
                color=FAINT, lw=0.8, ls=":",
            )  # fmt: skip
            if not shown:
                axes.text(0.5, 0.5, "not run", transform=axes.transAxes, ha="center")
    figure.supxlabel("time, s", fontsize=8)
    coefficients = [
        Line2D([], [], color=colour, label=f"µ = {friction:g}")
        for colour, friction in zip(colours, frictions, strict=True)
    ]
    styles = []
    for style, width, name in (
        ("-", 1.6, "chosen settings"),
        ("-", 0.7, "one refinement"),
        ("--", 0.9, "chosen, time shift allowed"),
        (":", 0.8, "counts as converged"),
    ):
        styles.append(Line2D([], [], color=SOFT, ls=style, lw=width, label=name))
    look = {"ncols": 2, "frameon": False, "fontsize": 7.5}
    figure.legend(handles=a_few(coefficients), loc="outside upper left", **look)
    figure.legend(handles=styles, loc="outside upper right", **look)
    return figure


def _draw(axes, case: Mapping[str, Any], colour, chosen: bool) -> None:
    curve = case["curve"]
    in_mm = {
        name: np.maximum(1e3 * np.array(curve[name]), LEAST_MM)
        for name in ("mean_m", "shifted_mean_m")
    }
    axes.plot(curve["time_s"], in_mm["mean_m"], color=colour, lw=1.6 if chosen else 0.7)
    if chosen:
        axes.plot(curve["time_s"], in_mm["shifted_mean_m"], color=colour, lw=0.9, ls="--")
