"""The pictures of a calibration; apart from it, so that another plot leaves the settings alone.

Theory is black, what was measured coloured.
"""

import math
import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipstitch.base.page.figures import new_figure, save_figure, styled
from slipstitch.base.page.palette import BLUE, FAINT, MEASURED, THEORY
from slipstitch.base.page.wording import evenly
from slipstitch.base.provenance import provenance_record, read_json, recorded_path, start_clock
from slipstitch.config.load import calibrated_settings
from slipstitch.config.simulation import BASE, KEYS
from slipstitch.physics.experiments import plane, strip, strip_drag
from slipstitch.physics.experiments.strip import LENGTH_M

FABRICS = ((MEASURED, "o"), (BLUE, "D"))
# Settings as words, and the unit of their values.
NAMES = {
    "time_step_s": ("time step", "s"),
    "vertices": ("vertices along the strip", ""),
    "friction_tolerance": ("tolerance", ""),
    "newton_iterations_max": ("iteration limit", ""),
    "damping_s": ("damping time", "s"),
}
FRICTION = "friction coefficient µ"
NOTHING_AT = 0.5  # where settings with which nothing slipped as it should are marked
WRONG_AT = 0.40  # where runs of a wrong regime that have no slip strain are marked

Run = Mapping[str, Any]


def draw_pictures(
    pictures: Mapping[str, str | os.PathLike],
    calibration: Mapping[str, Any],
    record: Mapping[str, Any],
    failed: bool,
) -> None:
    """Draw what a calibration holds; of one that chose no settings, those that were tried.

    Where a requirement is not met, ``failed`` stands before the suffix of each file.
    """
    figures = {"settings": settings_figure}
    if "chosen" in calibration["strip"]:
        figures |= {"checks": calibration_figure, "strip": strip_figure}
    for name, figure in figures.items():
        if name not in pictures:
            continue
        path = Path(pictures[name])
        if failed:
            path = path.with_suffix(f".failed{path.suffix}")
        with recorded_path(path, record) as temporary:
            save_figure(figure(calibration), temporary, path.suffix.lstrip(".") or "png")


def draw_again(path: str | os.PathLike, pictures: Mapping[str, str | os.PathLike]) -> None:
    """Draw the pictures of a calibration from its file."""
    started = start_clock()
    calibrated_settings(path)  # says what is wrong with it
    record = provenance_record("calibrate.pictures", inputs=[path], started=started)
    draw_pictures(pictures, read_json(path), record, failed=False)


# -- the checks -------------------------------------------------------------------------------


@styled
def calibration_figure(calibration: Mapping[str, Any]) -> Figure:
    """Draw the checks of a calibration against theory, a panel each; some may not have been run."""
    figure = new_figure(9.6, 7.0)
    pull = "pull_over_w_m", "Strip drag: pull", "pull / weight per length, mm"
    tail = "holder_ahead_of_tail_m", "Strip drag: tail", "end of tail to holder, mm"
    panels: Any = (
        ("incline", _incline),
        ("flat-drag", _flat_drag),
        ("strip-drag", _strip_drag, *pull),
        ("strip-drag", _strip_drag, *tail),
    )
    for axes, (protocol, draw, *words) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        runs = [run for run in calibration["experiments"] if run["protocol"] == protocol]
        if runs:
            draw(axes, runs, *words)
        else:
            axes.set_axis_off()
            axes.text(0.5, 0.5, "not run", ha="center", va="center", color=FAINT)
    return figure


def _of_runs(runs: Sequence[Run], key: str, scale: float = 1.0) -> list[float]:
    values = (run["result"].get(key) for run in runs)
    return [math.nan if value is None else scale * value for value in values]


def _incline(axes: Axes, runs: Sequence[Run]) -> None:
    """Acceleration against tan(slope)/μ; open circles where the cloth sticks."""
    ratios = [
        math.tan(math.radians(run["options"]["slope_deg"])) / run["options"]["friction"]
        for run in runs
    ]
    grid = np.linspace(0.8, 1.05 * max(ratios), 301)
    for friction in sorted({run["options"]["friction"] for run in runs}):
        theory = [plane.incline_theory(friction, math.atan(ratio * friction)) for ratio in grid]
        axes.plot(grid, theory, color=THEORY, lw=1.2)
        axes.annotate(
            f"µ = {friction:g}", (grid[-1], theory[-1]), xytext=(-2, 3), ha="right",
            textcoords="offset points", fontsize=8, color=THEORY,
        )  # fmt: skip
    for ratio, run in zip(ratios, runs, strict=True):
        sticks = run["result"].get("sticks")
        (acceleration,) = _of_runs([run], "acceleration_m_s2")
        axes.plot(
            ratio, 0.0 if sticks else acceleration, "o", color=MEASURED, ms=5,
            mfc="white" if sticks else MEASURED,
        )  # fmt: skip
    axes.set(title="Inclined plane", xlabel="tan(slope) / µ", ylabel="acceleration, m/s²")


def _flat_drag(axes: Axes, runs: Sequence[Run]) -> None:
    frictions = [run["options"]["friction"] for run in runs]
    axes.plot([0, 1.1 * max(frictions)], [0, 1.1 * max(frictions)], color=THEORY, lw=1.2)
    axes.plot(frictions, _of_runs(runs, "pull_over_weight"), "o", color=MEASURED, ms=5)
    axes.set(title="Flat drag", xlabel=FRICTION, ylabel="pull / weight")
    axes.set(xlim=(0, None), ylim=(0, None))


def _strip_drag(axes: Axes, runs: Sequence[Run], quantity: str, title: str, ylabel: str) -> None:
    frictions = [run["options"]["friction"] for run in runs]
    length_m = runs[0]["options"]["gravity_length_m"]
    grid = np.linspace(0.02, 1.15 * max(frictions), 21)
    of_strip = LENGTH_M, strip_drag.HOLDER_M
    flexible = [strip_drag.flexible_strip_drag(mu, *of_strip) for mu in grid]
    stiff = [
        strip_drag.steady_strip_drag(mu, *of_strip, length_m, holder_angle_rad=None) for mu in grid
    ]
    for drags, colour, style, label in (
        (flexible, FAINT, ":", "no bending rigidity"),
        (stiff, THEORY, "-", f"elastica, gravity length {1e3 * length_m:g} mm"),
    ):
        mm = [1e3 * getattr(drag, quantity) for drag in drags]
        axes.plot(grid, mm, style, color=colour, lw=1.2, label=label)
    measured = _of_runs(runs, quantity, 1e3)
    axes.plot(frictions, measured, "o", color=MEASURED, ms=5, label="simulator")
    axes.set(title=title, xlabel=FRICTION, ylabel=ylabel)
    axes.legend(frameon=False, fontsize=8)


# -- the pushed strip -------------------------------------------------------------------------


@cache
def _slip_curve() -> np.ndarray:
    """Friction coefficient and slip strain, shape (n, 2), up to the flat foot."""
    states = [strip.strip_state_at_foot_angle(angle) for angle in np.linspace(0.02, np.pi / 2, 30)]
    return np.array([[0.0, 0.0], *([state.load_ratio, state.strain] for state in states)])


def _draw_slip_curve(axes: Axes) -> None:
    points = _slip_curve()
    axes.plot(*points.T, color=THEORY, lw=1.3)
    axes.plot([points[-1, 0], 0.65], [points[-1, 1]] * 2, "--", color=THEORY, lw=1.0)
    axes.set(xlim=(0, 0.65), ylim=(0, 0.43), xlabel=FRICTION)


def _reached(run: Run) -> float | None:
    """Strain at which it slipped, else at which its foot lay flat."""
    return run["flat_strain"] if run["slip_strain"] is None else run["slip_strain"]


@styled
def strip_figure(calibration: Mapping[str, Any]) -> Figure:
    """Draw slip strain against friction, and the strip's shape before it slips (paper, Fig. 3)."""
    runs = calibration["strip"]["chosen"]["runs"]
    moduli = sorted({run["young_modulus_Pa"] for run in runs})
    figure = new_figure(9.6, 4.4)
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _draw_slip_curve(left)
    for x, y, regime in (
        (0.06, 0.28, "pinned"), (0.27, 0.17, "slipped"), (0.42, 0.37, "partially slipped")
    ):  # fmt: skip
        left.text(x, y, regime, color=FAINT)
    handles = [Line2D([], [], color=THEORY, lw=1.3, label="theory (Sano et al. 2017)")]
    for index, (modulus, (colour, marker)) in enumerate(zip(moduli, FABRICS, strict=False)):
        for run in runs:
            if run["young_modulus_Pa"] == modulus and (strain := _reached(run)) is not None:
                left.plot(
                    run["friction"], strain, marker, color=colour, ms=6 - 2 * index,
                    mfc="white" if run["slip_strain"] is None else colour, zorder=3 + index,
                )  # fmt: skip
        label = f"simulated, Young's modulus {modulus / 1e9:.3g} GPa"
        handles.append(Line2D([], [], color=colour, marker=marker, lw=0, ms=5, label=label))
    flat: dict[str, Any] = {"mfc": "white", "lw": 0, "ms": 5, "label": "foot lies flat"}
    handles.append(Line2D([], [], color=FAINT, marker="o", **flat))
    left.legend(handles=handles, frameon=False, fontsize=8, loc="lower right")
    left.set(title="Strip pushed on the floor", ylabel="vertical strain ε at slip")
    for place, friction in enumerate(evenly(sorted({run["friction"] for run in runs}))):
        of_friction = [run for run in runs if run["friction"] == friction]
        of_friction.sort(key=lambda run: run["young_modulus_Pa"])
        _shapes(right, 0.62 * place, of_friction)
        right.text(0.62 * place, -0.09, f"µ = {friction:g}", ha="center", fontsize=8)
    right.axhline(0, color=FAINT, lw=0.8)
    right.set_aspect("equal")
    right.set_axis_off()
    right.set(ylim=(-0.12, 1.03), title="Shape just before it slips or lies flat")
    return figure


def _shapes(axes: Axes, at: float, runs: Sequence[Run]) -> None:
    """The strips of one friction coefficient, both bent to the same side, over the elastica."""

    def to_one_side(curve: np.ndarray) -> np.ndarray:
        return (np.sign(curve[np.abs(curve[:, 0]).argmax(), 0]) or 1.0) * curve[:, 0]

    for index, (run, (colour, marker)) in enumerate(zip(runs, FABRICS, strict=False)):
        shape = np.array(run["shape_m"])[:: 1 + len(run["shape_m"]) // 20] / LENGTH_M
        if not len(shape):
            continue
        if index == 0:
            strain = np.clip(run["shape_strain"], 1e-5, _slip_curve()[-1, 1])
            curve = strip.strip_state(strain).curve
            depth = curve[-1, 1] - curve[:, 1]
            axes.plot(at + to_one_side(curve), depth, color=THEORY, lw=1.0, zorder=2)
        axes.plot(
            at + to_one_side(shape), 1 - run["shape_strain"] - shape[:, 1], marker, color=colour,
            ms=3.4 - index, mfc="none", mew=0.8, zorder=3 + index,
        )  # fmt: skip


# -- the settings tried -----------------------------------------------------------------------


@styled
def settings_figure(calibration: Mapping[str, Any]) -> Figure:
    """Draw slip strains with each value of each setting, and the largest errors."""
    trials = calibration["strip"]["trials"]
    base = next(trial for trial in trials if trial["key"] == BASE)
    keys = [key for key in KEYS if any(trial["key"] == key for trial in trials)]
    columns = max(1, len(keys))
    figure = new_figure(max(6.4, 3.3 * columns), 6.2)
    panels = figure.subplots(2, columns, squeeze=False, height_ratios=(1.25, 1))
    demand = calibration["strip"].get("demand", {}).get("slip_strain")
    for (upper, lower), key in zip(panels.T, keys, strict=False):
        tried = [base, *(trial for trial in trials if trial["key"] == key)]
        tried.sort(key=lambda trial: trial["settings"][key])
        _slip_strains(upper, key, tried, base)
        _largest_errors(lower, key, tried, base)
        if demand:
            lower.axhline(demand, color=THEORY, lw=1, ls=":")
    panels[0, 0].set_ylabel("vertical strain ε at slip")
    panels[1, 0].set_ylabel("largest error of ε (dotted: limit)")
    return figure


def _slip_strains(axes: Axes, key: str, tried, base) -> None:
    _draw_slip_curve(axes)
    shades = colormaps["plasma"](np.linspace(0.1, 0.85, len(tried)))
    name, unit = NAMES[key]
    named = evenly(range(len(tried)), 5)
    for index, (shade, trial) in enumerate(zip(shades, tried, strict=True)):
        if trial is base or index in named:
            note = " (configured)" if trial is base else ""
            label = f"{trial['settings'][key]:g} {unit}".strip() + note
            axes.plot([], [], "o", color=shade, ms=4, label=label)
        for run in trial["runs"]:
            right = run["regime"] == run["theory_regime"]
            strain = _reached(run)
            if strain is None:  # not solved, or neither slipped nor flat
                axes.plot(run["friction"], WRONG_AT, "x", color=shade, ms=6, mew=1.5)
                continue
            axes.plot(
                run["friction"], strain, "o" if right else "X", color=shade,
                ms=4 if right else 8, mfc="white" if run["slip_strain"] is None else shade,
            )  # fmt: skip
    axes.set(title=name.capitalize())
    axes.legend(frameon=False, fontsize=7, loc="lower right")


def _largest_errors(axes: Axes, key: str, tried, base) -> None:
    name, unit = NAMES[key]
    for place, trial in enumerate(tried):
        error = trial["strain_error"]
        error = NOTHING_AT if error is None else max(error, 1e-4)
        colour = BLUE if trial["meets"] else MEASURED
        axes.plot(
            place, error, "s" if trial is base else "o", ms=7, color=colour,
            mfc=colour if trial["meets"] else "white",
        )  # fmt: skip
        label = f"{trial['cpu_s']:.0f} s"
        if trial["wrong_regimes"]:
            label += f"\n{trial['wrong_regimes']} of {len(trial['runs'])}\nwrong"
        axes.annotate(
            label, (place, error), xytext=(0, 7), textcoords="offset points", ha="center",
            fontsize=7,
        )  # fmt: skip
    axes.set(yscale="log", ylim=(1e-4, 20.0), xlim=(-0.5, len(tried) - 0.5))
    values = [f"{trial['settings'][key]:g}" for trial in tried]
    axes.set_xticks(range(len(tried)), values, fontsize=8)
    axes.set_xlabel(f"{name}{f', {unit}' if unit else ''}")
