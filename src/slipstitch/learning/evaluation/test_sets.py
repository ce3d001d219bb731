"""The test sets of a dataset; invalid videos, to test an alarm; probes as rows of the tables.

Probes ask what a single frame tells, and what must tell nothing.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from slipstitch.config.train import REFLECTIVE, SPLITS, split_of
from slipstitch.dataset.manifest import read_manifest
from slipstitch.dataset.probes import (
    PIXELS,
    UNTOLD,
    ever_cloth,
    is_probed,
    linear_answers,
    probed_splits,
    refuse_leak,
    standardised,
    untold_features,
)
from slipstitch.dataset.videos import Videos, read_frames, read_videos, test_only
from slipstitch.learning.evaluation.scores import PROBE as PREFIX
from slipstitch.learning.prediction import classes_of, labels_of

Row = dict[str, Any]
OBJECT_SHARE = 0.45  # side of the foreign object, in shares of the image


@dataclass(frozen=True)
class EvaluationSet:
    """Videos that test the networks trained on one split."""

    name: str
    trained_on: str
    unseen: str = ""  # the one kind of `ROLES` of which they show what no network trains on
    of_split: str = ""  # whose test videos alone they are
    turn_deg: float | None = None  # of their view

    def holds(self, row: Row) -> bool:
        """Return whether the video of a manifest row is one."""
        return (
            test_only(row) == ({self.unseen} if self.unseen else set())
            and (not self.of_split or row[f"split_{self.of_split}"] == "test")
            and self.turn_deg in (None, row["viewpoint_turn_deg"])
        )


def evaluation_sets(rows: list[Row]) -> list[EvaluationSet]:
    """Return the test sets that a dataset has by its manifest, in the order of the tables.

    by_video, by_simulation: the split's test videos. off_grid, unseen_fabric: coefficients between
    those of the grid, and fabrics, that no network trains on, with the networks trained by
    simulation. unseen_texture, view_-15 ...: test-only textures, and views by their turn in
    degrees, with the networks trained by video on every simulation, as in the paper.
    reflective_floors, by_video_reflective: by_video's test videos on the floors of the second
    training set, with the networks that have not learnt from it, and with those that have.
    """

    turns = {row["viewpoint_turn_deg"] for row in rows if row["viewpoint_role"] == "test"}
    sets = [
        *(EvaluationSet(split, split, of_split=split) for split in SPLITS),
        EvaluationSet("off_grid", "by_simulation", "friction"),
        EvaluationSet("unseen_texture", "by_video", "texture"),
        EvaluationSet("unseen_fabric", "by_simulation", "material"),
        *(
            EvaluationSet(f"view_{turn:+.0f}", "by_video", "viewpoint", turn_deg=turn)
            for turn in sorted(turns)
        ),
        EvaluationSet("reflective_floors", "by_video", "floor", "by_video"),
        EvaluationSet(REFLECTIVE, REFLECTIVE, "floor", "by_video"),
    ]
    return [test for test in sets if any(map(test.holds, rows))]


def wrong_inputs(videos: np.ndarray) -> dict[str, np.ndarray]:
    """Return, by kind, invalid videos, as many as given: uint8 (n, frames, side, side, 3).

    ``protocol`` is the first half of the motion at half the speed, ``object`` the empty scene with
    a rigid chequered box in place of the cloth, ``upside_down`` of a camera turned over.
    """
    random = np.random.default_rng(0)
    count = videos.shape[1]
    empty = _empty(videos, random)
    return {
        "reversed": videos[:, ::-1],
        "protocol": videos[:, np.arange(count) // 2],
        "frozen": np.repeat(videos[:, :1], count, axis=1),
        "shuffled": np.stack([video[random.permutation(count)] for video in videos]),
        "empty": empty,
        "object": _with_box(empty),
        "upside_down": videos[:, :, ::-1],
    }


def _empty(videos: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The scene: pixels' medians, where no cloth ever is, drawn along the rows elsewhere; noisy."""
    images = videos.reshape(-1, *videos.shape[2:])
    covered = ever_cloth(images)
    scene = np.median(images, axis=0)
    places = np.arange(scene.shape[1])
    for row, cover in zip(scene, covered, strict=True):
        if cover.any() and not cover.all():
            for colour in range(3):
                row[cover, colour] = np.interp(places[cover], places[~cover], row[~cover, colour])
    return np.clip(scene + random.normal(0.0, 1.0, videos.shape), 0, 255).astype(np.uint8)


def _with_box(empty: np.ndarray) -> np.ndarray:
    """A chequered box in the middle of every frame, where the crop keeps what the stage holds."""
    side = empty.shape[2]
    low, high = (round(side * (1 + sign * OBJECT_SHARE) / 2) for sign in (-1, 1))
    y, x = np.indices((high - low, high - low))
    squares = ((x // 4 + y // 4) % 2)[..., None]
    result = empty.copy()
    result[:, :, low:high, low:high] = np.where(squares, (200, 60, 40), (230, 220, 200))
    return result


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
    """Classes by a network with one hidden layer, stopped by the validation videos; seeded."""
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
    """Name of a probe -> what it sees of every video, and the sides by which it learns."""
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

    `videos` have two frames. BadInput if a probe that must be at chance is not.
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
