"""Trained networks on captures: the paper's protocol for real videos (Sec. 6.3).

The reference of a pair is an interval, r +- e: the error of a prediction is its distance from the
interval, 0 inside. Of a pair's repeats the median counts; pairs whose repeats are all given the
same friction, to half a grid step, are counted. Substrates that mirror are looked at apart.
"""

import json
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.capture.ingest.dataset import CAPTURES, read_known
from slipstitch.errors import BadInput
from slipstitch.evaluate.evaluation import MODELS, find_models, predicted_shares
from slipstitch.evaluate.metrics import entry, mean_over_seeds, steps_off
from slipstitch.evaluate.settings import EvaluateSettings
from slipstitch.instrument import load_instrument
from slipstitch.provenance import (
    atomic_path,
    provenance_record,
    start_clock,
    write_parquet,
    write_sidecar,
)
from slipstitch.sample.dataset import MANIFEST
from slipstitch.sample.frames import sampled_frames
from slipstitch.train.training import set_up_torch
from slipstitch.train.videos import Videos, read_videos

INSTRUMENT_WEIGHTS = "instrument.safetensors"


@dataclass(frozen=True)
class Predictions:
    """What one trained model says of all captures.

    Attributes
    ----------
    model : str
        lrcn_baseline, lrcn_conditional, instrument.
    trained_on : str
        The split.
    seed : int
    friction : ndarray (n,)
    intervals : ndarray (n, 2), optional
    materials : list of list of str
        Fabrics of each video from the likeliest on; empty if the model does not tell.
    known_materials : list of str
        The fabrics it can tell.
    alarms : list of str
        Why each video is unlike the training data; empty without alarm.
    """

    model: str
    trained_on: str
    seed: int
    friction: np.ndarray
    intervals: np.ndarray | None = None
    materials: list[list[str]] = field(default_factory=list)
    known_materials: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)


def distance(friction: np.ndarray, reference: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Distance of predictions from the intervals reference +- error."""
    return np.maximum(np.abs(friction - reference) - error, 0.0)


def predict_captures(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    models: str | os.PathLike | None,
    instruments: str | os.PathLike | None,
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
    threads : int

    Raises
    ------
    BadInput
        If there is no model, or files are damaged or of another shape.
    """
    set_up_torch(threads)
    found = []
    if models is not None:
        found += _lrcn(settings, dataset, models)
    if instruments is not None:
        found += _instruments(dataset, instruments)
    if not found:
        raise BadInput(f"{models or instruments}: no trained model for captures in it")
    return found


def _lrcn(settings, dataset, folder) -> list[Predictions]:
    models = find_models(folder)
    found = []
    cards = [model.card for model in models.values()]
    videos = read_videos(dataset, pixels=cards[0]["pixels"])
    if cards[0]["frames"] != videos.pixels.shape[1]:
        raise BadInput(
            f"{dataset}: videos of {videos.pixels.shape[1]} frames, the networks in {folder} were "
            f"trained with {cards[0]['frames']}: ingest with their configuration"
        )
    for split, network, seed in models:
        name = next((key for key, value in MODELS.items() if value == network), None)
        if name is None:
            continue
        card = models[split, network, seed].card
        # These videos are of no training; the networks beside one another must be of one.
        own = Videos(videos.rows, videos.pixels, card["dataset_digest"])
        shares = predicted_shares(models, (split, network, seed), own, settings.batch_size)
        values = np.array([one["value"] for one in card["classes"]])
        found.append(
            Predictions(
                name,
                split,
                seed,
                values[shares.argmax(1)],
                **_materials(models, (split, "material_baseline", seed), own, settings),
            )
        )
    return found


def _materials(models, key, videos: Videos, settings) -> dict[str, list]:
    if key not in models:
        return {}
    shares = predicted_shares(models, key, videos, settings.batch_size)
    names = [one["name"] for one in models[key].card["classes"]]
    order = np.argsort(-shares, axis=1, kind="stable")
    return {"materials": [[names[k] for k in row] for row in order], "known_materials": names}


def _instruments(dataset, folder) -> list[Predictions]:
    found = []
    for path in sorted(Path(folder).glob(f"*/seed*/{INSTRUMENT_WEIGHTS}")):
        instrument = load_instrument(path.parent)
        videos = read_videos(dataset)
        frames = sampled_frames(videos.pixels.shape[1], instrument.card["frames"])
        said = [
            instrument.measure(np.ascontiguousarray(one[frames]), np.random.default_rng(0))
            for one in videos.pixels
        ]
        found.append(
            Predictions(
                "instrument",
                path.parts[-3],
                int(path.parts[-2].removeprefix("seed")),
                np.array([one.friction_coefficient for one in said]),
                np.array([one.interval_90 for one in said], dtype=float),
                [
                    sorted(one.material_probabilities, key=one.material_probabilities.get)[::-1]
                    for one in said
                ],
                list(said[0].material_probabilities),
                [one.alarm_reason if one.alarm else "" for one in said],
            )
        )
    return found


def subsets(known: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Name -> which captures: all, without reflective substrates, reflective only."""
    reflective = np.array([row["reflective"] for row in known])
    prefix = "surrogate" if known[0]["surrogate"] else "real"
    parts = {"all": np.ones(len(known), bool), "matte": ~reflective, "reflective": reflective}
    return {f"{prefix}_{name}": chosen for name, chosen in parts.items() if chosen.any()}


def pair_medians(
    known: Sequence[Mapping[str, Any]], predictions: Predictions, chosen: np.ndarray, step: float
) -> list[dict[str, Any]]:
    """A row a pair: its reference, the predictions of its repeats, their median and its error."""
    members: dict[str, list[int]] = defaultdict(list)
    for k in np.flatnonzero(chosen):
        members[known[k]["pair"]].append(int(k))
    rows = []
    for pair, repeats in sorted(members.items()):
        one = known[repeats[0]]
        friction = predictions.friction[repeats]
        median = float(np.median(friction))
        # The class of an instrument's continuous answer is the nearest multiple of the grid's step.
        classes = np.round(friction / step) if predictions.model == "instrument" else friction
        rows.append(
            {
                "pair": pair,
                "material": one["material"],
                "substrate": one["substrate"],
                "reflective": one["reflective"],
                "mu_ref": one["mu_ref"],
                "mu_ref_error": one["mu_ref_error"],
                "predictions": friction.tolist(),
                "median": median,
                "error": float(distance(median, one["mu_ref"], one["mu_ref_error"])),
                "equal": bool(np.ptp(classes) == 0),
            }
        )
    return rows


def capture_scores(
    known: Sequence[Mapping[str, Any]], predictions: Predictions, chosen: np.ndarray, step: float
) -> dict[str, float | None]:
    """Scores of one model on some captures.

    Returns
    -------
    dict
        Those of `slipstitch.evaluate.metrics.FIELDS` (errors from the reference's interval), and
        ``median_lt_0.1``, ``median_error`` (of the pairs' medians), ``equal_predictions`` (share of
        the pairs), ``alarms``, ``pairs``.
    """
    reference = np.array([row["mu_ref"] for row in known])[chosen]
    error = np.array([row["mu_ref_error"] for row in known])[chosen]
    friction = predictions.friction[chosen]
    off = distance(friction, reference, error)
    steps = steps_off(off, np.zeros_like(off), step)
    pairs = pair_medians(known, predictions, chosen, step)
    medians = np.array([row["error"] for row in pairs])
    scores: dict[str, float | None] = {
        "friction_lt_0.1": float((steps == 0).mean()),
        "friction_lt_0.2": float((steps <= 1).mean()),
        "mean_absolute_error": float(np.abs(friction - reference).mean()),
        "mean_distance": float(off.mean()),
        "median_error": float(medians.mean()),
        "median_lt_0.1": float((steps_off(medians, np.zeros_like(medians), step) == 0).mean()),
        "equal_predictions": float(np.mean([row["equal"] for row in pairs])),
        "pairs": float(len(pairs)),
    }
    if predictions.intervals is not None:
        low, high = predictions.intervals[chosen].T
        scores["coverage_90"] = float(
            ((low <= reference + error) & (high >= reference - error)).mean()
        )
        scores["interval_width"] = float((high - low).mean())
        scores["alarms"] = float(np.mean([bool(predictions.alarms[k]) for k in _places(chosen)]))
    named = [k for k in _places(chosen) if known[k]["material"] in predictions.known_materials]
    if named and predictions.materials:
        for count in (1, 2):
            hits = [known[k]["material"] in predictions.materials[k][:count] for k in named]
            scores[f"material_top{count}"] = float(np.mean(hits))
    return scores


def _places(chosen: np.ndarray) -> list[int]:
    return np.flatnonzero(chosen).tolist()


def evaluate_captures(
    settings: EvaluateSettings, dataset: str | os.PathLike, found: Sequence[Predictions]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Metrics by subset and model, means over seeds; and a row a capture and model.

    Returns
    -------
    metrics : dict
        ``{subset: {"model, trained on split": {field: number}}}``.
    rows : list of dict
        Single predictions.
    """
    known = read_known(dataset)
    metrics: dict[str, Any] = {}
    for name, chosen in subsets(known).items():
        groups: dict[str, list[Predictions]] = defaultdict(list)
        for one in found:
            groups[f"{one.model}, trained {one.trained_on}"].append(one)
        metrics[name] = {}
        for label, members in groups.items():
            scores = [capture_scores(known, one, chosen, settings.friction_step) for one in members]
            mean = mean_over_seeds(scores)
            seeds = sorted(one.seed for one in members)
            whole = entry(int(chosen.sum()), seeds, mean)
            metrics[name][label] = {**mean, **whole, "pairs": int(mean["pairs"])}
    rows = [
        {
            **{key: row[key] for key in ("video", "pair", "material", "substrate", "repeat")},
            **{key: row[key] for key in ("mu_ref", "mu_ref_error", "reflective", "surrogate")},
            "model": one.model,
            "trained_on": one.trained_on,
            "seed": one.seed,
            "friction": float(one.friction[k]),
            "low": None if one.intervals is None else float(one.intervals[k, 0]),
            "high": None if one.intervals is None else float(one.intervals[k, 1]),
            "likeliest_material": one.materials[k][0] if one.materials else None,
            "alarm": one.alarms[k] if one.alarms else None,
        }
        for one in found
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
    threads: int = 1,
) -> dict[str, Any]:
    """Evaluate on captures; write metrics (JSON), single predictions (Parquet) and the page."""
    from slipstitch.evaluate.captures_page import captures_page

    started = start_clock()
    found = predict_captures(settings, dataset, models, instruments, threads)
    metrics, rows = evaluate_captures(settings, dataset, found)
    known = read_known(dataset)
    weights = [
        path
        for folder in filter(None, (models, instruments))
        for path in sorted(Path(folder).glob("**/*.safetensors"))
        if path.stem in ("model", "instrument")
    ]
    inputs = [Path(dataset) / name for name in (MANIFEST, CAPTURES)]
    keys = {"evaluate": settings}
    record = provenance_record("evaluate", inputs=inputs + weights, config=keys, started=started)
    with atomic_path(out) as temporary:
        text = json.dumps(metrics, indent=1, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    write_sidecar(out, record)
    write_parquet(pa.Table.from_pylist(rows), predictions_out, {}, record)
    if page_out is not None:
        page = captures_page(Path(dataset), known, found, metrics, settings.friction_step)
        with atomic_path(page_out) as temporary:
            temporary.write_text(page, encoding="utf-8")
        write_sidecar(page_out, record)
    return metrics
