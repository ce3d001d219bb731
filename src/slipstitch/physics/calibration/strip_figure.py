"""The pushed strip: slip strain and shapes, and errors by numerical setting.

The first is the paper's Figure 3 for this simulator, the second its warning. Theory is black.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipstitch.base.page.figures import a_few
from slipstitch.base.page.palette import BLUE, FAINT, MEASURED, THEORY
from slipstitch.config.calibrate import BASE, KEYS
from slipstitch.physics.experiments.strip import strip_state, strip_state_at_foot_angle

LENGTH_M = 0.20
FABRICS = ((MEASURED, "o"), (BLUE, "D"))
# Settings as words, and the unit of their values.
NAMES = {
    "time_step_s": ("time step", "s"),
    "vertices": ("vertices along the strip", ""),
    "friction_tolerance": ("tolerance", ""),
    "newton_iterations_max": ("iteration limit", ""),
    "damping_s": ("damping time", "s"),
}
NOTHING_AT = 0.5  # where settings with which nothing slipped as it should are marked
WRONG_AT = 0.40  # where runs of a wrong regime that have no slip strain are marked


@cache
def _theory_points() -> np.ndarray:
    """Friction coefficient and slip strain, shape (n, 2), up to the flat foot."""
    angles = np.linspace(0.02, np.pi / 2, 30)
    states = [strip_state_at_foot_angle(angle) for angle in angles]
    return np.array([[0.0, 0.0], *([state.load_ratio, state.strain] for state in states)])


@cache
def _elastica(strain: float) -> np.ndarray:
    return strip_state(strain).curve


def _theory_curve(axes: Axes) -> None:
    points = _theory_points()
    axes.plot(*points.T, color=THEORY, lw=1.3)
    axes.plot([points[-1, 0], 0.65], [points[-1, 1]] * 2, "--", color=THEORY, lw=1.0)
    axes.set(xlim=(0, 0.65), ylim=(0, 0.43))
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def strip_figure(calibration: Mapping[str, Any]) -> Figure:
    """Slip strain against friction, and the strip's shape before it slips, by fabric.

    Parameters
    ----------
    calibration : mapping
        calibration.json, or what `calibration.strip_calibration` gives under
        its key ``strip``.
    """
    runs = calibration["strip"]["chosen"]["runs"]
    moduli = sorted({run["young_modulus_Pa"] for run in runs})
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _theory_curve(left)
    left.text(0.06, 0.28, "pinned", color=FAINT, ha="left")
    left.text(0.27, 0.17, "slipped", color=FAINT)
    left.text(0.5, 0.37, "partially slipped", color=FAINT, ha="center")
    handles = [Line2D([], [], color=THEORY, lw=1.3, label="theory (Sano et al. 2017)")]
    for index, modulus in enumerate(moduli):
        colour, marker = FABRICS[index % len(FABRICS)]
        of_fabric = [run for run in runs if run["young_modulus_Pa"] == modulus]
        for run in of_fabric:
            slipped = run["slip_strain"] is not None
            strain = run["slip_strain"] if slipped else run["flat_strain"]
            if strain is not None:
                left.plot(
                    run["friction"], strain, marker, color=colour, ms=6 - 2 * index,
                    mfc=colour if slipped else "white", zorder=3 + index,
                )  # fmt: skip
        handles.append(
            Line2D([], [], color=colour, marker=marker, lw=0, ms=5, label=_fabric_label(modulus))
        )
    handles.append(
        Line2D([], [], color=FAINT, marker="o", mfc="white", lw=0, ms=5, label="foot lies flat")
    )
    left.legend(handles=handles, frameon=False, fontsize=8, loc="lower right")
    left.set(
        title="Strip pushed on the floor",
        xlabel="friction coefficient µ",
        ylabel="vertical strain ε at slip",
    )
    _shapes(right, runs, moduli)
    return figure


def _fabric_label(modulus: float) -> str:
    return f"simulated, Young's modulus {modulus / 1e9:.3g} GPa"


def _shapes(axes: Axes, runs: Sequence[Mapping[str, Any]], moduli: Sequence[float]) -> None:
    """Shapes of every friction coefficient side by side, over the elastica's."""
    frictions = sorted({run["friction"] for run in runs})
    if len(frictions) > 6:
        frictions = [frictions[round(k)] for k in np.linspace(0, len(frictions) - 1, 6)]
    largest = strip_state_at_foot_angle(np.pi / 2).strain
    for place, friction in enumerate(frictions):
        at = 0.62 * place
        for index, modulus in enumerate(moduli):
            colour, marker = FABRICS[index % len(FABRICS)]
            run = next(
                run for run in runs
                if run["friction"] == friction and run["young_modulus_Pa"] == modulus
            )  # fmt: skip
            shape = np.array(run["shape_m"])[:: 1 + len(run["shape_m"]) // 20] / LENGTH_M
            if not len(shape):
                continue
            side = np.sign(shape[np.abs(shape[:, 0]).argmax(), 0]) or 1.0
            if index == 0:
                curve = _elastica(min(max(run["shape_strain"], 1e-5), largest))
                curve_side = np.sign(curve[np.abs(curve[:, 0]).argmax(), 0]) or 1.0
                foot = curve[-1, 1]
                axes.plot(
                    at + curve_side * curve[:, 0],
                    foot - curve[:, 1],
                    color=THEORY,
                    lw=1.0,
                    zorder=2,
                )
            height = 1 - run["shape_strain"] - shape[:, 1]
            axes.plot(
                at + side * shape[:, 0], height, marker, color=colour,
                ms=3.4 - index, mfc="none", mew=0.8, zorder=3 + index,
            )  # fmt: skip
        axes.text(at, -0.09, f"µ = {friction:g}", ha="center", fontsize=8)
    axes.axhline(0, color=FAINT, lw=0.8)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(ylim=(-0.12, 1.03))
    axes.set_title("Shape just before it slips or lies flat")


def settings_figure(calibration: Mapping[str, Any]) -> Figure:
    """One column per setting: slip strain with each value, and the largest error against the value.

    Parameters
    ----------
    calibration : mapping
        As for `strip_figure`; only ``strip.trials`` and ``strip.demand`` are read.
    """
    trials = calibration["strip"]["trials"]
    base = next(trial for trial in trials if trial["key"] == BASE)
    keys = [key for key in KEYS if any(trial["key"] == key for trial in trials)]
    columns = max(1, len(keys))
    figure = Figure(figsize=(max(6.4, 3.3 * columns), 6.2), layout="constrained")
    panels = figure.subplots(2, columns, squeeze=False, height_ratios=(1.25, 1))
    demand = calibration["strip"].get("demand", {}).get("slip_strain")
    for column, key in enumerate(keys):
        tried = [base, *(trial for trial in trials if trial["key"] == key)]
        tried.sort(key=lambda trial: trial["settings"][key])
        _slip_strains(panels[0, column], key, tried, base)
        _largest_errors(panels[1, column], key, tried, base, demand)
    panels[0, 0].set_ylabel("vertical strain ε at slip")
    panels[1, 0].set_ylabel("largest error of ε (dotted: limit)")
    for axes in panels[0, len(keys) :]:
        axes.set_axis_off()
    return figure


def _slip_strains(axes: Axes, key: str, tried, base) -> None:
    _theory_curve(axes)
    shades = colormaps["plasma"](np.linspace(0.1, 0.85, len(tried)))
    name, unit = NAMES[key]
    for shade, trial in zip(shades, tried, strict=True):
        value = trial["settings"][key]
        note = " (configured)" if trial is base else ""
        if trial is base or any(trial is shown for shown in a_few(tried, 5)):
            label = f"{value:g} {unit}".strip() + note
            axes.plot([], [], "o", color=shade, ms=4, label=label)
        for run in trial["runs"]:
            right = run["regime"] == run["theory_regime"]
            strain = run["slip_strain"] if run["slip_strain"] is not None else run["flat_strain"]
            if strain is None:  # not solved, or neither slipped nor flat
                axes.plot(run["friction"], WRONG_AT, "x", color=shade, ms=6, mew=1.5)
                continue
            axes.plot(
                run["friction"], strain, "o" if right else "X", color=shade,
                ms=4 if right else 8, mfc=shade if run["slip_strain"] is not None else "white",
            )  # fmt: skip
    axes.set(title=name.capitalize(), xlabel="friction coefficient µ")
    axes.legend(frameon=False, fontsize=7, loc="lower right")


def _largest_errors(axes: Axes, key: str, tried, base, demand: float | None) -> None:
    name, unit = NAMES[key]
    values = [trial["settings"][key] for trial in tried]
    places = np.arange(len(values))
    for place, trial in zip(places, tried, strict=True):
        error = trial["strain_error"]
        error = NOTHING_AT if error is None else max(error, 1e-4)
        axes.plot(
            place, error, "s" if trial is base else "o", ms=7,
            color=BLUE if trial["meets"] else MEASURED, mfc=BLUE if trial["meets"] else "white",
        )  # fmt: skip
        label = f"{trial['cpu_s']:.0f} s"
        if trial["wrong_regimes"]:
            label += f"\n{trial['wrong_regimes']} of {len(trial['runs'])}\nwrong"
        axes.annotate(
            label,
            (place, error),
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            fontsize=7,
        )
    if demand:
        axes.axhline(demand, color=THEORY, lw=1, ls=":")
    axes.set_yscale("log")
    axes.set_ylim(1e-4, 20.0)
    axes.set_xlim(-0.5, len(values) - 0.5)
    axes.set_xticks(places, [f"{value:g}" for value in values], fontsize=8)
    axes.set_xlabel(f"{name}{f', {unit}' if unit else ''}")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
