"""Probes as rows of the tables: what a single frame tells, and what must tell nothing."""

import os
from typing import Any

import numpy as np
import torch
from torch import nn

from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.config.train import split_of
from slipstitch.dataset.images import read_frames
from slipstitch.dataset.manifest import read_manifest
from slipstitch.dataset.probes import (
    PIXELS,
    UNTOLD,
    is_probed,
    linear_answers,
    probed_splits,
    refuse_leak,
    standardised,
    untold_features,
)
from slipstitch.dataset.videos import Videos, read_videos
from slipstitch.learning.classes import classes_of, labels_of
from slipstitch.learning.evaluation.metrics import (
    chance,
    confusion,
    constant_error,
    entry,
    friction_scores,
)

PREFIX = "probe_"
#: The one probe that may tell something: of a frame in the middle of the film.
MIDDLE_FRAME = f"{PREFIX}middle_frame"
#: Name -> what it sees, in words.
WHAT = {
    MIDDLE_FRAME: "one frame from the middle",
    **{f"{PREFIX}{name}": words for name, words in UNTOLD.items()},
}
NETWORK = "_network"
_HIDDEN, _STEPS, _RATE, _DECAY = 64, 300, 3e-3, 1e-3


def network_answers(features: np.ndarray, labels: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Classes by a network with one hidden layer, as `linear_answers` gives them; seeded.

    Validation videos choose the step at which it stops, among every twentieth.
    """
    torch.manual_seed(0)
    inputs, classes = torch.from_numpy(features), torch.from_numpy(labels)
    train, validation = (torch.from_numpy(sides == name) for name in ("train", "validation"))
    network = nn.Sequential(
        nn.Linear(inputs.shape[1], _HIDDEN), nn.ReLU(), nn.Linear(_HIDDEN, int(labels.max()) + 1)
    )
    optimizer = torch.optim.AdamW(network.parameters(), _RATE, weight_decay=_DECAY)
    best: tuple[float, Any] = (-1.0, None)
    for step in range(1, _STEPS + 1):
        loss = nn.functional.cross_entropy(network(inputs[train]), classes[train])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 20 == 0:
            with torch.inference_mode():
                answers = network(inputs).argmax(1)
            right = (answers == classes)[validation].double().mean().item()
            if not right <= best[0]:  # the last one where nothing validates
                best = (right, answers)
    return best[1].numpy()


def probe_features(
    dataset: str | os.PathLike, videos: Videos, sides: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name of a probe -> what it sees of every video, and the sides by which it learns.

    Parameters
    ----------
    dataset : path
    videos : Videos
        Two frames of each: the first and one in the middle.
    sides : ndarray of str
        Of the split.
    """
    first, middle = videos.pixels[:, 0], videos.pixels[:, 1]
    untold = untold_features(videos.rows, first, _sizes(dataset, videos), sides)
    seen = {f"{PREFIX}{name}": features for name, features in untold.items()}
    return {MIDDLE_FRAME: (middle, sides)} | seen


def _sizes(dataset: str | os.PathLike, videos: Videos) -> np.ndarray:
    """Bytes of the first frames' files."""
    wanted = {row["video"] for row in videos.rows}
    size = {
        video: len(png)
        for file in sorted({row["file"] for row in videos.rows})
        for video, position, png in read_frames(os.path.join(dataset, file))
        if position == 0 and video in wanted
    }
    return np.array([size[row["video"]] for row in videos.rows])


def probe_split(
    settings: EvaluateSettings, dataset: str | os.PathLike, videos: Videos, split: str
) -> dict[str, dict[str, Any]]:
    """Entries of details.json for every probe in one split.

    Parameters
    ----------
    settings : EvaluateSettings
    dataset : path
    videos : Videos
        Those that `is_probed` in the split, two frames of each, the first and one in the middle.
    split : str
        One of `slipstitch.config.train.TRAINED_ON`.

    Raises
    ------
    BadInput
        If a probe that must be at chance is not.
    """
    sides = np.array([row[f"split_{split_of(split)}"] for row in videos.rows])
    classes = classes_of(videos.rows, "friction")
    labels = labels_of(videos.rows, classes, "friction")
    values = np.array([of_class["value"] for of_class in classes])
    simulations = np.array([row["simulation"] for row in videos.rows])
    result = {}
    for name, (seen, by) in probe_features(dataset, videos, sides).items():
        features, test = standardised(seen, by == "train"), by == "test"
        for learner, learn in (("", linear_answers), (NETWORK, network_answers)):
            if not (by == "train").any() or not test.any():
                continue
            answers = learn(features, labels, by)
            if name != MIDDLE_FRAME:
                what = f"{dataset}: split {split.replace('_', ' ')}: {WHAT[name]}"
                right = (answers == labels)[test]
                refuse_leak(what, right, labels[test], simulations[test])
            said, true = values[answers[test]], values[labels[test]]
            scores = friction_scores(said, true, settings.friction_step)
            result[name + learner] = {
                "n": int(test.sum()),
                "simulations": len(set(simulations[test])),
                "trained_on": split,
                "classes": classes,
                "chance": chance(labels[test], len(classes))
                | {"mean_absolute_error": constant_error(true)},
                "mean": scores,
                "spread": None,
                "seeds": {"0": scores},
                "confusion": confusion(np.eye(len(classes))[answers[test]], labels[test]),
            }
    return result


def probes(settings: EvaluateSettings, dataset: str | os.PathLike) -> dict[str, dict[str, Any]]:
    """`probe_split` of the splits that must tell nothing, of the videos of each."""
    splits = probed_splits(read_manifest(dataset)[0])
    videos = read_videos(
        dataset, lambda row: any(is_probed(row, split) for split in splits), PIXELS, 2
    )
    result = {}
    for split in splits:
        chosen = videos.chosen(np.array([is_probed(row, split) for row in videos.rows]))
        result[split] = probe_split(settings, dataset, chosen, split)
    return result


def entries(of_split: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Entries of metrics.json."""
    return {name: entry(one["n"], [0], one["mean"]) for name, one in of_split.items()}
