"""Figures of training and testing. Every function returns None without data."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import new_figure, styled
from slipstitch.base.page.palette import BLUE, GREEN, INK, LINE, MEASURED, ORANGE, THEORY
from slipstitch.learning.evaluation.cumulative import draw_cumulative
from slipstitch.learning.evaluation.scores import AVERAGE, TRAINING
from slipstitch.report.results import History

NETWORK_NAMES = {
    "material_baseline": "material",
    "friction_baseline": "friction, baseline",
    "friction_conditional": "friction, given the material",
    TRAINING: "instrument (score in µ)",
    AVERAGE: "instruments averaged",
}
SPLIT_NAMES = {
    "by_video": "by video (the paper's)",
    "by_simulation": "by simulation",
    "by_video_reflective": "by video, mirrors too",
}


def _phase_changes(epochs: Sequence[Mapping[str, Any]]) -> list[float]:
    """Where the schedule goes over to another phase, between two epochs."""
    return [
        0.5 * (before["epoch"] + after["epoch"])
        for before, after in pairwise(epochs)
        if before.get("stage") != after.get("stage")
    ]


@styled
def training(histories: Sequence[History]) -> Figure | None:
    """Loss against epoch, one panel per network and split; chance as a dotted line."""
    if not histories:
        return None
    networks = [
        name for name in NETWORK_NAMES if any(history.network == name for history in histories)
    ]
    splits = list(dict.fromkeys(history.split for history in histories))
    splits.sort(key=lambda name: list(SPLIT_NAMES).index(name) if name in SPLIT_NAMES else 9)
    figure = new_figure(3.2 * len(networks) + 0.4, 2.2 * len(splits) + 0.6)
    panels = figure.subplots(len(splits), len(networks), sharex=True, squeeze=False)
    lines: dict[str, Any] = {}
    for history in histories:
        if history.network not in networks:
            continue
        axes = panels[splits.index(history.split)][networks.index(history.network)]
        epochs = [row["epoch"] for row in history.epochs]
        for key, name, style in (
            ("train_loss", "training", {"color": BLUE}),
            ("validation_loss", "validation", {"color": MEASURED}),
        ):
            values = [row.get(key) for row in history.epochs]
            values = [value if isinstance(value, float) else np.nan for value in values]
            marker = {"marker": "o", "ms": 2.5} if len(epochs) < 40 else {}
            (line,) = axes.plot(epochs, values, lw=1.3, **marker, **style)
            lines.setdefault(name, line)
        chance = history.epochs[0].get("chance_loss")
        if isinstance(chance, float):
            lines["chance"] = axes.axhline(chance, color=THEORY, lw=0.9, ls=":")
        for where in _phase_changes(history.epochs):
            axes.axvline(where, color=LINE, lw=0.8, zorder=0)
    for axes, network in zip(panels[0], networks, strict=True):
        axes.set_title(NETWORK_NAMES[network])
    for row, split in zip(panels, splits, strict=True):
        row[0].set_ylabel(f"{SPLIT_NAMES.get(split, split)}\nloss", fontsize=8)
        for axes in row:
            axes.set_ylim(0, None)
    figure.supxlabel("epoch", fontsize=9)
    figure.legend(
        [*lines.values()], [*lines], loc="outside upper center", ncols=3, frameon=False, fontsize=8
    )
    return figure


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

    Raises
    ------
    BadInput
        If a coefficient is not one of `frictions`.
    """
    counts = np.zeros((len(frictions), len(frictions)), int)
    number = {round(value, 9): index for index, value in enumerate(frictions)}
    for pair in zip(*_friction_rows(predictions, split, network), strict=True):
        for value in pair:
            if round(value, 9) not in number:
                raise BadInput(
                    f"evaluate/predictions.parquet: {network} {split} has friction {value:g}, not "
                    f"one of the configured grid's: {', '.join(f'{one:g}' for one in frictions)}; "
                    "evaluate again, or give the configuration of these results"
                )
        true, predicted = (number[round(value, 9)] for value in pair)
        counts[true, predicted] += 1
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


@styled
def confusions(predictions, frictions: Sequence[float]) -> Figure | None:
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
    figure = new_figure(2.7 * len(networks) + 0.6, 2.6 * len(splits) + 0.3)
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
    return figure


@styled
def cumulative(predictions, frictions: Sequence[float]) -> Figure | None:
    """Share of test videos against the error allowed, with a uniform guess for comparison."""
    splits = [
        name
        for name in SPLIT_NAMES
        if len(_friction_rows(predictions, name, "friction_baseline")[0])
    ]
    if not splits:
        return None
    figure = new_figure(3.9 * len(splits) + 0.3, 2.9)
    panels = figure.subplots(1, len(splits), sharey=True, squeeze=False)[0]
    widest = max(frictions) - min(frictions)
    for axes, split in zip(panels, splits, strict=True):
        for network, colour in (
            ("friction_baseline", BLUE),
            ("friction_conditional", MEASURED),
            (TRAINING, INK),
            (AVERAGE, GREEN),
        ):
            true, predicted = _friction_rows(predictions, split, network)
            if not len(true):
                continue
            draw_cumulative(
                axes, np.abs(predicted - true), widest, color=colour, lw=1.6,
                label=NETWORK_NAMES[network],
            )  # fmt: skip
        true, _ = _friction_rows(predictions, split, "friction_baseline")
        guess = np.abs(np.asarray(frictions)[None, :] - true[:, None]).ravel()
        draw_cumulative(axes, guess, widest, color=THEORY, lw=0.9, ls=":", label="uniform guess")
        axes.set(title=SPLIT_NAMES[split], xlabel="error of µ", xlim=(0, widest), ylim=(0, 1.02))
    panels[0].set_ylabel("share of test videos")
    panels[-1].legend(frameon=False, fontsize=8, loc="lower right")
    return figure


_LINES = {
    "material_baseline": ("fabric, top 1", GREEN),
    "friction_baseline": ("friction, baseline", BLUE),
    "friction_conditional": ("friction, given the material", MEASURED),
    TRAINING: ("instrument", INK),
    AVERAGE: ("instruments averaged", ORANGE),
}


@styled
def accuracy_by_turn(curves: Mapping[tuple[str, str], Mapping[int, Any]]) -> Figure | None:
    """Share of right answers against the camera's turn, with the spread over seeds.

    Parameters
    ----------
    curves : mapping
        (network, metric) -> turn in degrees -> (mean, spread or None).
    """
    figure = new_figure(7.8, 2.9)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    lines = {}
    for axes, metrics in zip(
        panels, (("friction_lt_0.1", "material_top1"), ("friction_lt_0.2",)), strict=True
    ):
        for (network, metric), values in curves.items():
            known = {turn: score for turn, score in values.items() if score[0] is not None}
            if metric not in metrics or not known:
                continue
            name, colour = _LINES[network]
            lines[name] = axes.errorbar(
                list(known), [score[0] for score in known.values()],
                yerr=[score[1] or 0.0 for score in known.values()], color=colour, lw=1.4,
                marker="o", ms=3.5, capsize=2.5, ls="--" if network == "material_baseline" else "-",
            )  # fmt: skip
        axes.set(xlabel="rotation of the camera, degrees", ylim=(0, 1.04))
        axes.set_xticks(sorted({turn for values in curves.values() for turn in values}))
    panels[0].set(title="exact friction class (< 0.1); fabric", ylabel="share of test videos")
    panels[1].set_title("within one friction class (< 0.2)")
    figure.legend(
        [*lines.values()], [*lines], loc="outside upper center", ncols=4, frameon=False, fontsize=8
    )
    return figure


_CURVES = {
    "simulated test set": {"color": BLUE, "lw": 1.5},
    "all captures": {"color": INK, "lw": 1.9},
    "captures without reflective": {"color": GREEN, "lw": 1.3, "ls": "--"},
    "captures, reflective only": {"color": ORANGE, "lw": 1.3, "ls": "-."},
    "all captures, reflective training": {"color": MEASURED, "lw": 1.9, "ls": ":"},
}


@styled
def cumulative_captures(
    panels: Sequence[Mapping[str, Any]], paper_shares: Mapping[str, float]
) -> Figure | None:
    """Share of simulated videos, and of pairs of captures, against the error, a panel a model.

    Parameters
    ----------
    panels : sequence of mapping
        ``title``, and ``curves``: name -> errors, shape (n,).
    paper_shares : mapping
        Name of a curve -> the paper's share of real pairs with an error of 0.1 at most.
    """
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(max(3.0 * columns + 0.3, 7.6), 2.8 * rows + 0.7)
    drawn = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in drawn.flat[len(panels) :]:
        axes.set_axis_off()
    curves = [errors for panel in panels for errors in panel["curves"].values() if len(errors)]
    widest = max(0.3, *(float(errors.max()) for errors in curves))
    lines: dict[str, Any] = {}
    for axes, panel in zip(drawn.flat, panels, strict=False):
        for name, errors in panel["curves"].items():
            if len(errors):
                draw_cumulative(axes, errors, widest, label=name, **_CURVES[name])
        for name, share in paper_shares.items():
            axes.plot(0.1, share, "*", color=_CURVES[name]["color"], ms=8, mec=INK, mew=0.4)
        axes.set(xlim=(0, widest), ylim=(0, 1.02))
        axes.set_title(panel["title"], fontsize=8.5)
        lines |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.supxlabel(
        "error of µ; of captures, distance of a pair’s median from the reference’s interval",
        fontsize=9,
    )
    figure.supylabel("share of videos; of captures, of pairs", fontsize=9)
    figure.legend(
        [*lines.values()], [*lines], loc="outside upper center", ncols=3, frameon=False, fontsize=8
    )
    return figure
