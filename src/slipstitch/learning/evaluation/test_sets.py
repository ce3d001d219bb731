"""The test sets of a dataset."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from slipstitch.config.train import REFLECTIVE, SPLITS
from slipstitch.dataset.videos import takes_part, test_only

Row = dict[str, Any]


@dataclass(frozen=True)
class EvaluationSet:
    """Videos that test the networks trained on one split."""

    name: str
    trained_on: str
    holds: Callable[[Row], bool]


def evaluation_sets(
    rows: list[dict[str, Any]], calibrated: str, viewpoints: str
) -> list[EvaluationSet]:
    """Return the test sets that a dataset has, in the order of the tables.

    by_video, by_simulation: the split's test videos in training textures and views.
    off_grid, unseen_fabric: friction coefficients between those of the grid, and fabrics that no
    network trains on, with the networks trained by simulation.
    unseen_texture: test-only textures in training views; view_-15 ...: test-only views by their
    turn from the calibrated one, in degrees, in training textures. Both test the networks trained
    by video on every simulation, as the paper does: the texture or the view is new to them, the
    cloth's motion is not.
    reflective_floors, by_video_reflective: by_video's test videos on the floors of the second
    training set, with the networks that have not learnt from it, and with those that have.

    Parameters
    ----------
    rows : list of dict
        The manifest.
    calibrated : str
        Name of the calibrated viewpoint.
    viewpoints : {"training", "calibrated"}
        Training views to count.
    """

    def counts(row: Row) -> bool:
        return viewpoints == "training" or row["viewpoint"] == calibrated

    def of_split(split: str, row: Row) -> bool:
        return takes_part(row) and counts(row) and row[f"split_{split}"] == "test"

    def unseen(kind: str, row: Row) -> bool:
        return counts(row) and test_only(row) == {kind}

    def turned(turn_deg: float, row: Row) -> bool:
        return test_only(row) == {"viewpoint"} and row["viewpoint_turn_deg"] == turn_deg

    def mirrored(row: Row) -> bool:
        return counts(row) and test_only(row) == {"floor"} and row["split_by_video"] == "test"

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
