"""The paper's Fig. 6: cumulative errors on the simulated test set and on captures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.base.page.figures import svg_uri
from slipstitch.config.train import REFLECTIVE, split_of
from slipstitch.dataset.videos import takes_part
from slipstitch.film.captures.scores import subsets, what_they_are
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import (
    BY_NAME,
    CAPTURES,
    PredictionsAndTruth,
    distance,
    mean_over_seeds,
    metrics_of,
    spread_over_seeds,
)
from slipstitch.learning.evaluation.scores import MODELS
from slipstitch.report import learning_pictures
from slipstitch.report.learning import MODEL_TITLES, SPLIT_TITLES, seeds_of
from slipstitch.report.results import Results

SUBSET_TITLES = {
    "all": "all captures",
    "matte": "captures without reflective",
    "reflective": "captures, reflective only",
}
LAST_CURVE = "all captures, reflective training"
COLUMNS = metrics_of(CAPTURES, "friction", "capture")


def training_floors(
    manifest: Sequence[Mapping[str, Any]], split: str
) -> dict[str, tuple[int, bool]]:
    """Floor -> training simulations on it, once a viewpoint, and whether it mirrors.

    Parameters
    ----------
    manifest : sequence of mapping
        Rows of the dataset's manifest.
    split : str
        One of `slipstitch.config.train.TRAINED_ON`.
    """
    floors: dict[str, set[tuple[str, str]]] = {}
    mirrors: dict[str, bool] = {}
    for row in manifest:
        if row[f"split_{split_of(split)}"] == "train" and takes_part(row, split):
            floors.setdefault(row["floor"], set()).add((row["simulation"], row["viewpoint_id"]))
            mirrors[row["floor"]] = mirrors.get(row["floor"], False) or row["floor_reflectance"] > 0
    return {name: (len(found), mirrors[name]) for name, found in sorted(floors.items())}


def floors_in_words(floors: Mapping[str, tuple[int, bool]]) -> str:
    """What the floors of the training films were."""
    if not floors:
        return "floors unknown"
    mirrors = {name: count for name, (count, mirror) in floors.items() if mirror}
    if not mirrors:
        return "trained on matte floors only"
    whole = sum(count for count, _ in floors.values())
    listed = ", ".join(f"{name} {count}" for name, count in mirrors.items())
    return f"trained with reflective floors: {sum(mirrors.values())} of {whole} films ({listed})"


def captures_section(results: Results, metrics, details, predictions) -> dict[str, Any] | None:
    """Captures beside the simulated test set: one table per model, and the curves.

    Parameters
    ----------
    results : Results
        What ``snakemake captures`` made is read from it.
    metrics, details, predictions
        Of the simulated test sets: metrics.json, details.json, rows of predictions.parquet.

    Returns
    -------
    dict or None
        None if no captures were evaluated.
    """
    scores, rows = results.capture_metrics(), results.capture_predictions()
    if not scores or not rows:
        return None
    manifest = results.manifest() or []
    whole = next(of_model for name, of_model in scores.items() if name.endswith("_all"))
    groups, panels = [], []
    for label in next(iter(scores.values())):
        model, _, split = label.partition(", trained ")
        own = _of_model(rows, model, split)
        floors = floors_in_words(training_floors(manifest, split))
        title = f"{MODEL_TITLES[model]}, {SPLIT_TITLES[split]}"
        # The same with the second training set: the last curve.
        mirrors = whole.get(f"{model}, trained {REFLECTIVE}") if split == "by_video" else None
        simulated = _simulated_errors(predictions, model, split)
        groups.append(
            {
                "title": title,
                "floors": floors,
                "seeds": seeds_of({name: of_model[label] for name, of_model in scores.items()}),
                "rows": _simulated_row(metrics, details, model, split, simulated)
                + [
                    _row(SUBSET_TITLES[name.split("_")[1]], of_model[label], of_model[label])
                    for name, of_model in scores.items()
                ]
                + ([_row(LAST_CURVE, mirrors, mirrors)] if mirrors else []),
            }
        )
        panels.append(
            {
                "title": f"{MODEL_TITLES[model]}, {learning_pictures.SPLIT_NAMES[split]}\n"
                + floors.split(":")[0],
                "curves": {
                    "simulated test set": np.concatenate([*simulated.values(), []]),
                    **{SUBSET_TITLES[name]: off for name, off in _capture_errors(own).items()},
                    **(
                        {LAST_CURVE: _capture_errors(_of_model(rows, model, REFLECTIVE))["all"]}
                        if mirrors
                        else {}
                    ),
                },
            }
        )
    return {
        "first_line": what_they_are(rows),
        "real": not rows[0]["surrogate"],
        "columns": COLUMNS,
        "paper": {
            subset: paper.captures_cells(subset, [metric.name for metric in COLUMNS])
            for subset in paper.CAPTURES
        },
        "groups": groups,
        "reflective_training": any(label.endswith(REFLECTIVE) for label in whole),
        "other_networks": results.captures_of_other_networks(),
        "figure": svg_uri(
            learning_pictures.cumulative_captures(
                panels,
                {
                    SUBSET_TITLES.get(subset, LAST_CURVE): figures["median_within_0.1"]
                    for subset, figures in paper.CAPTURES.items()
                    if figures
                },
            )
        ),
    }


def _of_model(rows: Sequence[Mapping[str, Any]], model: str, split: str) -> list[Mapping[str, Any]]:
    return [row for row in rows if (row["model"], row["trained_on"]) == (model, split)]


def _capture_errors(rows: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Errors of the pairs' medians, as the paper counts, of all seeds together, by subset."""
    repeats: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        repeats.setdefault((row["seed"], row["pair"]), []).append(row)
    pairs = [of_pair[0] for of_pair in repeats.values()]
    off = distance(
        [np.median([row["friction"] for row in of_pair]) for of_pair in repeats.values()],
        [pair["mu_ref"] for pair in pairs],
        [pair["mu_ref_error"] for pair in pairs],
    )
    return {name.split("_")[1]: off[chosen] for name, chosen in subsets(pairs).items()}


def _simulated_errors(predictions, model: str, split: str) -> dict[int, np.ndarray]:
    """Seed -> errors on the split's own test set."""
    network = MODELS.get(model, model)
    found: dict[int, list[float]] = {}
    for row in predictions or ():
        if (row["split"], row["network"]) == (split, network):
            off = abs(row["predicted_value"] - row["true_value"])
            found.setdefault(row["seed"], []).append(off)
    return {seed: np.array(values) for seed, values in found.items()}


def _simulated_row(metrics, details, model, split, errors) -> list[dict[str, Any]]:
    entry = (metrics or {}).get(split, {}).get(model)
    if not entry:
        return []
    detail = details.get(split, {}).get(MODELS.get(model, model), {})
    metric = BY_NAME["within_0.1"]
    within = [
        {metric.name: metric.compute(PredictionsAndTruth(np.nan, off, np.zeros_like(off)))}
        for off in errors.values()
    ]
    mean = entry | (mean_over_seeds(within) if within else {})
    spread = (detail.get("spread") or {}) | ((spread_over_seeds(within) or {}) if within else {})
    return [_row("simulated test set", entry, mean | {"spread": spread})]


def _row(title: str, entry: Mapping[str, Any], scores: Mapping[str, Any]) -> dict[str, Any]:
    spread = scores.get("spread") or {}
    return {
        "title": title,
        "n": entry["n"],
        "pairs": entry.get("pairs"),
        "cells": [metric.shown(scores, spread) for metric in COLUMNS],
    }
