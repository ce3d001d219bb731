"""Before and after: measured shapes beside the cloth simulator's, with null and extended law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from slipstitch.base.page.figures import new_figure, plain_text, styled, svg_element
from slipstitch.base.page.palette import FAINT
from slipstitch.base.page.wording import percent, with_interval
from slipstitch.criticise.report.verdict_pictures import EXTENDED_COLOUR, NULL_COLOUR
from slipstitch.criticise.resimulation import Resimulation

SHOWN_RUNS = 3
COLOURS = {"null": NULL_COLOUR, "extended": EXTENDED_COLOUR}
LABELS = {"null": "plain Coulomb", "extended": "extended law"}


def before_and_after(again: Resimulation) -> dict[str, Any]:
    """What the page shows of the runs that were simulated again."""
    summary = again.summary
    rows = (
        ("trailing edge", summary["quantities"]["te_x_mm"]),
        ("contact length", summary["quantities"]["contact_len_mm"]),
        ("both", summary["all"]),
    )
    return {
        "picture": svg_element(
            _figure(again.frames),
            "Lag of the edge and contact length: measured and simulated again",
        ),
        "specimens": summary["all"]["specimens"],
        "rows": [
            {
                "title": title,
                "null_mm": entry["rmse_null_mm"],
                "extended_mm": entry["rmse_extended_mm"],
                "gain": _gain(entry),
            }
            for title, entry in rows
        ],
    }


def _gain(entry: dict) -> str:
    if entry["gain_ci95"] is None:
        return percent(entry["gain"], digits=0)
    return with_interval(entry["gain"], entry["gain_ci95"], 0, 100.0, " %")


@styled
def _figure(frames: pd.DataFrame) -> Figure:
    change = (frames["te_x_mm_null"] - frames["te_x_mm_extended"]).abs()
    order = change.groupby(frames["run_id"]).mean().sort_values(kind="stable").index
    chosen = [order[i] for i in np.linspace(len(order) - 1, 0, SHOWN_RUNS).astype(int)]
    figure = new_figure(7.2, 4.2)
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
            axes.tick_params(labelsize=8)
        panels[0, column].set_title(plain_text(f"run {run}"))
        panels[1, column].set_xlabel("stage (mm)")
    panels[0, 0].set_ylabel("lag of the edge (mm)")
    panels[1, 0].set_ylabel("contact length (mm)")
    panels[0, 0].legend(frameon=False, fontsize=8, loc="lower right")
    return figure
