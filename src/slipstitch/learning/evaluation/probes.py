"""Probes as rows of the tables: what a single frame tells, and what must tell nothing."""

import os
from collections.abc import Iterator
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

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
from slipstitch.learning.evaluation.scores import PROBE as PREFIX

Row = dict[str, Any]
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
    dataset: str | Path, videos: Videos, sides: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name of a probe -> what it sees of every video, and the sides by which it learns.

    Of videos of two frames, the first and one in the middle; `sides` are those of the split.
    """
    first, middle = videos.pixels[:, 0], videos.pixels[:, 1]
    untold = untold_features(videos.rows, first, _sizes(dataset, videos), sides)
    seen = {f"{PREFIX}{name}": features for name, features in untold.items()}
    return {MIDDLE_FRAME: (middle, sides)} | seen


def _sizes(dataset: str | Path, videos: Videos) -> np.ndarray:
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
    dataset: str | Path, videos: Videos, split: str
) -> Iterator[tuple[str, str, list[Row], list[Row]]]:
    """Give the predictions of every probe in one split: split, network, classes, rows of the table.

    `videos` are those that `is_probed` in the split, two frames of each, the first and one in
    the middle; the rows are what predictions.parquet says of the test videos. BadInput if a
    probe that must be at chance is not.
    """
    sides = np.array([row[f"split_{split_of(split)}"] for row in videos.rows])
    classes = classes_of(videos.rows, "friction")
    labels = labels_of(videos.rows, classes, "friction")
    simulations = np.array([row["simulation"] for row in videos.rows])
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
            rows = [
                {
                    **{key: row[key] for key in ("video", "simulation", "texture", "viewpoint")},
                    "true": row["friction_id"],
                    "predicted": classes[answer]["id"],
                    "true_value": classes[label]["value"],
                    "predicted_value": classes[answer]["value"],
                    "material": row["material"],
                }
                for row, answer, label in compress(
                    zip(videos.rows, answers, labels, strict=True), test
                )
            ]
            yield split, name + learner, classes, rows


def probes(dataset: str | Path) -> Iterator[tuple[str, str, list[Row], list[Row]]]:
    """Give what `probe_split` gives of the splits that must tell nothing."""
    splits = probed_splits(read_manifest(dataset)[0])
    videos = read_videos(
        dataset, lambda row: any(is_probed(row, split) for split in splits), PIXELS, 2
    )
    for split in splits:
        chosen = videos.chosen(np.array([is_probed(row, split) for row in videos.rows]))
        yield from probe_split(dataset, chosen, split)
