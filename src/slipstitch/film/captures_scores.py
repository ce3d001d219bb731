"""Scores of predictions for captures, by the paper's protocol for real videos (Sec. 6.3).

The reference of a pair is an interval, r +- e: the error of a prediction is its distance from the
interval, 0 inside. Of a pair's repeats the median counts; pairs whose repeats are all given the
same friction, to half a grid step, are counted. Reflective substrates are evaluated separately.
Every score follows from the rows of captures/predictions.parquet.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.learning.evaluation.metrics import (
    STEP,
    distance,
    entry,
    mean_over_seeds,
    scores_of,
    spread_over_seeds,
)
from slipstitch.learning.evaluation.scores import answers_of, grouped

Row = Mapping[str, Any]
_TRAINED = ", trained "


def what_they_are(known: Sequence[Row]) -> str:
    """Return what kind of videos these are: the first line of every page about them."""
    if known[0]["surrogate"]:
        return (
            "Surrogate captures: simulated videos with a distribution shift from the training "
            "data. Nothing on this page was measured on a real bench."
        )
    return "Real captures: videos of a bench, with friction measured on an inclined plane."


def subsets(known: Sequence[Row]) -> dict[str, np.ndarray]:
    """Return, by name, which captures: all, without reflective substrates, reflective only."""
    reflective = np.array([row["reflective"] for row in known])
    prefix = "surrogate" if known[0]["surrogate"] else "real"
    parts = {"all": np.ones(len(known), bool), "matte": ~reflective, "reflective": reflective}
    return {f"{prefix}_{name}": chosen for name, chosen in parts.items() if chosen.any()}


def label(row: Row) -> str:
    """Return the model of a row and what it was trained on, whatever the seed."""
    return f"{row['model']}{_TRAINED}{row['trained_on']}"


def model_and_split(labelled: str) -> tuple[str, str]:
    """Return the model and what it was trained on of a `label`."""
    model, _, split = labelled.partition(_TRAINED)
    return model, split


def pair_medians(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return for each pair reference, one seed's predictions, their median and its error."""
    result = []
    for pair, repeats in sorted(grouped(rows, "pair").items()):
        first = repeats[0]
        friction = np.array([row["friction"] for row in repeats])
        median = float(np.median(friction))
        # The class of an instrument's continuous prediction is the nearest multiple of `STEP`.
        classes = friction if first["low"] is None else np.round(friction / STEP)
        names = ("material", "substrate", "reflective", "surrogate", "mu_ref", "mu_ref_error")
        result.append(
            {
                "pair": pair,
                **{name: first[name] for name in names},
                "predictions": friction.tolist(),
                "median": median,
                "error": float(distance(median, first["mu_ref"], first["mu_ref_error"])),
                "equal": bool(np.ptp(classes) == 0),
            }
        )
    return result


def capture_errors(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Return the errors of the pairs' medians, of all seeds of a model together, by subset."""
    pairs = [pair for of_seed in grouped(rows, "seed").values() for pair in pair_medians(of_seed)]
    off = np.array([pair["error"] for pair in pairs])
    return {name.split("_")[1]: off[chosen] for name, chosen in subsets(pairs).items()}


def capture_scores(rows: Sequence[Row]) -> dict[str, float]:
    """Return the scores of one model and seed on some captures.

    Those of `metrics.METRICS` that the model gives, and ``pairs``, their number. Fabrics count
    where they are ones that the model knows.
    """
    pairs = pair_medians(rows)
    answers = dataclasses.replace(
        answers_of(
            [
                row
                | {
                    "predicted_value": row["friction"],
                    "true_value": row["mu_ref"],
                    "reference_error": row["mu_ref_error"],
                    "simulation": row["video"],
                }
                for row in rows
            ]
        ),
        pair_errors=np.array([pair["error"] for pair in pairs]),
        pair_agrees=np.array([pair["equal"] for pair in pairs]),
    )
    scores = {**scores_of(answers, "friction", "capture"), "pairs": float(len(pairs))}
    if answers.intervals is not None:
        scores |= scores_of(answers, "interval")
    if len(answers.fabric_rank):
        scores |= scores_of(answers, "fabric")
    return scores


def capture_metrics(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the content of captures/metrics.json from the rows of predictions.parquet.

    ``{subset: {"model, trained on split": {field: number}}}``: means over seeds; ``spread`` holds
    the standard deviations over seeds, null of one seed.
    """
    metrics: dict[str, Any] = {}
    for name, chosen in subsets(rows).items():
        part = [row for row, one in zip(rows, chosen, strict=True) if one]
        metrics[name] = {}
        for of_model in grouped(part, "model", "trained_on").values():
            of_seeds = grouped(of_model, "seed")
            scores = [capture_scores(of_seed) for of_seed in of_seeds.values()]
            mean = mean_over_seeds(scores)
            seeds = sorted(seed for seed in of_seeds if seed is not None)
            metrics[name][label(of_model[0])] = {
                **mean,
                **entry(len(grouped(of_model, "video")), seeds, mean),
                "pairs": int(mean["pairs"]),
                "spread": spread_over_seeds(scores),
            }
    return metrics
