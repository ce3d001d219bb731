"""The test sets of a dataset, and invalid videos made from valid ones to test an alarm."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from slipstitch.config.train import REFLECTIVE, SPLITS
from slipstitch.dataset.probes import ever_cloth
from slipstitch.dataset.videos import takes_part, test_only

Row = dict[str, Any]
OBJECT_SHARE = 0.45  # side of the foreign object, in shares of the image


@dataclass(frozen=True)
class EvaluationSet:
    """Videos that test the networks trained on one split."""

    name: str
    trained_on: str
    holds: Callable[[Row], bool]


def evaluation_sets(rows: list[Row]) -> list[EvaluationSet]:
    """Return the test sets that a dataset has by its manifest, in the order of the tables.

    by_video, by_simulation: the split's test videos in training textures and views. off_grid,
    unseen_fabric: friction coefficients between those of the grid, and fabrics that no network
    trains on, with the networks trained by simulation. unseen_texture: test-only textures in
    training views; view_-15 ...: test-only views by their turn from the calibrated one, in
    degrees, in training textures. Both test the networks trained by video on every simulation,
    as the paper does: the texture or the view is new to them, the cloth's motion is not.
    reflective_floors, by_video_reflective: by_video's test videos on the floors of the second
    training set, with the networks that have not learnt from it, and with those that have.
    """

    def of_split(split: str, row: Row) -> bool:
        return takes_part(row) and row[f"split_{split}"] == "test"

    def unseen(kind: str, row: Row) -> bool:
        return test_only(row) == {kind}

    def turned(turn_deg: float, row: Row) -> bool:
        return test_only(row) == {"viewpoint"} and row["viewpoint_turn_deg"] == turn_deg

    def mirrored(row: Row) -> bool:
        return test_only(row) == {"floor"} and row["split_by_video"] == "test"

    turns = {row["viewpoint_turn_deg"] for row in rows if row["viewpoint_role"] == "test"}
    sets = [
        *(EvaluationSet(split, split, partial(of_split, split)) for split in SPLITS),
        EvaluationSet("off_grid", "by_simulation", partial(unseen, "friction")),
        EvaluationSet("unseen_texture", "by_video", partial(unseen, "texture")),
        EvaluationSet("unseen_fabric", "by_simulation", partial(unseen, "material")),
        *(
            EvaluationSet(f"view_{turn:+.0f}", "by_video", partial(turned, turn))
            for turn in sorted(turns)
        ),
        EvaluationSet("reflective_floors", "by_video", mirrored),
        EvaluationSet(REFLECTIVE, REFLECTIVE, mirrored),
    ]
    return [test for test in sets if any(map(test.holds, rows))]


def wrong_inputs(videos: np.ndarray) -> dict[str, np.ndarray]:
    """Return, by kind, invalid videos, as many as given.

    reversed     the frames in reverse order
    protocol     the first half of the motion only, at half the speed
    frozen       the first frame all along
    shuffled     the frames in random order
    empty        the scene without cloth
    object       the empty scene with a rigid chequered box in place of the cloth
    upside_down  the camera turned over

    Parameters
    ----------
    videos : ndarray of uint8, shape (n, frames, side, side, 3)
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
    """The scene: its pixels' medians, where no cloth ever is, drawn along the rows elsewhere.

    The cloth is the coloured part, the rest of a rendering is grey. Every frame gets the camera's
    noise of one grey level.
    """
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
