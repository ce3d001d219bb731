"""Probes: what tells a video's friction coefficient although it must not.

Before the cloth touches the floor nothing in a video depends on friction. A probe is fitted to the
training videos and asked of the test videos; if it is right more often than chance, something else
than contact gives the coefficient away. `sample` asks the linear probes, before any training;
`evaluation.test_sets` asks small networks as well, which need torch and a hundred times as long.
"""

from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any

import numpy as np
from scipy.linalg import solve
from scipy.stats import binom

from slipstitch.base.errors import BadInput
from slipstitch.config.train import BY_SIMULATION, REFLECTIVE, SPLITS, split_of
from slipstitch.dataset.videos import takes_part
from slipstitch.images.surroundings import of_a_family

#: Side of the images that probes see.
PIXELS = 32
#: Largest minus least colour of a pixel that must be cloth, of 255.
COLOURED = 25
#: What must tell nothing: name -> in words.
UNTOLD = {
    "first_frame": "the first frame",
    "background": "the first frame without the cloth",
    "file_size": "the size of the first frame's file",
    "order": "the place in the order of training",
}
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
    """Classes (n,) by a ridge regression on indicators of the classes."""
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
        seen = targets - mean if dual else known.T @ (targets - mean)
        solved = solve(whole, seen, assume_a="pos")
        weights = known.T @ solved if dual else solved
        answers = (features @ weights + mean).argmax(1)
        right = (answers == labels)[validation].mean() if validation.any() else 0.0
        found.append((right, answers))
    return max(found, key=lambda one: one[0])[1]


def chance_of(right: np.ndarray, labels: np.ndarray, simulations: Sequence[str]) -> float:
    """Probability that guessing is right at least as often; a simulation's videos count once."""
    names, first, place = np.unique(simulations, return_index=True, return_inverse=True)
    share = np.bincount(place, weights=right) / np.bincount(place)
    best_guess = np.bincount(labels[first]).max() / len(names)
    return float(binom.sf(np.floor(share.sum() + 1e-9) - 1, len(names), best_guess))


def refuse_leak(
    what: str, right: np.ndarray, labels: np.ndarray, simulations: Sequence[str]
) -> None:
    """Refuse videos whose coefficient is told by what must not tell it."""
    probability = chance_of(right, labels, simulations)
    if probability < SIGNIFICANCE:
        guess = np.bincount(labels).max() / len(labels)
        raise BadInput(
            f"{what} tells the friction coefficient of {right.mean():.0%} of {len(right)} test "
            f"videos without any contact (chance {guess:.0%}, probability {probability:.0e}): "
            "something that is drawn by the coefficient stands in the images"
        )


def probed_splits(rows: Sequence[Row]) -> tuple[str, ...]:
    """The splits and training sets in which a dataset must tell nothing.

    A camera of the family ``bench_1`` ... tells its simulation by video, where none may train then.
    """
    if any(of_a_family(row["viewpoint"]) for row in rows):
        return (BY_SIMULATION,)
    return (*SPLITS, REFLECTIVE) if any(is_probed(row, REFLECTIVE) for row in rows) else SPLITS


def is_probed(row: Row, trained_on: str) -> bool:
    """Whether a video takes part in the probes of a split or training set.

    Those of the second training set see its own floors alone: the others are probed by video.
    """
    return takes_part(row, trained_on) and (trained_on != REFLECTIVE or not takes_part(row))


def ever_cloth(images: np.ndarray) -> np.ndarray:
    """Where any of the images (n, side, side, 3) shows cloth: what is coloured."""
    return ((images.max(-1).astype(np.int16) - images.min(-1)) > COLOURED).any(0)


def untold_features(
    rows: Sequence[Row], frames: np.ndarray, sizes: np.ndarray, sides: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name in `UNTOLD` -> what the probe sees of every video, and the sides by which it learns."""
    views = np.array([row["viewpoint_id"] for row in rows])
    background = frames.copy()
    for view in set(views):
        seen = frames[views == view]
        background[views == view] = np.where(ever_cloth(seen)[..., None], 0, seen)
    # A size beside fabric, texture and viewpoint, and times each.
    scaled = (sizes - sizes.mean()) / max(sizes.std(), 1e-9)
    kinds = [np.ones((len(rows), 1))]
    for kind in ("material", "texture", "viewpoint"):
        number = np.unique([row[f"{kind}_id"] for row in rows], return_inverse=True)[1]
        kinds.append(np.eye(number.max() + 1)[number])
    known = np.hstack(kinds)
    # Half of the videos that train tells of the other half what their places in an epoch tell.
    training = np.flatnonzero(sides == "train")
    place = np.zeros(len(sides))
    place[np.random.default_rng([0, 0]).permutation(training)] = np.arange(1, len(training) + 1)
    waves = np.pi * (place / max(1, len(training)))[:, None] * 2.0 ** np.arange(8)
    halves = np.full(len(sides), "unused")
    halves[training[::2]], halves[training[1::2]] = "train", "test"
    return {
        "first_frame": (frames, sides),
        "background": (background, sides),
        "file_size": (np.hstack([known, known * scaled[:, None]]), sides),
        "order": (np.hstack([np.sin(waves), np.cos(waves)]), halves),
    }


def check_nothing_told(
    where: str, every: Sequence[Row], frames: np.ndarray, sizes: np.ndarray
) -> None:
    """Refuse a dataset of which a linear probe of `UNTOLD` tells the coefficient, in a split."""
    for split in probed_splits(every):
        chosen = np.array([is_probed(row, split) for row in every])
        rows = list(compress(every, chosen))
        labels = np.unique([row["friction_id"] for row in rows], return_inverse=True)[1]
        simulations = np.array([row["simulation"] for row in rows])
        sides = np.array([row[f"split_{split_of(split)}"] for row in rows])
        if len(set(labels)) < 2:
            continue
        seen_by = untold_features(rows, frames[chosen], sizes[chosen], sides)
        for name, (seen, by) in seen_by.items():
            test = by == "test"
            if not test.any() or not (by == "train").any():
                continue
            right = linear_answers(standardised(seen, by == "train"), labels, by) == labels
            what = f"{where}: split {split.replace('_', ' ')}: {UNTOLD[name]}"
            refuse_leak(what, right[test], labels[test], simulations[test])
