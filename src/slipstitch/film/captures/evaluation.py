"""Trained networks on captures, real or surrogate: predictions, tables, page."""

import os
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
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
from slipstitch.config.train import TrainSettings
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import Videos, read_videos
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.film.captures.scores import Predictions, capture_scores, subsets
from slipstitch.film.ingest.dataset import CAPTURES, read_known
from slipstitch.learning.evaluation.evaluation import (
    MODELS,
    find_models,
    network_weights,
    predicted_probabilities,
)
from slipstitch.learning.evaluation.instruments import (
    AVERAGE,
    TRAINING,
    find_instruments,
    instrument_weights,
)
from slipstitch.learning.evaluation.metrics import entry, mean_over_seeds, spread_over_seeds
from slipstitch.learning.instrument.poses import poses_of
from slipstitch.learning.torch_setup import set_up_torch


def predict_captures(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    models: str | os.PathLike | None,
    instruments: str | os.PathLike | None,
    *,
    train: TrainSettings | None = None,
    instrument_seeds: list[int] | None = None,
    threads: int = 1,
) -> list[Predictions]:
    """All trained models on all captures.

    Parameters
    ----------
    settings : EvaluateSettings
    dataset : path
        What `slipstitch capture ingest` wrote.
    models, instruments : path, optional
        Folders ``{split}/{network}/seed{seed}`` and ``{split}/seed{seed}``.
    train : TrainSettings, optional
        The splits and seeds that count; by default every model in the folders.
    instrument_seeds : list of int, optional
        Seeds of instruments that count; by default all.
    threads : int

    Raises
    ------
    BadInput
        If there is no model, two were trained on different datasets, or files are damaged or of
        another shape.
    """
    set_up_torch(threads)
    networks = {} if models is None else find_models(models, train)
    measuring = (
        {} if instruments is None else find_instruments(instruments, train, instrument_seeds)
    )
    # Captures are of no training, so nothing else tells that these are of one dataset.
    of_dataset = {
        model.card["dataset_digest"]: f"{network} {split} seed {seed}"
        for (split, network, seed), model in networks.items()
    } | {
        instrument.card.get("dataset_digest"): f"instrument {split} seed {seed}"
        for (split, seed), instrument in measuring.items()
    }
    if len(of_dataset) > 1:
        one, other, *_ = of_dataset.values()
        raise BadInput(f"{one} and {other} were trained on different datasets")
    found = []
    if networks:
        found += _lrcn(settings, dataset, models, networks)
    if measuring:
        found += _instruments(dataset, measuring)
    if not found:
        raise BadInput(f"{models or instruments}: no trained model for captures found")
    return found


def _lrcn(settings, dataset, folder, models) -> list[Predictions]:
    found = []
    cards = [model.card for model in models.values()]
    videos = read_videos(dataset, pixels=cards[0]["pixels"])
    if cards[0]["frames"] != videos.pixels.shape[1]:
        raise BadInput(
            f"{dataset}: videos of {videos.pixels.shape[1]} frames, but the networks in {folder} "
            f"were trained with {cards[0]['frames']}: ingest with their configuration"
        )
    for split, network, seed in models:
        name = next((key for key, value in MODELS.items() if value == network), None)
        if name is None:
            continue
        card = models[split, network, seed].card
        own = Videos(videos.rows, videos.pixels, card["dataset_digest"])
        probabilities = predicted_probabilities(
            models, (split, network, seed), own, settings.batch_size
        )
        values = np.array([of_class["value"] for of_class in card["classes"]])
        found.append(
            Predictions(
                name,
                split,
                seed,
                values[probabilities.argmax(1)],
                **_materials(models, (split, "material_baseline", seed), own, settings),
            )
        )
    return found


def _materials(models, key, videos: Videos, settings) -> dict[str, Any]:
    if key not in models:
        return {}
    probabilities = predicted_probabilities(models, key, videos, settings.batch_size)
    names = [of_class["name"] for of_class in models[key].card["classes"]]
    order = np.argsort(-probabilities, axis=1, kind="stable")
    return {"materials": [[names[k] for k in row] for row in order], "known_materials": names}


def _instruments(dataset, instruments) -> list[Predictions]:
    found = []
    videos = read_videos(dataset)
    for (split, seed), instrument in instruments.items():
        frames = sampled_frames(videos.pixels.shape[1], instrument.card["frames"])
        measurements = [
            instrument.measure(np.ascontiguousarray(pixels[frames]), np.random.default_rng(0), pose)
            for pixels, pose in zip(videos.pixels, poses_of(videos.rows), strict=True)
        ]
        found.append(
            Predictions(
                AVERAGE if seed is None else TRAINING,
                split,
                seed,
                np.array([measurement.friction_coefficient for measurement in measurements]),
                np.array([measurement.interval_90 for measurement in measurements], dtype=float),
                [
                    _likeliest_first(measurement.material_probabilities)
                    for measurement in measurements
                ],
                list(measurements[0].material_probabilities),
                [
                    measurement.alarm_reason if measurement.alarm else ""
                    for measurement in measurements
                ],
            )
        )
    return found


def _likeliest_first(probabilities: dict[str, float]) -> list[str]:
    return sorted(probabilities, key=probabilities.__getitem__)[::-1]


def evaluate_captures(
    settings: EvaluateSettings, dataset: str | os.PathLike, found: Sequence[Predictions]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Metrics by subset and model, means over seeds; and one row per capture and model.

    Returns
    -------
    metrics : dict
        ``{subset: {"model, trained on split": {field: number}}}``; ``spread`` holds the standard
        deviations over seeds, null of one seed.
    rows : list of dict
        Single predictions.
    """
    known = read_known(dataset)
    metrics: dict[str, Any] = {}
    for name, chosen in subsets(known).items():
        groups: dict[str, list[Predictions]] = defaultdict(list)
        for predictions in found:
            groups[predictions.label].append(predictions)
        metrics[name] = {}
        for label, members in groups.items():
            scores = [
                capture_scores(known, predictions, chosen, settings.friction_step)
                for predictions in members
            ]
            mean = mean_over_seeds(scores)
            seeds = sorted(one.seed for one in members if one.seed is not None)
            whole = entry(int(chosen.sum()), seeds, mean)
            metrics[name][label] = {
                **mean,
                **whole,
                "pairs": int(mean["pairs"]),
                "spread": spread_over_seeds(scores),
            }
    rows = [
        {
            **{key: row[key] for key in ("video", "pair", "material", "substrate", "repeat")},
            **{key: row[key] for key in ("mu_ref", "mu_ref_error", "reflective", "surrogate")},
            "model": predictions.model,
            "trained_on": predictions.trained_on,
            "seed": predictions.seed,
            "friction": float(predictions.friction[k]),
            "low": None if predictions.intervals is None else float(predictions.intervals[k, 0]),
            "high": None if predictions.intervals is None else float(predictions.intervals[k, 1]),
            "likeliest_material": predictions.materials[k][0] if predictions.materials else None,
            "alarm": predictions.alarms[k] if predictions.alarms else None,
        }
        for predictions in found
        for k, row in enumerate(known)
    ]
    return metrics, rows


def write_captures_evaluation(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    models: str | os.PathLike | None,
    instruments: str | os.PathLike | None,
    out: str | os.PathLike,
    predictions_out: str | os.PathLike,
    page_out: str | os.PathLike | None = None,
    *,
    train: TrainSettings | None = None,
    instrument_seeds: list[int] | None = None,
    threads: int = 1,
) -> dict[str, Any]:
    """Evaluate on captures; write metrics (JSON), single predictions (Parquet) and the page."""
    from slipstitch.film.captures.page import captures_page

    started = start_clock()
    found = predict_captures(
        settings,
        dataset,
        models,
        instruments,
        train=train,
        instrument_seeds=instrument_seeds,
        threads=threads,
    )
    metrics, rows = evaluate_captures(settings, dataset, found)
    known = read_known(dataset)
    weights = [] if models is None else network_weights(models, train)
    if instruments is not None:
        weights += instrument_weights(instruments, train, instrument_seeds)
    inputs = [Path(dataset) / name for name in (MANIFEST, CAPTURES)]
    keys = {"evaluate": settings}
    record = provenance_record("evaluate", inputs=inputs + weights, config=keys, started=started)
    write_json(out, metrics, record)
    write_parquet(pa.Table.from_pylist(rows), predictions_out, {}, record)
    if page_out is not None:
        page = captures_page(Path(dataset), known, found, metrics, settings.friction_step)
        write_text(page_out, page, record)
    return metrics
