"""Theory in black, the simulator's measurements in colour."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipstitch.base.page.palette import FAINT, MEASURED, THEORY
from slipstitch.physics.experiments.incline import incline_theory
from slipstitch.physics.experiments.strip_drag import flexible_strip_drag, steady_strip_drag

# As the protocol holds it: by a hinge.
STRIP_LENGTH_M, STRIP_HEIGHT_M = 0.20, 0.15


def _runs(calibration: Mapping[str, Any], protocol: str) -> list[Mapping[str, Any]]:
    return [run for run in calibration["experiments"] if run["protocol"] == protocol]


def draw_incline(axes: Axes, calibration: Mapping[str, Any]) -> bool:
    """Acceleration over gravity against tan(slope)/μ; False if it was not run."""
    runs = _runs(calibration, "incline")
    if not runs:
        return False
    frictions = sorted({run["options"]["friction"] for run in runs})
    slopes = [math.tan(math.radians(run["options"]["slope_deg"])) for run in runs]
    largest = max(
        slope / run["options"]["friction"] for slope, run in zip(slopes, runs, strict=True)
    )
    ratio = np.linspace(0.8, 1.05 * largest, 301)
    for friction in frictions:
        theory = [
            incline_theory(friction, math.atan(value * friction)).acceleration_m_s2
            for value in ratio
        ]
        axes.plot(ratio, theory, color=THEORY, lw=1.2)
        axes.annotate(
            f"µ = {friction:g}", (ratio[-1], theory[-1]), xytext=(-2, 3), ha="right",
            textcoords="offset points", fontsize=8, color=THEORY,
        )  # fmt: skip
    for slope, run in zip(slopes, runs, strict=True):
        acceleration = run["result"].get("acceleration_m_s2")
        if run["result"].get("sticks"):
            acceleration = 0.0
        if acceleration is not None:
            axes.plot(
                slope / run["options"]["friction"], acceleration, "o", color=MEASURED, ms=5,
                mfc="white" if run["result"].get("sticks") else MEASURED,
            )  # fmt: skip
    axes.set(title="Inclined plane", xlabel="tan(slope) / µ", ylabel="acceleration, m/s²")
    return True


def draw_flat_drag(axes: Axes, calibration: Mapping[str, Any]) -> bool:
    """Pull over weight against friction; False if it was not run."""
    runs = _runs(calibration, "flat-drag")
    if not runs:
        return False
    frictions = [run["options"]["friction"] for run in runs]
    axes.plot([0, 1.1 * max(frictions)], [0, 1.1 * max(frictions)], color=THEORY, lw=1.2)
    axes.plot(
        frictions, [run["result"].get("pull_over_weight") or np.nan for run in runs], "o",
        color=MEASURED, ms=5,
    )  # fmt: skip
    axes.set(title="Flat drag", xlabel="friction coefficient µ", ylabel="pull / weight")
    axes.set(xlim=(0, None), ylim=(0, None))
    return True


def draw_strip_drag(axes: Axes, calibration: Mapping[str, Any], quantity: str) -> bool:
    """Pull or tail of the steadily dragged strip against friction; False if it was not run.

    Parameters
    ----------
    axes : Axes
        Where to draw.
    calibration : mapping
        A calibration.
    quantity : {"pull_over_w_m", "holder_ahead_of_tail_m"}
        What to draw.
    """
    runs = _runs(calibration, "strip-drag")
    if not runs:
        return False
    frictions = [run["options"]["friction"] for run in runs]
    gravity_length = runs[0]["options"]["gravity_length_m"]
    grid = np.linspace(0.02, 1.15 * max(frictions), 21)
    stiff = [
        steady_strip_drag(
            value, STRIP_LENGTH_M, STRIP_HEIGHT_M, gravity_length, holder_angle_rad=None
        )
        for value in grid
    ]
    flexible = [flexible_strip_drag(value, STRIP_LENGTH_M, STRIP_HEIGHT_M) for value in grid]
    axes.plot(
        grid, [1e3 * getattr(drag, quantity) for drag in flexible], ":", color=FAINT, lw=1.2,
        label="no bending rigidity",
    )  # fmt: skip
    axes.plot(
        grid, [1e3 * getattr(drag, quantity) for drag in stiff], color=THEORY, lw=1.2,
        label=f"elastica, gravity length {1e3 * gravity_length:g} mm",
    )  # fmt: skip
    measured = [run["result"].get(quantity) for run in runs]
    axes.plot(
        frictions, [np.nan if value is None else 1e3 * value for value in measured], "o",
        color=MEASURED, ms=5, label="simulator",
    )  # fmt: skip
    names = {
        "pull_over_w_m": ("Strip drag: pull", "pull / weight per length, mm"),
        "holder_ahead_of_tail_m": ("Strip drag: tail", "end of tail to holder, mm"),
    }
    title, label = names[quantity]
    axes.set(title=title, xlabel="friction coefficient µ", ylabel=label)
    axes.legend(frameon=False, fontsize=7.5, loc="lower right")
    return True


def calibration_figure(calibration: Mapping[str, Any]) -> Figure:
    """One panel for every experiment that was run.

    Parameters
    ----------
    calibration : mapping
        What `calibration.calibrate` returns, or calibration.json read.
    """
    painters = (
        draw_incline,
        draw_flat_drag,
        lambda axes, data: draw_strip_drag(axes, data, "pull_over_w_m"),
        lambda axes, data: draw_strip_drag(axes, data, "holder_ahead_of_tail_m"),
    )
    figure = Figure(figsize=(9.6, 7.0), layout="constrained")
    panels = figure.subplots(2, 2)
    for axes, paint in zip(panels.flat, painters, strict=True):
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        if not paint(axes, calibration):
            axes.set_axis_off()
            axes.text(0.5, 0.5, "not run", ha="center", va="center", color=FAINT)
    return figure
