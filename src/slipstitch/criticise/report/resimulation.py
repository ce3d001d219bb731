"""Before and after: measured shapes beside the cloth simulator's, with null and extended law."""

from __future__ import annotations

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from slipstitch.criticise.report.pictures import EXTENDED_COLOUR, FAINT, INK, NULL_COLOUR, svg
from slipstitch.criticise.resimulation import Resimulation

SHOWN_RUNS = 3
COLOURS = {"null": NULL_COLOUR, "extended": EXTENDED_COLOUR}
LABELS = {"null": "plain Coulomb", "extended": "extended law"}


def before_and_after(again: Resimulation) -> str:
    """The page's section, as HTML."""
    summary = again.summary
    rows = "".join(
        f"<tr><td>{title}</td><td class=n>{entry['rmse_null_mm']:.2f}</td>"
        f"<td class=n>{entry['rmse_extended_mm']:.2f}</td>"
        f"<td class=n>{100 * entry['gain']:.0f} % {_interval(entry)}</td></tr>"
        for title, entry in (
            ("trailing edge", summary["quantities"]["te_x_mm"]),
            ("contact length", summary["quantities"]["contact_len_mm"]),
            ("both", summary["all"]),
        )
    )
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch", "font.size": 10}):
        picture = svg(_figure(again.frames))
    return f"""<h2>The drop-and-drag runs, simulated again</h2>
<p>The measured runs in the cloth simulator, once with plain Coulomb friction and once with the
verdict's model; every parameter is the verdict's, none was fitted to these simulations.</p>
<figure>{picture}<figcaption>Three of the runs: how far the trailing edge lags behind the stage, and
the length on the floor. Points: measured.</figcaption></figure>
<table><tr><th>error (mm, root mean square)</th><th>plain Coulomb</th><th>extended</th>
<th>fall of the mean square [95 % over {summary["all"]["specimens"]} specimens]</th></tr>{rows}
</table>"""


def _interval(entry: dict) -> str:
    if entry["gain_ci95"] is None:
        return ""
    low, high = entry["gain_ci95"]
    return f"[{100 * low:.0f}, {100 * high:.0f}]"


def _figure(frames: pd.DataFrame) -> Figure:
    change = (frames["te_x_mm_null"] - frames["te_x_mm_extended"]).abs()
    order = change.groupby(frames["run_id"]).mean().sort_values(kind="stable").index
    chosen = [order[i] for i in np.linspace(len(order) - 1, 0, SHOWN_RUNS).astype(int)]
    figure = Figure(figsize=(7.2, 4.2))
    panels = figure.subplots(2, SHOWN_RUNS, sharex=True, sharey="row", squeeze=False)
    for column, run in enumerate(chosen):
        own = frames[frames["run_id"] == run].sort_values("x_stage_mm")
        stage = own["x_stage_mm"].to_numpy()
        for row, quantity in enumerate(("te_x_mm", "contact_len_mm")):
            axes = panels[row, column]
            base = stage if quantity == "te_x_mm" else 0.0
            sign = -1.0 if quantity == "te_x_mm" else 1.0
            axes.plot(stage, base + sign * own[quantity], ".", color=FAINT, ms=4)
            for name, colour in COLOURS.items():
                values = base + sign * own[f"{quantity}_{name}"]
                axes.plot(stage, values, color=colour, lw=1.4, label=LABELS[name])
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
            axes.tick_params(colors=INK, labelsize=8)
        panels[0, column].set_title(f"run {run}", fontsize=9, color=INK)
        panels[1, column].set_xlabel("stage (mm)", fontsize=9, color=INK)
    panels[0, 0].set_ylabel("lag of the edge (mm)", fontsize=9, color=INK)
    panels[1, 0].set_ylabel("contact length (mm)", fontsize=9, color=INK)
    panels[0, 0].legend(frameon=False, fontsize=8, loc="lower right")
    figure.tight_layout()
    return figure
