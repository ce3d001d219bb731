"""Physics section of the report: checks against theory, convergence, the simulations."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from slipstitch.base.page.figures import legend_above, new_figure, styled, svg_uri
from slipstitch.base.page.palette import BLUE, FAINT, GREEN, ORANGE, PINK, SOFT, THEORY
from slipstitch.base.page.wording import counted, evenly, quantity
from slipstitch.design.grid import simulations
from slipstitch.physics.simulation.convergence import studied_settings_that_differ
from slipstitch.report.cost import benchmarks
from slipstitch.report.results import Results, SimulationSummary, Table

MOST_FRICTIONS_SHOWN = 6
# What the profiles show: the paper's protocol (Sec. 4.1) lowers for 7 s, each stroke takes 31 s.
MOMENTS = (
    (7.0, "lowered", "#9a9a9a"),
    (12.0, "forward, starting", BLUE),
    (37.5, "forward, steady", GREEN),
    (43.0, "back, starting", ORANGE),
    (68.5, "back, steady", PINK),
)


def physics(results: Results) -> dict[str, Any] | None:
    """Checks against theory, figures of them, and the settings; None without a calibration."""
    calibration = results.json("calibrate", "calibration.json")
    if calibration is None:
        return None
    checks, strip = calibration["checks"], calibration.get("strip")
    settings = calibration.get("settings", {})
    return {
        "met": sum(check["met"] for check in checks),
        "checks": len(checks),
        "table": _checks(checks),
        "settings": {name: value for name, value in settings.items() if value is not None},
        "figures": {
            name: results.picture("calibrate", f"{name}.png")
            for name in ("calibration", "strip", "settings")
        },
        "not_told": [line.partition(":")[0] for line in strip["not_told"]] if strip else [],
    }


def _checks(checks: Sequence[Mapping[str, Any]]) -> Table:
    """Of every kind of check the one nearest to its limit; of those not met, all."""
    kinds: dict[str, list[Mapping[str, Any]]] = {}
    for check in checks:
        kinds.setdefault(check["name"], []).append(check)
    rows = []
    for name, own in kinds.items():
        missed = [check for check in own if not check["met"]]
        met = f"{len(own) - len(missed)} of {len(own)}"
        for check in missed or [max(own, key=lambda one: one["error"])]:
            scale, unit = (100.0, "%") if check["relative"] else (1.0, check.get("unit", ""))
            scale, unit = (1e3, "mm") if unit == "m" else (scale, unit)
            limits = [quantity(check[key], scale, unit, 2) for key in ("error", "demand")]
            rows.append([name.replace("-", " "), met, *limits])
    return ["check", "met", "largest error", "allowed"], rows


def convergence(results: Results) -> dict[str, Any] | None:
    """Whether results depend on time step and mesh: counts, and what is not converged."""
    study = results.convergence()
    if study is None:
        return None
    verdicts: dict[str, Counter] = {}
    rows = []
    for row, kind in product(study["summary"], ("time_step", "mesh")):
        if (found := row[kind]) is None:
            continue
        against = _refinement(kind, found.get("finest", ""))
        verdict = found["verdict"].partition(" (")[0]
        verdicts.setdefault(against, Counter())[verdict] += 1
        if verdict == "not converged":
            errors = [found[name] for name in ("mean_m", "mean_largest_m", "worst_m")]
            cells = [quantity(error, 1e3, "mm", 2) for error in errors]
            events = quantity(found["event_shift_s"], 1.0, "s", 2)
            events += "".join(f"; {name} in one only" for name in found["events_missing"])
            rows.append([f"{row['material']} {row['friction']:g}", against, *cells, events])
    chosen = (results.json("calibrate", "calibration.json") or {}).get("settings", {})
    simulated_with = results.config.simulation.model_copy(update=chosen)
    demand_m = study["settings"]["convergence"]["mean_distance_m"]
    head = ["not converged", "against", "mean", "at worst time", "worst vertex", "events apart"]
    return {
        "figure": results.picture("convergence", "convergence.png")
        or results.picture("published", "convergence", "convergence.png"),
        "table": (head, rows),
        "counted": [
            f"{counted(counts.total(), 'comparison')} with {against}: "
            + ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
            for against, counts in verdicts.items()
        ],
        "window_s": study["settings"]["convergence"]["window_s"],
        "demand": quantity(demand_m, 1e3, "mm", 2),
        "missing": study.get("missing", []),
        "other_settings": studied_settings_that_differ(study["settings"], simulated_with),
    }


def _refinement(kind: str, finest: str) -> str:
    """Description of the finest run of a kind, from its id such as m05_f0300_n61_h0."""
    side, _, halvings = finest.partition("_n")[2].partition("_h")
    if not halvings:
        return f"finest {kind.replace('_', ' ')}"
    return f"{side} vertices per side" if kind == "mesh" else f"time step over {2 ** int(halvings)}"


def simulation_section(results: Results) -> dict[str, Any]:
    """Numbers and figures of the simulations that are there."""
    planned, done = simulations(results.config), results.simulated()
    frictions = evenly(results.config.grid.frictions, MOST_FRICTIONS_SHOWN)
    runs = list(results.trajectories([one for one in done if one.friction in frictions]))
    residual, tolerance = results.largest_residual()
    costs = {stage.stage: stage.cpu_median_s for stage in benchmarks(results.folder)}
    return {
        "planned": len(planned),
        "done": len(done),
        "missing": [simulation.id for simulation in planned if simulation not in done],
        "profiles": svg_uri(profiles(runs)),
        "tails": svg_uri(tails(runs)),
        "residual": residual,
        "tolerance": tolerance,
        "cpu_median": costs.get("simulate"),
        "duration": max((float(run.time_s[-1]) for run in runs), default=None),
    }


def _labels(trajectories: Sequence[SimulationSummary]) -> tuple[list[str], list[float]]:
    """Fabrics in their order, friction coefficients from the lowest on."""
    materials = dict.fromkeys(run.simulation.material for run in trajectories)
    return list(materials), sorted({run.simulation.friction for run in trajectories})


@styled
def profiles(trajectories: Sequence[SimulationSummary]) -> Figure | None:
    """Side views: the line down the middle of each cloth at some moments, seen with the stage."""
    if not trajectories:
        return None
    materials, frictions = _labels(trajectories)
    drawn: dict[tuple[str, float], SimulationSummary] = {}
    for run in trajectories:  # of replicates the first
        drawn.setdefault((run.simulation.material, run.simulation.friction), run)
    figure = new_figure(max(2.25 * len(frictions) + 0.3, 7.0), 1.75 * len(materials) + 0.5)
    shared: Any = {"sharex": True, "sharey": True, "squeeze": False}
    panels = figure.subplots(len(materials), len(frictions), **shared)
    reach = max(float(np.abs(run.centre_m[:, :, 0]).max()) for run in drawn.values())
    reach = 1e3 * min(reach, 0.2) + 8
    used: dict[str, Any] = {}
    for (row, column), axes in np.ndenumerate(panels):
        axes.set_aspect("equal")
        axes.axhline(0.0, color=THEORY, lw=0.8)
        axes.set(xlim=(-reach, reach), ylim=(-8, 175), xticks=[-100, 0, 100], yticks=[0, 100])
        axes.tick_params(length=2, labelsize=7.5)
        axes.spines[["left", "bottom"]].set_visible(False)
        shown = drawn.get((materials[row], frictions[column]))
        if shown is None:
            axes.text(0.0, 80.0, "not run", ha="center", color=SOFT, fontsize=8)
            continue
        for moment, name, colour in MOMENTS:
            if moment <= shown.time_s[-1] + 0.5:
                frame = int(np.argmin(np.abs(shown.time_s - moment)))
                (line,) = axes.plot(*(1e3 * shown.centre_m[frame].T), color=colour, lw=1.6)
                used.setdefault(f"{name} ({shown.time_s[frame]:.0f} s)", line)
    for axes, friction in zip(panels[0], frictions, strict=True):
        axes.set_title(f"µ = {friction:g}")
    for axes, material in zip(panels[:, 0], materials, strict=True):
        axes.set_ylabel(f"{material}\nheight, mm", fontsize=8)
    figure.supxlabel("ahead of the clamps, mm", fontsize=8)
    legend_above(figure, used, 5 if len(frictions) > 3 else 3)
    return figure


@styled
def tails(trajectories: Sequence[SimulationSummary]) -> Figure | None:
    """Position of the lower edge relative to the clamps over time: the main visual cue."""
    if not trajectories:
        return None
    materials, frictions = _labels(trajectories)
    columns = min(3, len(materials))
    rows = math.ceil(len(materials) / columns)
    figure = new_figure(max(3.2 * columns + 0.6, 6.0), 2.3 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[len(materials) :]:
        axes.set_axis_off()
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, len(frictions)))
    lines: dict[float, Any] = {}
    for run in trajectories:
        axes = panels.flat[materials.index(run.simulation.material)]
        friction = run.simulation.friction
        ahead_mm, colour = 1e3 * run.centre_m[:, -1, 0], colours[frictions.index(friction)]
        (lines[friction],) = axes.plot(run.time_s, ahead_mm, lw=1, color=colour)
    for axes, material in zip(panels.flat, materials, strict=False):
        axes.axhline(0.0, color=FAINT, lw=0.6)
        axes.set_title(material)
    figure.supxlabel("time, s", fontsize=9)
    figure.supylabel("lower edge ahead of the clamps, mm", fontsize=9)
    legend_above(figure, {f"µ = {one:g}": lines[one] for one in evenly(frictions)}, 6)
    return figure
