"""The numbers of the tables, from true classes and predicted probabilities."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slipstitch.errors import BadInput

# Every entry of metrics.json has all of these; null where the model does not give the quantity.
FIELDS = (
    "n",
    "friction_lt_0.1",
    "friction_lt_0.2",
    "mean_absolute_error",
    "material_top1",
    "material_top2",
    "coverage_90",
    "interval_width",
    "seeds",
)


def check_probabilities(probabilities: np.ndarray, truth: np.ndarray) -> None:
    """Refuse arrays that are no predictions: wrong shape, not finite, not summing to one.

    Parameters
    ----------
    probabilities : ndarray, shape (n, classes)
    truth : ndarray of int, shape (n,)

    Raises
    ------
    BadInput
    """
    if probabilities.ndim != 2 or truth.shape != probabilities.shape[:1] or not len(truth):
        raise BadInput(
            f"predictions of shape {probabilities.shape} do not go with {truth.shape} true classes"
        )
    if (
        not np.isfinite(probabilities).all()
        or probabilities.min() < 0
        or abs(probabilities.sum(1) - 1).max() > 1e-4
    ):
        raise BadInput("predictions are no probabilities: finite, not negative, sum 1 are needed")
    if truth.min() < 0 or truth.max() >= probabilities.shape[1]:
        raise BadInput(f"a true class is outside 0 ... {probabilities.shape[1] - 1}")


def top_k(probabilities: np.ndarray, truth: np.ndarray, k: int) -> float:
    """Share of the rows whose true class is among the k likeliest."""
    best = np.argsort(-probabilities, axis=1, kind="stable")[:, :k]
    return float((best == truth[:, None]).any(1).mean())


def steps_off(predicted: np.ndarray, true: np.ndarray, step: float) -> np.ndarray:
    """Error in grid steps: |predicted - true| / step rounded half up, int64.

    The paper's "error < 0.1" on its grid of 0.1 is 0 steps (the exact class), "error < 0.2" at most
    1 step (the class or a neighbour), so that off the grid |error| < 0.05 and < 0.15 count.
    """
    return np.floor(np.abs(predicted - true) / step + 0.5 + 1e-9).astype(np.int64)


def friction_scores(predicted: np.ndarray, true: np.ndarray, step: float) -> dict[str, float]:
    """Scores of predicted friction coefficients, on the grid or off it.

    Parameters
    ----------
    predicted, true : ndarray, shape (n,)
    step : float
        Grid step, 0.1 in the paper.

    Returns
    -------
    dict
        ``friction_lt_0.1``, ``friction_lt_0.2`` (shares in 0 ... 1), ``mean_absolute_error``.
    """
    off = steps_off(predicted, true, step)
    return {
        "friction_lt_0.1": float((off == 0).mean()),
        "friction_lt_0.2": float((off <= 1).mean()),
        "mean_absolute_error": float(np.abs(predicted - true).mean()),
    }


def material_scores(probabilities: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """``material_top1`` and ``material_top2``, shares in 0 ... 1."""
    check_probabilities(probabilities, truth)
    return {
        "material_top1": top_k(probabilities, truth, 1),
        "material_top2": top_k(probabilities, truth, 2),
    }


def chance(truth: np.ndarray, classes: int) -> dict[str, float]:
    """What ignoring the video gives: a uniform guess, and always the test set's largest class."""
    return {
        "uniform": 1.0 / classes,
        "majority": float(np.bincount(truth, minlength=classes).max() / len(truth)),
    }


def constant_error(true: np.ndarray) -> float:
    """Least mean absolute error of one coefficient said of every video: that of the median."""
    return float(np.abs(true - np.median(true)).mean())


def confusion(probabilities: np.ndarray, truth: np.ndarray) -> list[list[int]]:
    """Counts: row = true class, column = predicted class."""
    classes = probabilities.shape[1]
    counts = np.zeros((classes, classes), np.int64)
    np.add.at(counts, (truth, probabilities.argmax(1)), 1)
    return counts.tolist()


def _common(scores: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Score -> its values, of those that all trainings have."""
    names = [name for name in scores[0] if all(name in score for score in scores)]
    return {name: [score[name] for score in scores] for name in names}


def mean_over_seeds(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The mean of every score over trainings that differ by the seed."""
    return {name: float(np.mean(values)) for name, values in _common(scores).items()}


def spread_over_seeds(scores: Sequence[Mapping[str, float]]) -> dict[str, float] | None:
    """Standard deviation (n - 1) of every score over the seeds; None of one seed only."""
    if len(scores) < 2:
        return None
    return {name: float(np.std(values, ddof=1)) for name, values in _common(scores).items()}


def entry(n: int, seeds: list[int], *scores: dict[str, float]) -> dict[str, Any]:
    """An entry of metrics.json: every field of `FIELDS`, None where no score is given."""
    known: dict[str, Any] = {"n": n, "seeds": seeds}
    for score in scores:
        known |= score
    return {name: known.get(name) for name in FIELDS}
