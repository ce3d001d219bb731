"""Figures of training and testing. Every function returns None without data."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipstitch.base.page import palette
from slipstitch.base.page.figures import legend_above, new_figure, styled
from slipstitch.base.page.wording import evenly
from slipstitch.learning.evaluation.paper import draw_cumulative
from slipstitch.report.results import History
from slipstitch.report.scores import NETWORK_TITLES, SPLIT_NAMES

MOST_MARKS = 400


@styled
def predicted_against_true(
    rows: Sequence[Mapping[str, Any]], materials: Mapping[str, str]
) -> Figure | None:
    """Predicted against true friction, a mark a video of one network and split with its interval.

    `materials` has the name of a fabric by its id.
    """
    if not rows:
        return None
    marks = pandas.DataFrame(evenly(rows, MOST_MARKS))
    ends = marks[["true_value", "predicted_value"]].to_numpy(float)
    low, high = ends.min(), ends.max()
    margin = max(0.08 * (high - low), 0.02)
    line = np.array([low - margin, high + margin])
    figure = new_figure(5.2, 3.7)
    axes = figure.subplots()
    axes.fill_between(line, line - 0.1, line + 0.1, color=palette.INTERVAL, lw=0)
    axes.plot(line, line, color=palette.THEORY, lw=0.9)
    fabrics = marks.groupby(marks["simulation"].str.partition("_")[0])
    for number, (name, own) in enumerate(fabrics):
        # Fabrics side by side, and the videos of each in order: marks of one class do not hide.
        spread = (np.arange(len(own)) / max(len(own) - 1, 1) - 0.5) * 0.7 + number
        place = own["true_value"].to_numpy(float) + margin * ((spread + 0.5) / len(fabrics) - 0.5)
        colour = palette.SERIES[number % len(palette.SERIES)]
        limits = own[["low", "high"]].to_numpy(float)
        for x, interval in zip(place, limits, strict=True):
            axes.plot([x, x], interval, color=colour, lw=0.8, alpha=0.45)
        label = materials.get(name, name)
        axes.plot(place, own["predicted_value"], "o", color=colour, ms=3.6, mew=0, label=label)
    axes.set(xlim=line, ylim=line, xlabel="true µ", ylabel="predicted µ")
    if len(fabrics) > 1:
        legend_above(figure, dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)), 3)
    return figure


def _draw_history(axes: Axes, history: History, lines: dict[str, Any]) -> None:
    """Loss against epoch of one network; chance as a dotted line."""
    known = ("epoch", "train_loss", "validation_loss", "chance_loss", "stage")
    epochs = history.epochs.reindex(columns=known)
    numbers = epochs[[*known[:-1]]].apply(pandas.to_numeric, errors="coerce")
    for key, colour in (("train_loss", palette.BLUE), ("validation_loss", palette.MEASURED)):
        marker = "o" if len(epochs) < 40 else None
        style: Any = {"lw": 1.3, "color": colour, "marker": marker, "ms": 2.5}
        (line,) = axes.plot(numbers["epoch"], numbers[key], **style)
        lines.setdefault(key.split("_")[0].replace("train", "training"), line)
    if np.isfinite(chance := numbers["chance_loss"].iloc[0]):
        lines["chance"] = axes.axhline(chance, color=palette.THEORY, lw=0.9, ls=":")
    changed = epochs["stage"].fillna("").ne(epochs["stage"].fillna("").shift()).iloc[1:]
    for number in numbers["epoch"].iloc[1:][changed]:  # another phase of the schedule
        axes.axvline(number - 0.5, color=palette.LINE, lw=0.8, zorder=0)


@styled
def training(histories: Sequence[History]) -> Figure | None:
    """Loss against epoch, one panel per network and split."""
    networks = [name for name in NETWORK_TITLES if any(one.network == name for one in histories)]
    if not networks:
        return None
    splits = [name for name in SPLIT_NAMES if any(one.split == name for one in histories)]
    figure = new_figure(2.5 * len(networks) + 0.4, 1.8 * len(splits) + 0.6)
    panels = figure.subplots(len(splits), len(networks), sharex="col", squeeze=False)
    lines: dict[str, Any] = {}
    for history in histories:
        if history.network in networks:
            place = splits.index(history.split), networks.index(history.network)
            _draw_history(panels[place], history, lines)
    for axes, network in zip(panels[0], networks, strict=True):
        axes.set_title(NETWORK_TITLES[network])
    for row, split in zip(panels, splits, strict=True):
        row[0].set_ylabel(f"{SPLIT_NAMES[split]}\nloss", fontsize=8)
        for axes in row:
            axes.set_ylim(0, None)
    figure.supxlabel("epoch", fontsize=9)
    legend_above(figure, lines)
    return figure


def _draw_confusion(axes: Axes, counts: np.ndarray, labels: Sequence[str]) -> None:
    """Counts of (true, predicted) classes; rows are true, darker is a larger share of the row."""
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0)
    are_names = max(map(len, labels)) > 4
    few = evenly(range(len(labels)), 10 if are_names else 6)
    names = [labels[place] for place in few]
    axes.set_xticks(few, names, fontsize=7, rotation=90 if are_names else 0)
    axes.set_yticks(few, names, fontsize=7)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    if len(labels) <= 8:
        style: Any = {"ha": "center", "va": "center", "fontsize": 8}
        for (row, column), count in np.ndenumerate(counts):
            colour = "white" if shares[row, column] > 0.55 else palette.INK
            axes.text(column, row, str(count), color=colour, **style)


@styled
def confusions(details: Mapping[str, Any]) -> Figure | None:
    """True against predicted classes: fabrics and coefficients, a row a split."""
    found = {
        (split, network): of_network
        for split in SPLIT_NAMES
        for network in NETWORK_TITLES
        if (of_network := details.get(split, {}).get(network, {})).get("confusion")
    }
    if not found:
        return None
    splits = [name for name in SPLIT_NAMES if any(split == name for split, _ in found)]
    networks = [name for name in NETWORK_TITLES if any(network == name for _, network in found)]
    figure = new_figure(2.7 * len(networks) + 0.6, 2.5 * len(splits) + 0.3)
    panels = figure.subplots(len(splits), len(networks), squeeze=False)
    for (row, column), axes in np.ndenumerate(panels):
        split, network = splits[row], networks[column]
        of_network = found.get((split, network))
        if of_network is None:
            axes.set_axis_off()
            continue
        labels = [one.get("name") or f"{one['value']:g}" for one in of_network["classes"]]
        _draw_confusion(axes, np.array(of_network["confusion"]), labels)
        axes.set_title(NETWORK_TITLES[network])
        axes.set_xlabel("predicted", fontsize=8)
        axes.set_ylabel(f"{SPLIT_NAMES[split]}\ntrue" if column == 0 else "", fontsize=8)
    return figure


CURVES = {
    "simulated test set": {"color": palette.BLUE, "lw": 1.5},
    "all captures": {"color": palette.INK, "lw": 1.9},
    "captures without reflective": {"color": palette.GREEN, "lw": 1.3, "ls": "--"},
    "captures, reflective only": {"color": palette.ORANGE, "lw": 1.3, "ls": "-."},
    "all captures, reflective training": {"color": palette.MEASURED, "lw": 1.9, "ls": ":"},
    "uniform guess": {"color": palette.THEORY, "lw": 0.9, "ls": ":"},
}


@styled
def cumulative(
    panels: Mapping[str, Mapping[str, np.ndarray]], paper_shares: Mapping[str, float]
) -> Figure | None:
    """Share of videos, or of pairs of captures, against the error allowed: a panel a model.

    `paper_shares` has the paper's share of real pairs with an error of 0.1 at most, by curve.
    """
    errors = [off for curves in panels.values() for off in curves.values() if len(off)]
    if not errors:
        return None
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(max(3.0 * columns + 0.3, 6.4), 2.6 * rows + 0.7)
    drawn = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in drawn.flat[len(panels) :]:
        axes.set_axis_off()
    widest = max(0.3, *(float(off.max()) for off in errors))
    lines: dict[str, Any] = {}
    for axes, (title, curves) in zip(drawn.flat, panels.items(), strict=False):
        for name, off in curves.items():
            if len(off):
                draw_cumulative(axes, off, widest, label=name, **CURVES[name])
        for name, share in paper_shares.items() if "all captures" in curves else ():
            axes.plot(0.1, share, "*", color=CURVES[name]["color"], ms=8, mec=palette.INK, mew=0.4)
        axes.set(xlim=(0, widest), ylim=(0, 1.02))
        axes.set_title(title, fontsize=8.5)
        lines |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.supxlabel("error of µ", fontsize=9)
    figure.supylabel("share", fontsize=9)
    legend_above(figure, lines, 3)
    return figure
