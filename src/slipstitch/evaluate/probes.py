"""Probes as rows of the tables: what a single frame tells, and what must tell nothing."""

import os
from typing import Any

import numpy as np
import torch
from torch import nn

from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.evaluate.metrics import chance, confusion, constant_error, entry, friction_scores
from slipstitch.evaluate.wrong_inputs import ever_cloth
from slipstitch.sample.images import read_frames
from slipstitch.sample.probes import (
    PIXELS,
    linear_answers,
    probed_splits,
    refuse_leak,
    standardised,
)
from slipstitch.sample.videos import Videos, read_videos, takes_part
from slipstitch.train.classes import classes_of, labels_of

PREFIX = "probe_"
#: The one probe that may tell something: of a frame in the middle of the film.
MIDDLE_FRAME = f"{PREFIX}middle_frame"
#: Name -> what it sees, in words.
WHAT = {
    MIDDLE_FRAME: "one frame from the middle",
    f"{PREFIX}first_frame": "the first frame",
    f"{PREFIX}background": "the first frame without the cloth",
    f"{PREFIX}file_size": "the size of the first frame's file",
    f"{PREFIX}order": "the place in the order of training",
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
    views = np.array([row["viewpoint_id"] for row in videos.rows])
    background = first.copy()
    for view in set(views):
        seen = first[views == view]
        background[views == view] = np.where(ever_cloth(seen)[..., None], 0, seen)
    # Half of the videos that train tells of the other half what their places in an epoch tell.
    training = np.flatnonzero(sides == "train")
    place = np.zeros(len(sides))
    place[np.random.default_rng([0, 0]).permutation(training)] = np.arange(1, len(training) + 1)
    waves = np.pi * (place / max(1, len(training)))[:, None] * 2.0 ** np.arange(8)
    halves = np.full(len(sides), "unused")
    halves[training[::2]], halves[training[1::2]] = "train", "test"
    return {
        MIDDLE_FRAME: (middle, sides),
        f"{PREFIX}first_frame": (first, sides),
        f"{PREFIX}background": (background, sides),
        f"{PREFIX}file_size": (_sizes(dataset, videos), sides),
        f"{PREFIX}order": (np.hstack([np.sin(waves), np.cos(waves)]), halves),
    }


def _sizes(dataset: str | os.PathLike, videos: Videos) -> np.ndarray:
    """Size of the first frame's file, beside fabric, texture and viewpoint, and times each."""
    wanted = {row["video"] for row in videos.rows}
    size = {
        video: len(png)
        for file in sorted({row["file"] for row in videos.rows})
        for video, position, png in read_frames(os.path.join(dataset, file))
        if position == 0 and video in wanted
    }
    sizes = np.array([size[row["video"]] for row in videos.rows], dtype=float)
    sizes = (sizes - sizes.mean()) / max(sizes.std(), 1e-9)
    known = []
    for kind in ("material", "texture", "viewpoint"):
        number = np.unique([row[f"{kind}_id"] for row in videos.rows], return_inverse=True)[1]
        known.append(np.eye(number.max() + 1)[number])
    kinds = np.hstack([np.ones((len(sizes), 1)), *known])
    return np.hstack([kinds, kinds * sizes[:, None]])


def probe_split(
    settings: EvaluateSettings, dataset: str | os.PathLike, videos: Videos, split: str
) -> dict[str, dict[str, Any]]:
    """Entries of details.json for every probe in one split.

    Raises
    ------
    BadInput
        If a probe that must be at chance is not.
    """
    sides = np.array([row[f"split_{split}"] for row in videos.rows])
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
    """`probe_split` of the splits that must tell nothing, of the videos that may train."""
    videos = read_videos(dataset, takes_part, PIXELS, 2)
    splits = probed_splits(row["viewpoint"] for row in videos.rows)
    return {split: probe_split(settings, dataset, videos, split) for split in splits}


def entries(of_split: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Entries of metrics.json."""
    return {name: entry(one["n"], [0], one["mean"]) for name, one in of_split.items()}
