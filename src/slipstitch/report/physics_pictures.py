"""Figures of physics and simulations, or None without data."""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import a_few, new_figure, styled
from slipstitch.base.page.palette import BLUE, FAINT, GREEN, ORANGE, PINK, THEORY
from slipstitch.physics.calibration.calibration_figure import calibration_figure
from slipstitch.physics.calibration.strip_figure import settings_figure, strip_figure
from slipstitch.physics.convergence.distance_figure import convergence_figure
from slipstitch.report.results import SimulationSummary


def friction_colour(friction: float, frictions: Sequence[float]):
    """Colour of a friction coefficient among those of the grid: dark is smooth."""
    share = 0.5 if len(frictions) < 2 else list(frictions).index(friction) / (len(frictions) - 1)
    return matplotlib.colormaps["viridis"](0.88 * share)


calibration = styled(calibration_figure)
strip = styled(strip_figure)
settings = styled(settings_figure)
convergence = styled(convergence_figure)

# What the profiles show: the paper's protocol (Sec. 4.1) lowers for 7 s, each stroke takes 31 s.
MOMENTS = (
    (7.0, "lowered", "#9a9a9a"),
    (12.0, "forward, starting", BLUE),
    (37.5, "forward, steady", GREEN),
    (43.0, "back, starting", ORANGE),
    (68.5, "back, steady", PINK),
)


@styled
def profiles(trajectories: Sequence[SimulationSummary]) -> Figure | None:
    """Side views: the line down the middle of each cloth at some moments, seen with the stage.

    Parameters
    ----------
    trajectories : sequence of SimulationSummary
        One for each material and friction coefficient that is to be shown.
    """
    if not trajectories:
        return None
    materials = list(dict.fromkeys(run.simulation.material for run in trajectories))
    frictions = sorted({run.simulation.friction for run in trajectories})
    width = max(2.25 * len(frictions) + 0.3, 7.0)
    figure = new_figure(width, 1.75 * len(materials) + 0.5)
    panels = figure.subplots(
        len(materials), len(frictions), sharex=True, sharey=True, squeeze=False
    )
    reach = max(float(np.abs(run.centre_m[:, :, 0]).max()) for run in trajectories)
    reach = 1e3 * min(reach, 0.2) + 8
    used: dict[str, Any] = {}
    drawn = {(run.simulation.material, run.simulation.friction) for run in trajectories}
    for (row, column), axes in np.ndenumerate(panels):
        if (materials[row], frictions[column]) not in drawn:
            axes.text(0.0, 80.0, "not run", ha="center", color=FAINT, fontsize=8)
        axes.set_aspect("equal")
        axes.axhline(0.0, color=THEORY, lw=0.8)
        axes.set(xlim=(-reach, reach), ylim=(-8, 175))
        axes.tick_params(length=2, labelsize=7.5)
        axes.spines["left"].set_visible(False)
        axes.spines["bottom"].set_visible(False)
        axes.set_yticks([0, 100])
        axes.set_xticks([-100, 0, 100])
    for run in trajectories:
        axes = panels[materials.index(run.simulation.material)][
            frictions.index(run.simulation.friction)
        ]
        for moment, name, colour in MOMENTS:
            if moment > run.time_s[-1] + 0.5:
                continue
            frame = int(np.argmin(np.abs(run.time_s - moment)))
            (line,) = axes.plot(
                1e3 * run.centre_m[frame, :, 0], 1e3 * run.centre_m[frame, :, 1], color=colour,
                lw=1.6, solid_capstyle="round",
            )  # fmt: skip
            used.setdefault(f"{name} ({run.time_s[frame]:.0f} s)", line)
    for axes, friction in zip(panels[0], frictions, strict=True):
        axes.set_title(f"µ = {friction:g}")
    for row, material in zip(panels, materials, strict=True):
        row[0].set_ylabel(f"{material}\nheight, mm", fontsize=8)
    figure.supxlabel("ahead of the clamps, mm", fontsize=8)
    figure.legend(
        [*used.values()], [*used], loc="outside upper center", ncols=5 if width > 9 else 3,
        frameon=False, fontsize=8,
    )  # fmt: skip
    return figure


@styled
def tails(trajectories: Sequence[SimulationSummary]) -> Figure | None:
    """Position of the lower edge relative to the clamps over time: the main visual cue.

    Parameters
    ----------
    trajectories : sequence of SimulationSummary
        All replicates of all materials and coefficients.
    """
    if not trajectories:
        return None
    materials = list(dict.fromkeys(run.simulation.material for run in trajectories))
    frictions = sorted({run.simulation.friction for run in trajectories})
    columns = min(3, len(materials))
    rows = math.ceil(len(materials) / columns)
    figure = new_figure(max(3.2 * columns + 0.6, 6.0), 2.3 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[len(materials) :]:
        axes.set_axis_off()
    lines: dict[str, Any] = {}
    for run in trajectories:
        axes = panels.flat[materials.index(run.simulation.material)]
        (line,) = axes.plot(
            run.time_s, 1e3 * run.centre_m[:, -1, 0], lw=1.1, alpha=0.9,
            color=friction_colour(run.simulation.friction, frictions),
        )  # fmt: skip
        lines.setdefault(f"µ = {run.simulation.friction:g}", line)
    for axes, material in zip(panels.flat, materials, strict=False):
        axes.axhline(0.0, color=FAINT, lw=0.6)
        axes.set_title(material)
    figure.supxlabel("time, s", fontsize=9)
    figure.supylabel("lower edge ahead of the clamps, mm", fontsize=9)
    order = a_few(sorted(lines, key=lambda name: float(name.split("=")[1])))
    figure.legend(
        [lines[name] for name in order], order, loc="outside upper center",
        ncols=len(order), frameon=False, fontsize=8,
    )  # fmt: skip
    return figure
