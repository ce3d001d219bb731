"""The report's figures. Every function returns an SVG as text, or None where there is nothing."""

import io
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipstitch.calibrate.picture import FAINT, MEASURED, THEORY, calibration_figure
from slipstitch.calibrate.strip_picture import settings_figure, strip_figure
from slipstitch.convergence.picture import convergence_figure
from slipstitch.report.results import Benchmark, History, Trajectory

INK = "#23262b"
# Okabe & Ito 2008, as are the colours of the calibration.
BLUE, GREEN, ORANGE, PINK = "#0072B2", "#009E73", "#E69F00", "#CC79A7"
NETWORK_NAMES = {
    "material_baseline": "material",
    "friction_baseline": "friction, baseline",
    "friction_conditional": "friction, given the material",
    "instrument": "instrument (score in µ)",
}
SPLIT_NAMES = {"by_video": "by video (the paper's)", "by_simulation": "by simulation"}

STYLE = {
    "svg.hashsalt": "slipstitch",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "axes.edgecolor": "#b8b6b0",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": "#5b5e63",
    "ytick.color": "#5b5e63",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "path.simplify": True,
}


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _styled(function):
    """Apply the style while the figure is drawn, not only while it is saved."""

    def draw(*arguments, **options):
        with matplotlib.rc_context(STYLE):
            return function(*arguments, **options)

    draw.__doc__ = function.__doc__
    draw.__name__ = function.__name__
    return draw


def friction_colour(friction: float, frictions: Sequence[float]):
    """Colour of a friction coefficient among those of the grid: dark is smooth."""
    share = 0.5 if len(frictions) < 2 else list(frictions).index(friction) / (len(frictions) - 1)
    return matplotlib.colormaps["viridis"](0.88 * share)


@_styled
def calibration(data: Mapping[str, Any]) -> str:
    """Measured against theory, a panel an experiment."""
    return _svg(calibration_figure(data))


@_styled
def strip(data: Mapping[str, Any]) -> str:
    """Slip strain and shapes of the pushed strip, over theory."""
    return _svg(strip_figure(data))


@_styled
def settings(data: Mapping[str, Any]) -> str:
    """The pushed strip with one numerical setting changed at a time."""
    return _svg(settings_figure(data))


@_styled
def convergence(study: Mapping[str, Any]) -> str:
    """Distance from the finest runs over time."""
    return _svg(convergence_figure(study))


# What the profiles show: the paper's protocol (Sec. 4.1) lowers for 7 s, each stroke takes 31 s.
MOMENTS = (
    (7.0, "lowered", "#9a9a9a"),
    (12.0, "forward, starting", BLUE),
    (37.5, "forward, steady", GREEN),
    (43.0, "back, starting", ORANGE),
    (68.5, "back, steady", PINK),
)


@_styled
def profiles(trajectories: Sequence[Trajectory]) -> str | None:
    """Side views: the line down the middle of each cloth at some moments, seen with the stage.

    Parameters
    ----------
    trajectories : sequence of Trajectory
        One for each material and friction coefficient that is to be shown.
    """
    if not trajectories:
        return None
    materials = list(dict.fromkeys(one.simulation.material for one in trajectories))
    frictions = sorted({one.simulation.friction for one in trajectories})
    width = max(2.25 * len(frictions) + 0.3, 7.0)
    figure = _figure(width, 1.75 * len(materials) + 0.5)
    panels = figure.subplots(
        len(materials), len(frictions), sharex=True, sharey=True, squeeze=False
    )
    reach = max(float(np.abs(one.centre_m[:, :, 0]).max()) for one in trajectories)
    reach = 1e3 * min(reach, 0.2) + 8
    used = {}
    drawn = {(one.simulation.material, one.simulation.friction) for one in trajectories}
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
    for one in trajectories:
        axes = panels[materials.index(one.simulation.material)][
            frictions.index(one.simulation.friction)
        ]
        for moment, name, colour in MOMENTS:
            if moment > one.time_s[-1] + 0.5:
                continue
            frame = int(np.argmin(np.abs(one.time_s - moment)))
            (line,) = axes.plot(
                1e3 * one.centre_m[frame, :, 0], 1e3 * one.centre_m[frame, :, 1], color=colour,
                lw=1.6, solid_capstyle="round",
            )  # fmt: skip
            used.setdefault(f"{name} ({one.time_s[frame]:.0f} s)", line)
    for axes, friction in zip(panels[0], frictions, strict=True):
        axes.set_title(f"µ = {friction:g}")
    for row, material in zip(panels, materials, strict=True):
        row[0].set_ylabel(f"{material}\nheight, mm", fontsize=8)
    figure.supxlabel("ahead of the clamps, mm", fontsize=8)
    figure.legend(
        used.values(), used.keys(), loc="outside upper center", ncols=5 if width > 9 else 3,
        frameon=False, fontsize=8,
    )  # fmt: skip
    return _svg(figure)


@_styled
def tails(trajectories: Sequence[Trajectory]) -> str | None:
    """Where the lower edge is, relative to the clamps, over time: what a camera can read.

    Parameters
    ----------
    trajectories : sequence of Trajectory
        All replicates of all materials and coefficients.
    """
    if not trajectories:
        return None
    materials = list(dict.fromkeys(one.simulation.material for one in trajectories))
    frictions = sorted({one.simulation.friction for one in trajectories})
    columns = min(3, len(materials))
    rows = math.ceil(len(materials) / columns)
    figure = _figure(max(3.2 * columns + 0.6, 6.0), 2.3 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[len(materials) :]:
        axes.set_axis_off()
    lines = {}
    for one in trajectories:
        axes = panels.flat[materials.index(one.simulation.material)]
        (line,) = axes.plot(
            one.time_s, 1e3 * one.centre_m[:, -1, 0], lw=1.1, alpha=0.9,
            color=friction_colour(one.simulation.friction, frictions),
        )  # fmt: skip
        lines.setdefault(f"µ = {one.simulation.friction:g}", line)
    for axes, material in zip(panels.flat, materials, strict=False):
        axes.axhline(0.0, color=FAINT, lw=0.6)
        axes.set_title(material)
    figure.supxlabel("time, s", fontsize=9)
    figure.supylabel("lower edge ahead of the clamps, mm", fontsize=9)
    order = sorted(lines, key=lambda name: float(name.split("=")[1]))
    figure.legend(
        [lines[name] for name in order], order, loc="outside upper center",
        ncols=min(8, len(order)), frameon=False, fontsize=8,
    )  # fmt: skip
    return _svg(figure)


def _fine_tuning(epochs: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """Where the schedule changes: (last epoch before, name of what follows)."""
    return [
        (0.5 * (before["epoch"] + after["epoch"]), str(after["stage"]))
        for before, after in pairwise(epochs)
        if before.get("stage") != after.get("stage")
    ]


@_styled
def training(histories: Sequence[History]) -> str | None:
    """Loss against epoch, a panel a network and split; chance as a dotted line."""
    if not histories:
        return None
    networks = [name for name in NETWORK_NAMES if any(one.network == name for one in histories)]
    splits = list(dict.fromkeys(one.split for one in histories))
    splits.sort(key=lambda name: list(SPLIT_NAMES).index(name) if name in SPLIT_NAMES else 9)
    figure = _figure(3.2 * len(networks) + 0.4, 2.2 * len(splits) + 0.6)
    panels = figure.subplots(len(splits), len(networks), sharex=True, squeeze=False)
    lines = {}
    for one in histories:
        if one.network not in networks:
            continue
        axes = panels[splits.index(one.split)][networks.index(one.network)]
        epochs = [row["epoch"] for row in one.epochs]
        for key, name, style in (
            ("train_loss", "training", {"color": BLUE}),
            ("validation_loss", "validation", {"color": MEASURED}),
        ):
            values = [row.get(key) for row in one.epochs]
            values = [value if isinstance(value, float) else np.nan for value in values]
            marker = {"marker": "o", "ms": 2.5} if len(epochs) < 40 else {}
            (line,) = axes.plot(epochs, values, lw=1.3, **marker, **style)
            lines.setdefault(name, line)
        chance = one.epochs[0].get("chance_loss")
        if isinstance(chance, float):
            lines["chance"] = axes.axhline(chance, color=THEORY, lw=0.9, ls=":")
        for where, _ in _fine_tuning(one.epochs):
            axes.axvline(where, color="#dddbd4", lw=0.8, zorder=0)
    for axes, network in zip(panels[0], networks, strict=True):
        axes.set_title(NETWORK_NAMES[network])
    for row, split in zip(panels, splits, strict=True):
        row[0].set_ylabel(f"{SPLIT_NAMES.get(split, split)}\nloss", fontsize=8)
        for axes in row:
            axes.set_ylim(0, None)
    figure.supxlabel("epoch", fontsize=9)
    figure.legend(
        lines.values(), lines.keys(), loc="outside upper center", ncols=3, frameon=False, fontsize=8
    )
    return _svg(figure)


def _friction_rows(predictions, split: str, network: str) -> tuple[np.ndarray, np.ndarray]:
    rows = [row for row in predictions or () if row["split"] == split and row["network"] == network]
    return (
        np.array([row["true_value"] for row in rows], float),
        np.array([row["predicted_value"] for row in rows], float),
    )


def confusion_counts(
    predictions, split: str, network: str, frictions: Sequence[float]
) -> np.ndarray:
    """Counts of (true, predicted) friction coefficients; rows are true.

    Returns
    -------
    ndarray of int, shape (len(frictions), len(frictions))
    """
    counts = np.zeros((len(frictions), len(frictions)), int)
    number = {round(value, 9): index for index, value in enumerate(frictions)}
    for true, predicted in zip(*_friction_rows(predictions, split, network), strict=True):
        counts[number[round(true, 9)], number[round(predicted, 9)]] += 1
    return counts


def _draw_confusion(axes: Axes, counts: np.ndarray, frictions: Sequence[float]) -> None:
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0)
    labels = [f"{value:g}" for value in frictions]
    axes.set_xticks(range(len(labels)), labels, fontsize=7.5)
    axes.set_yticks(range(len(labels)), labels, fontsize=7.5)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    if len(frictions) <= 8:
        for (row, column), count in np.ndenumerate(counts):
            axes.text(
                column, row, str(count), ha="center", va="center", fontsize=8,
                color="white" if shares[row, column] > 0.55 else INK,
            )  # fmt: skip


@_styled
def confusions(predictions, frictions: Sequence[float]) -> str | None:
    """True against predicted friction, for both splits and both friction networks."""
    networks = ("friction_baseline", "friction_conditional")
    found = [
        (split, network, confusion_counts(predictions, split, network, frictions))
        for split in SPLIT_NAMES
        for network in networks
    ]
    found = [item for item in found if item[2].sum()]
    if not found:
        return None
    splits = [name for name in SPLIT_NAMES if any(item[0] == name for item in found)]
    figure = _figure(2.7 * len(networks) + 0.6, 2.6 * len(splits) + 0.3)
    panels = figure.subplots(len(splits), len(networks), squeeze=False)
    for axes in panels.flat:
        axes.set_axis_off()
    for split, network, counts in found:
        axes = panels[splits.index(split)][networks.index(network)]
        axes.set_axis_on()
        _draw_confusion(axes, counts, frictions)
        axes.set_title(NETWORK_NAMES[network])
        if network == networks[0]:
            axes.set_ylabel(f"{SPLIT_NAMES[split]}\ntrue µ", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("predicted µ", fontsize=8)
    return _svg(figure)


def cumulative_error(true: np.ndarray, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct errors in increasing order, and the share of videos with at most that error."""
    errors = np.round(np.abs(predicted - true), 9)
    values, counts = np.unique(errors, return_counts=True)
    return values, np.cumsum(counts) / len(errors)


@_styled
def cumulative(predictions, frictions: Sequence[float]) -> str | None:
    """Share of test videos against the error allowed, with a uniform guess for comparison."""
    splits = [
        name
        for name in SPLIT_NAMES
        if len(_friction_rows(predictions, name, "friction_baseline")[0])
    ]
    if not splits:
        return None
    figure = _figure(3.9 * len(splits) + 0.3, 2.9)
    panels = figure.subplots(1, len(splits), sharey=True, squeeze=False)[0]
    widest = max(frictions) - min(frictions)
    for axes, split in zip(panels, splits, strict=True):
        for network, colour in (
            ("friction_baseline", BLUE),
            ("friction_conditional", MEASURED),
            ("instrument", INK),
        ):
            true, predicted = _friction_rows(predictions, split, network)
            if not len(true):
                continue
            errors, shares = cumulative_error(true, predicted)
            axes.step(
                [0, *errors, widest], [0, *shares, 1.0], where="post", color=colour, lw=1.6,
                label=NETWORK_NAMES[network],
            )  # fmt: skip
        true, _ = _friction_rows(predictions, split, "friction_baseline")
        guess = np.abs(np.asarray(frictions)[None, :] - true[:, None]).ravel()
        errors, shares = cumulative_error(np.zeros_like(guess), guess)
        axes.step(
            [0, *errors, widest], [0, *shares, 1.0], where="post", color=THEORY, lw=0.9, ls=":",
            label="uniform guess",
        )  # fmt: skip
        axes.set(title=SPLIT_NAMES[split], xlabel="error of µ", xlim=(0, widest), ylim=(0, 1.02))
    panels[0].set_ylabel("share of test videos")
    panels[-1].legend(frameon=False, fontsize=8, loc="lower right")
    return _svg(figure)


@_styled
def costs(benchmarks: Sequence[Benchmark]) -> str | None:
    """CPU and wall time of every stage."""
    if not benchmarks:
        return None
    figure = _figure(7.6, 0.42 * len(benchmarks) + 0.7)
    axes = figure.subplots()
    places = np.arange(len(benchmarks))[::-1]
    cpu = [one.cpu_s / 60 for one in benchmarks]
    wall = [one.wall_s / 60 for one in benchmarks]
    axes.barh(places + 0.17, cpu, height=0.32, color=BLUE, label="CPU time")
    axes.barh(places - 0.17, wall, height=0.32, color="#b9d3e6", label="wall time, jobs added up")
    axes.set_yticks(places, [one.stage for one in benchmarks])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("minutes")
    axes.legend(frameon=False, fontsize=8)
    return _svg(figure)
