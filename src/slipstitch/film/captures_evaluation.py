"""Trained models on captures, real or surrogate: predictions, scores, page."""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import data_uri, new_figure, styled, svg_uri
from slipstitch.base.page.palette import INK, SERIES
from slipstitch.base.page.templates import render
from slipstitch.base.page.wording import evenly, seeds_in_words
from slipstitch.base.provenance import (
    provenance_record,
    start_clock,
    write_json,
    write_parquet,
    write_text,
)
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import read_frames, read_videos
from slipstitch.film.captures_scores import (
    capture_errors,
    capture_metrics,
    label,
    pair_medians,
    what_they_are,
)
from slipstitch.film.ingest_videos import CAPTURES, OF_CAPTURE, read_known
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import CAPTURES as OF_CAPTURES
from slipstitch.learning.evaluation.metrics import metrics_of
from slipstitch.learning.evaluation.scores import (
    CALIBRATED,
    MATERIAL,
    SHIPPED,
    entries_of,
    grouped,
    predicts_material_alone,
)
from slipstitch.learning.evaluation.trained import Key, Trained
from slipstitch.learning.lrcn import LrcnModel
from slipstitch.learning.prediction import Prediction
from slipstitch.learning.torch_setup import set_up_torch

_TEMPLATE = Path(__file__).with_name("captures.html.j2")
_DASHES = {"all": "-", "matte": "--", "reflective": ":"}
_FRAMES_SHOWN = 10


def predict_captures(dataset: str | Path, trained: Trained) -> list[dict[str, Any]]:
    """Return the predictions of all trained models for all captures, a row each.

    Of what `slipstitch capture ingest` wrote. BadInput if there is no model, two were trained
    on different datasets, or files are damaged or of another shape.
    """
    # The shipped instrument is one, whatever the splits.
    models = {
        (model.card["split"] if network == SHIPPED else split, network, seed): model
        for (split, network, seed), model in trained.load().items()
    }
    if all(network == SHIPPED or predicts_material_alone(network) for _, network, _ in models):
        folder = trained.networks or trained.instruments
        raise BadInput(f"{folder}: no trained model for captures found")
    # Captures are of no training, so nothing else tells that the others are of one dataset.
    of_dataset = {
        model.card.get("dataset_digest"): f"{network} {split} seed {seed}"
        for (split, network, seed), model in models.items()
        if network != SHIPPED
    }
    if len(of_dataset) > 1:
        one, other, *_ = of_dataset.values()
        raise BadInput(f"{one} and {other} were trained on different datasets")
    known, videos = read_known(dataset), read_videos(dataset)

    @cache  # two friction networks of a seed have one material network
    def predicted(key: Key) -> list[Prediction]:
        return models[key].predict(videos)

    rows = []
    for (split, network, seed), model in models.items():
        if predicts_material_alone(network):
            continue
        stored = videos.pixels.shape[1]
        if isinstance(model, LrcnModel) and model.card["frames"] != stored:
            raise BadInput(
                f"{dataset}: videos of {stored} frames, but the networks in {trained.networks} "
                f"were trained with {model.card['frames']}: ingest with their configuration"
            )
        predictions = seen = predicted((split, network, seed))
        material = (split, MATERIAL + CALIBRATED * network.endswith(CALIBRATED), seed)
        if isinstance(model, LrcnModel) and material in models:
            seen = predicted(material)
        for capture, prediction, of_fabric in zip(known, predictions, seen, strict=True):
            low, high = prediction.interval_90 or (None, None)
            fabrics = of_fabric.fabrics
            rows.append(
                {
                    **{name: capture[name] for name in ("video", *OF_CAPTURE)},
                    "model": entries_of(network),
                    "trained_on": split,
                    "seed": seed,
                    "friction": prediction.friction_coefficient,
                    "low": low,
                    "high": high,
                    "fabrics": fabrics,
                    "likeliest_material": fabrics[0] if fabrics else None,
                    "alarm": None if prediction.alarm is None else prediction.alarm_reason,
                }
            )
    return rows


def write_captures_evaluation(
    dataset: str | Path,
    trained: Trained,
    out: str | Path,
    predictions_out: str | Path,
    page_out: str | Path | None = None,
    threads: int = 1,
) -> dict[str, Any]:
    """Evaluate on captures; write scores (JSON), predictions (Parquet) and the page."""
    started = start_clock()
    set_up_torch(threads)
    rows = predict_captures(dataset, trained)
    metrics = capture_metrics(rows)
    models = [path for paths in trained.files().values() for path in paths]
    inputs = [Path(dataset) / name for name in (MANIFEST, CAPTURES)]
    record = provenance_record("evaluate", inputs=inputs + models, started=started)
    write_json(out, metrics, record)
    write_parquet(pa.Table.from_pylist(rows), predictions_out, {}, record)
    if page_out is not None:
        page = captures_page(Path(dataset), read_known(dataset), rows, metrics)
        write_text(page_out, page, record)
    return metrics


def captures_page(
    dataset: Path,
    known: Sequence[Mapping[str, Any]],
    found: Sequence[Mapping[str, Any]],
    metrics: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> str:
    """Return the page as HTML, of the captures, what `predict_captures` found, and the metrics."""
    columns = metrics_of(OF_CAPTURES)
    return render(
        _TEMPLATE,
        first_line=what_they_are(known),
        known=known,
        metrics=metrics,
        columns=columns,
        paper=paper,
        paper_cells={
            subset: paper.captures_cells(subset, [metric.name for metric in columns])
            for subset in paper.CAPTURES
        },
        seeds_in_words=seeds_in_words,
        plot=svg_uri(_cumulative(found)),
        models=[
            (_title(rows[0]), pair_medians(rows))
            for of_model in grouped(found, "model", "trained_on").values()
            for rows in islice(grouped(of_model, "seed").values(), 1)
        ],
        strips=[(rows[0], _strip(dataset, rows[0])) for rows in grouped(known, "pair").values()],
    )


def _title(row: Mapping[str, Any]) -> str:
    seed = "" if row["seed"] is None else f", seed {row['seed']}"
    return f"{label(row)}{seed}".replace("_", " ")


@styled
def _cumulative(found: Sequence[Mapping[str, Any]]) -> Figure:
    """Share of the pairs whose median's error is at most so large, as in the paper's Fig. 6.

    Of networks that were fine-tuned on the view that captures show, these alone.
    """
    figure = new_figure(7.6, 3.6)
    axes = figure.subplots()
    of_trainings = grouped(found, "model", "trained_on")
    off = {
        label(rows[0]): capture_errors(rows)
        for (model, split), rows in of_trainings.items()
        if (model + CALIBRATED, split) not in of_trainings
    }
    largest = max(0.3, *(errors.max() for of_label in off.values() for errors in of_label.values()))
    for number, (title, of_label) in enumerate(off.items()):
        again, place = divmod(number, len(SERIES))
        for kind, errors in of_label.items():
            paper.draw_cumulative(
                axes,
                errors,
                largest,
                color=SERIES[place],
                alpha=0.5**again,  # curves beyond the palette are paler
                linestyle=_DASHES[kind],
                label=title.replace("_", " ") if kind == "all" else None,
                linewidth=1.8 if kind == "all" else 1.1,
            )
    axes.set(xlim=(0, largest), ylim=(0, 1.02))
    axes.set_xlabel("distance of a pair’s median µ from the reference interval")
    axes.set_ylabel("share of pairs")
    colours = axes.legend(fontsize=7.5, frameon=False, loc="lower right")
    kinds = next(iter(off.values()))
    if len(kinds) > 1:  # two short legends for a long one: colours, dashes
        lines = [Line2D([], [], color=INK, ls=_DASHES[kind], label=kind) for kind in kinds]
        axes.add_artist(colours)
        axes.legend(handles=lines, fontsize=7.5, frameon=False, loc="center right")
    return figure


def _strip(dataset: Path, row: Mapping[str, Any]) -> list[str]:
    """Some frames of a capture as the networks see them."""
    file = dataset / f"{row['video'].rsplit('_', 2)[0]}.parquet"
    images = [png for _, _, png in read_frames(file)]
    return [data_uri(image) for image in evenly(images, _FRAMES_SHOWN)]
