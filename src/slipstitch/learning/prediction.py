"""What models tell of a video, and the classes of material or friction that some tell apart."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr

from slipstitch.base.errors import BadInput


@dataclass(frozen=True)
class Prediction:
    """What a model predicts for one video."""

    # likeliest class, or an instrument's median; NaN of a network that predicts the fabric alone
    friction_coefficient: float = math.nan
    # values of mu, and the probability of each of them, both of shape (G,)
    distribution: tuple[np.ndarray, np.ndarray] | None = None
    # conformal interval, (low, high); the whole grid where too few simulations calibrate it
    interval_90: tuple[float, float] | None = None
    # fabric -> probability; empty if the model does not predict it
    material_probabilities: dict[str, float] = field(default_factory=dict)
    # whether the video is unlike the training data; None of a model without such an alarm
    alarm: bool | None = None
    alarm_reason: str = ""  # why; empty without alarm
    # (frames,): weight of each frame in the decision, sum 1
    attention_weights: np.ndarray | None = None
    # (frames, points, 3): `slipstitch.images.camera.KEYPOINTS_UV`, if the model predicts them
    points_m: np.ndarray | None = None

    @property
    def fabrics(self) -> list[str]:
        """Return the fabrics from the likeliest on."""
        names, shares = list(self.material_probabilities), [*self.material_probabilities.values()]
        return [names[k] for k in np.argsort(-np.array(shares), kind="stable")]


def classes_of(rows: list[dict[str, Any]], target: str) -> list[dict[str, Any]]:
    """Return the classes in manifest rows, in the order of their ids: ``{id, name | value}``.

    An interpolated video belongs to the class of its simulation, the nearest, and defines none.
    """
    key = "name" if target == "material" else "value"
    rows = [row for row in rows if target == "material" or not row.get("interpolated")]
    found = {row[f"{target}_id"]: row[target] for row in rows}
    return [{"id": class_id, key: found[class_id]} for class_id in sorted(found)]


def labels_of(rows: list[dict[str, Any]], classes: list[dict[str, Any]], target: str) -> np.ndarray:
    """Class numbers of videos, int64 of shape (n,); BadInput for a class that is not listed."""
    number = {entry["id"]: index for index, entry in enumerate(classes)}
    try:
        return np.array([number[row[f"{target}_id"]] for row in rows], np.int64)
    except KeyError as unknown:
        raise BadInput(
            f"a video has {target} {unknown.args[0]}, known classes: {', '.join(number)}"
        ) from None


def chance_loss(labels: ArrayLike) -> float:
    """Cross-entropy of the best guess that ignores the video: the entropy of the labels."""
    return max(0.0, float(entr(np.bincount(labels) / len(labels)).sum()))
