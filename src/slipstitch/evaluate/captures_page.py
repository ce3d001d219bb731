"""The page of the captures: tables and the cumulative error, beside the paper's real videos."""

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

from slipstitch import __version__
from slipstitch.evaluate import paper
from slipstitch.evaluate.capture_scores import (
    Predictions,
    distance,
    pair_medians,
    subsets,
    what_they_are,
)
from slipstitch.evaluate.cumulative import draw_cumulative
from slipstitch.evaluate.wording import number, percent, seeds_in_words
from slipstitch.sample.images import read_frames

# Okabe & Ito 2008.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000")
_DASHES = {"all": "-", "matte": "--", "reflective": ":"}
_FRAMES_SHOWN = 10


def captures_page(
    dataset: Path,
    known: Sequence[Mapping[str, Any]],
    found: Sequence[Predictions],
    metrics: Mapping[str, Mapping[str, Mapping[str, Any]]],
    step: float,
) -> str:
    """The page as HTML; it needs no other file.

    Parameters
    ----------
    dataset : path
        Of the captures, for their pictures.
    known, found, metrics
        See `slipstitch.evaluate.captures`.
    step : float
        Of the grid of friction.
    """
    whole = np.ones(len(known), bool)
    shown = _one_seed(found)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("captures.html.j2").render(
        first_line=what_they_are(known),
        version=__version__,
        metrics=metrics,
        paper=paper,
        percent=percent,
        number=number,
        share=lambda row, key: _breaking(percent(row.get(key), (row["spread"] or {}).get(key))),
        value=lambda row, key: _breaking(number(row.get(key), (row["spread"] or {}).get(key))),
        seeds_in_words=seeds_in_words,
        plot=_svg(_cumulative(known, found)),
        models=[
            {"label": _label(one), "rows": pair_medians(known, one, whole, step)} for one in shown
        ],
        strips=[_strip(dataset, row) for row in _first_of_pairs(known)],
        captures=len(known),
        pairs=len({row["pair"] for row in known}),
        notes=[f"{row['video']}: {row['notes']}" for row in known if row["notes"]],
    )


def _breaking(score: str) -> str:
    """A score that breaks before its spread only, in a narrow column."""
    return score.replace(" ", "\N{NO-BREAK SPACE}").replace("\N{NO-BREAK SPACE}±", " ±")


def _label(one: Predictions) -> str:
    return f"{one.model}, trained {one.trained_on}, seed {one.seed}"


def _one_seed(found: Sequence[Predictions]) -> list[Predictions]:
    first: dict[tuple[str, str], Predictions] = {}
    for one in found:
        first.setdefault((one.model, one.trained_on), one)
    return list(first.values())


def _cumulative(known, found: Sequence[Predictions]) -> Figure:
    """Share of the captures whose error is at most so large, as in the paper's Fig. 6."""
    reference = np.array([row["mu_ref"] for row in known])
    error = np.array([row["mu_ref_error"] for row in known])
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch", "font.size": 9}):
        figure = Figure(figsize=(7.6, 3.6), layout="constrained")
        axes = figure.subplots()
        groups: dict[str, list[Predictions]] = {}
        for one in found:
            groups.setdefault(f"{one.model}, trained {one.trained_on}", []).append(one)
        off = {
            label: np.concatenate([distance(one.friction, reference, error) for one in members])
            for label, members in groups.items()
        }
        largest = max(0.3, *(float(one.max()) for one in off.values()))
        for colour, (label, errors) in zip(_COLOURS, off.items(), strict=False):
            for name, chosen in subsets(known).items():
                kind = name.split("_")[1]
                draw_cumulative(
                    axes,
                    errors[np.tile(chosen, len(groups[label]))],
                    largest,
                    color=colour,
                    linestyle=_DASHES[kind],
                    label=f"{label}: {kind}",
                    linewidth=1.8 if kind == "all" else 1.1,
                )
        axes.set(xlim=(0, largest), ylim=(0, 1.02))
        axes.set_xlabel("distance of μ from the reference's interval")
        axes.set_ylabel("share of the films")
        axes.grid(color="#e8e6df", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(fontsize=7.5, frameon=False, loc="lower right")
    return figure


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue().encode()).decode()}"


def _first_of_pairs(known) -> list[Mapping[str, Any]]:
    first: dict[str, Mapping[str, Any]] = {}
    for row in known:
        first.setdefault(row["pair"], row)
    return list(first.values())


def _strip(dataset: Path, row: Mapping[str, Any]) -> dict[str, Any]:
    """Some frames of a capture as the networks see them."""
    file = dataset / f"{row['video'].rsplit('_', 2)[0]}.parquet"
    images = [png for _, _, png in read_frames(file)]
    places = np.linspace(0, len(images) - 1, min(_FRAMES_SHOWN, len(images))).round().astype(int)
    return {
        "title": f"{row['material']} on {row['substrate']}, μ = {row['mu_ref']:.3f} ± "
        f"{row['mu_ref_error']:.3f}{', reflective' if row['reflective'] else ''}",
        "images": [f"data:image/png;base64,{base64.b64encode(images[k]).decode()}" for k in places],
    }
