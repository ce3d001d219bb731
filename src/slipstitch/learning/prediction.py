"""A prediction for one video, whatever model makes it."""

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Prediction:
    """What a model predicts for one video."""

    # the likeliest class of a network of classes, the median of an instrument; NaN of a network
    # that predicts the fabric alone
    friction_coefficient: float = math.nan
    # values of mu, and the probability of each of them, both of shape (G,)
    distribution: tuple[np.ndarray, np.ndarray] | None = None
    # conformal interval, (low, high); the whole grid where too few simulations calibrate it
    interval_90: tuple[float, float] | None = None
    # fabric -> probability; empty if the model does not predict it
    material_probabilities: dict[str, float] = field(default_factory=dict)
    # whether the video is unlike the training data, so that the rest is not to be believed; None of
    # a model without an out-of-distribution alarm
    alarm: bool | None = None
    alarm_reason: str = ""  # why; empty without alarm
    # (frames,): weight of each frame in the decision, sum 1
    attention_weights: np.ndarray | None = None
    # (frames, points, 3): keypoints of the cloth (`slipstitch.images.keypoints`), if the model
    # predicts them
    points_m: np.ndarray | None = None

    @property
    def fabrics(self) -> list[str]:
        """Return the fabrics from the likeliest on."""
        names, shares = list(self.material_probabilities), [*self.material_probabilities.values()]
        return [names[k] for k in np.argsort(-np.array(shares), kind="stable")]
