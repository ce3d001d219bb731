"""Probes: what tells a video's friction coefficient although it must not.

Before the cloth touches the floor nothing in a video depends on friction. A probe is fitted to the
training videos and asked of the test videos; if it is right more often than chance, something else
than contact gives the coefficient away, and every network's score may rest on that.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import solve
from scipy.stats import binom

from slipstitch.config.train import BY_SIMULATION, SPLITS
from slipstitch.errors import BadInput
from slipstitch.render.surroundings import of_a_family

#: Side of the images that probes see.
PIXELS = 32
#: A probe counts as above chance if chance gives as much so rarely.
SIGNIFICANCE = 1e-3
# Tried on the validation videos: ridge over the number of training videos.
_RIDGES = (1e-4, 1e-2, 1.0)

Row = Mapping[str, Any]


def standardised(features: np.ndarray, training: np.ndarray) -> np.ndarray:
    """Features (n, d) less their training mean, over their training deviation; float32."""
    features = features.reshape(len(features), -1).astype(np.float32)
    mean, deviation = features[training].mean(0), features[training].std(0)
    return (features - mean) / np.where(deviation > 1e-6, deviation, 1.0)


def linear_answers(features: np.ndarray, labels: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Classes by a ridge regression on indicators of the classes.

    Parameters
    ----------
    features : ndarray, shape (n, d)
        As `standardised` returns them.
    labels : ndarray of int, shape (n,)
    sides : ndarray of str, shape (n,)
        train, validation or test; validation videos choose the ridge.

    Returns
    -------
    ndarray of int, shape (n,)
    """
    train, validation = sides == "train", sides == "validation"
    known = features[train].astype(np.float64)
    targets = np.eye(labels.max() + 1)[labels[train]]
    mean = targets.mean(0)
    # In whichever of the two forms has the smaller matrix.
    dual = known.shape[0] < known.shape[1]
    gram = known @ known.T if dual else known.T @ known
    found = []
    for ridge in _RIDGES:
        whole = gram + ridge * len(known) * np.eye(len(gram))
        if dual:
            weights = known.T @ solve(whole, targets - mean, assume_a="pos")
        else:
            weights = solve(whole, known.T @ (targets - mean), assume_a="pos")
        answers = (features @ weights + mean).argmax(1)
        right = (answers == labels)[validation].mean() if validation.any() else 0.0
        found.append((right, answers))
    return max(found, key=lambda one: one[0])[1]


def chance_of(right: np.ndarray, labels: np.ndarray, simulations: Sequence[str]) -> float:
    """Probability that guessing is right at least as often; the videos of a simulation count once.

    Parameters
    ----------
    right : ndarray of bool, shape (n,)
    labels : ndarray of int, shape (n,)
    simulations : sequence of str, length n
    """
    names, first, place = np.unique(simulations, return_index=True, return_inverse=True)
    share = np.bincount(place, weights=right) / np.bincount(place)
    best_guess = np.bincount(labels[first]).max() / len(names)
    return float(binom.sf(np.floor(share.sum() + 1e-9) - 1, len(names), best_guess))


def refuse_leak(
    what: str, right: np.ndarray, labels: np.ndarray, simulations: Sequence[str]
) -> None:
    """Refuse videos whose coefficient is told by what must not tell it.

    Parameters
    ----------
    what : str
        Dataset, split and probe, for the message.
    right, labels, simulations
        Of the test videos, as `chance_of` takes them.

    Raises
    ------
    BadInput
    """
    probability = chance_of(right, labels, simulations)
    if probability < SIGNIFICANCE:
        guess = np.bincount(labels).max() / len(labels)
        raise BadInput(
            f"{what} tells the friction coefficient of {right.mean():.0%} of {len(right)} test "
            f"videos without any contact (chance {guess:.0%}, probability {probability:.0e}): "
            "something that is drawn by the coefficient stands in the images"
        )


def probed_splits(viewpoints: Iterable[str]) -> tuple[str, ...]:
    """The splits in which a dataset filmed from viewpoints of the catalogue must tell nothing.

    A camera of the family ``bench_1`` ... is one simulation's own, and tells it in the split by
    video, which the configuration therefore refuses to train with.
    """
    return (BY_SIMULATION,) if any(map(of_a_family, viewpoints)) else SPLITS


def check_first_frames(where: str, rows: Sequence[Row], frames: np.ndarray) -> None:
    """Refuse a dataset whose first frames tell the coefficient, by a linear probe, in a split.

    Parameters
    ----------
    where : str
        Names the dataset.
    rows : sequence of mappings
        Of the manifest, of the videos that may train.
    frames : ndarray of uint8, shape (n, side, side, 3)

    Raises
    ------
    BadInput
    """
    labels = np.unique([row["friction_id"] for row in rows], return_inverse=True)[1]
    for split in probed_splits(row["viewpoint"] for row in rows):
        sides = np.array([row[f"split_{split}"] for row in rows])
        test = sides == "test"
        if not test.any() or len(set(labels)) < 2:
            continue
        features = standardised(frames, sides == "train")
        right = linear_answers(features, labels, sides) == labels
        names = [row["simulation"] for row, tests in zip(rows, test, strict=True) if tests]
        what = f"{where}: split {split.replace('_', ' ')}: the first frame"
        refuse_leak(what, right[test], labels[test], names)
