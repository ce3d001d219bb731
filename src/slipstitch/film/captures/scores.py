"""Scores of predictions for captures, by the paper's protocol for real videos (Sec. 6.3).

The reference of a pair is an interval, r +- e: the error of a prediction is its distance from the
interval, 0 inside. Of a pair's repeats the median counts; pairs whose repeats are all given the
same friction, to half a grid step, are counted. Reflective substrates are evaluated separately.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipstitch.learning.evaluation.metrics import PredictionsAndTruth, distance, scores_of


@dataclass(frozen=True)
class Predictions:
    """Predictions of one trained model for all captures.

    Attributes
    ----------
    model : str
        lrcn_baseline, lrcn_conditional, instrument, instrument_ensemble.
    trained_on : str
        The split.
    seed : int or None
        None of an average of seeds.
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
    seed: int | None
    friction: np.ndarray
    intervals: np.ndarray | None = None
    materials: list[list[str]] = field(default_factory=list)
    known_materials: list[str] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)

    @property
    def label(self) -> str:
        """The model and what it was trained on, whatever the seed."""
        return f"{self.model}, trained {self.trained_on}"


def what_they_are(known: Sequence[Mapping[str, Any]]) -> str:
    """Kind of the videos: the first line of every page about them."""
    if known[0]["surrogate"]:
        return (
            "Surrogate captures: simulated videos with a distribution shift from the training "
            "data. Nothing on this page was measured on a real bench."
        )
    return "Real captures: videos of a bench, with friction measured on an inclined plane."


def subsets(known: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Name -> which captures: all, without reflective substrates, reflective only."""
    reflective = np.array([row["reflective"] for row in known])
    prefix = "surrogate" if known[0]["surrogate"] else "real"
    parts = {"all": np.ones(len(known), bool), "matte": ~reflective, "reflective": reflective}
    return {f"{prefix}_{name}": chosen for name, chosen in parts.items() if chosen.any()}


def pair_medians(
    known: Sequence[Mapping[str, Any]], predictions: Predictions, chosen: np.ndarray, step: float
) -> list[dict[str, Any]]:
    """One row per pair: reference, predictions of the repeats, their median and its error."""
    members: dict[str, list[int]] = defaultdict(list)
    for k in np.flatnonzero(chosen):
        members[known[k]["pair"]].append(int(k))
    rows = []
    for pair, repeats in sorted(members.items()):
        first = known[repeats[0]]
        friction = predictions.friction[repeats]
        median = float(np.median(friction))
        # The class of an instrument's continuous answer is the nearest multiple of the grid's step.
        classes = np.round(friction / step) if predictions.intervals is not None else friction
        rows.append(
            {
                "pair": pair,
                "material": first["material"],
                "substrate": first["substrate"],
                "reflective": first["reflective"],
                "mu_ref": first["mu_ref"],
                "mu_ref_error": first["mu_ref_error"],
                "predictions": friction.tolist(),
                "median": median,
                "error": float(distance(median, first["mu_ref"], first["mu_ref_error"])),
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
        Those of `metrics.METRICS` that the model gives, and ``pairs``, their
        number.
    """
    pairs = pair_medians(known, predictions, chosen, step)
    places = _places(chosen)
    named = [place for place in places if known[place]["material"] in predictions.known_materials]
    answers = PredictionsAndTruth(
        step,
        predictions.friction[chosen],
        np.array([row["mu_ref"] for row in known])[chosen],
        np.array([row["mu_ref_error"] for row in known])[chosen],
        None if predictions.intervals is None else predictions.intervals[chosen],
        alarms=np.array([bool(predictions.alarms[place]) for place in places])
        if predictions.alarms
        else None,
        pair_errors=np.array([pair["error"] for pair in pairs]),
        pair_agrees=np.array([pair["equal"] for pair in pairs]),
        fabric_rank=np.array(
            [predictions.materials[place].index(known[place]["material"]) for place in named]
        )
        if predictions.materials
        else None,
    )
    scores: dict[str, float | None] = {
        **scores_of(answers, "friction", "capture"),
        "pairs": float(len(pairs)),
    }
    if predictions.intervals is not None:
        scores |= scores_of(answers, "interval")
    if named and predictions.materials:
        scores |= scores_of(answers, "fabric")
    return scores


def _places(chosen: np.ndarray) -> list[int]:
    return np.flatnonzero(chosen).tolist()
