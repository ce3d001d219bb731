"""Trained models on captures, real or surrogate: predictions, scores, page."""

import os
from pathlib import Path
from typing import Any

import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    provenance_record,
    start_clock,
    write_json,
    write_parquet,
    write_text,
)
from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import read_videos
from slipstitch.film.captures.page import captures_page
from slipstitch.film.captures.scores import capture_metrics
from slipstitch.film.ingest_videos import CAPTURES, read_known
from slipstitch.learning.evaluation.scores import (
    CALIBRATED,
    MATERIAL,
    entries_of,
    predicts_material_alone,
)
from slipstitch.learning.evaluation.trained import Trained
from slipstitch.learning.lrcn_model import LrcnModel
from slipstitch.learning.torch_setup import set_up_torch

_OF_CAPTURE = (
    *("video", "pair", "material", "substrate", "repeat"),
    *("mu_ref", "mu_ref_error", "reflective", "surrogate"),
)


def predict_captures(
    settings: EvaluateSettings, dataset: str | os.PathLike, trained: Trained
) -> list[dict[str, Any]]:
    """Return the predictions of all trained models for all captures, a row each.

    Parameters
    ----------
    settings : EvaluateSettings
    dataset : path
        What `slipstitch capture ingest` wrote.
    trained : Trained

    Raises
    ------
    BadInput
        If there is no model, two were trained on different datasets, or files are damaged or of
        another shape.
    """
    models = trained.load()
    # Captures are of no training, so nothing else tells that these are of one dataset.
    of_dataset = {
        model.card.get("dataset_digest"): f"{network} {split} seed {seed}"
        for (split, network, seed), model in models.items()
    }
    if len(of_dataset) > 1:
        one, other, *_ = of_dataset.values()
        raise BadInput(f"{one} and {other} were trained on different datasets")
    known, videos = read_known(dataset), read_videos(dataset)
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
        predictions = model.predict(videos, settings.batch_size)
        material = models.get((split, MATERIAL + CALIBRATED * network.endswith(CALIBRATED), seed))
        seen = predictions
        if isinstance(model, LrcnModel) and material is not None:
            seen = material.predict(videos, settings.batch_size)
        for capture, prediction, of_fabric in zip(known, predictions, seen, strict=True):
            low, high = prediction.interval_90 or (None, None)
            fabrics = of_fabric.fabrics
            rows.append(
                {
                    **{name: capture[name] for name in _OF_CAPTURE},
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
    if not rows:
        folder = trained.networks or trained.instruments
        raise BadInput(f"{folder}: no trained model for captures found")
    return rows


def write_captures_evaluation(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    trained: Trained,
    out: str | os.PathLike,
    predictions_out: str | os.PathLike,
    page_out: str | os.PathLike | None = None,
    threads: int = 1,
) -> dict[str, Any]:
    """Evaluate on captures; write scores (JSON), predictions (Parquet) and the page."""
    started = start_clock()
    set_up_torch(threads)
    rows = predict_captures(settings, dataset, trained)
    metrics = capture_metrics(rows, settings.friction_step)
    weights = [path for paths in trained.weights().values() for path in paths]
    inputs = [Path(dataset) / name for name in (MANIFEST, CAPTURES)]
    keys = {"evaluate": settings}
    record = provenance_record("evaluate", inputs=inputs + weights, config=keys, started=started)
    write_json(out, metrics, record)
    write_parquet(pa.Table.from_pylist(rows), predictions_out, {}, record)
    if page_out is not None:
        page = captures_page(
            Path(dataset), read_known(dataset), rows, metrics, settings.friction_step
        )
        write_text(page_out, page, record)
    return metrics
