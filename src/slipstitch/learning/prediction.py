"""A prediction for one video, whatever model makes it."""

import math
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Prediction:
    """What a model predicts for one video.

    Attributes
    ----------
    friction_coefficient : float
        The likeliest class of a network of classes, the median of an instrument; NaN of a network
        that predicts the fabric alone.
    distribution : tuple of ndarray, optional
        Values of mu, and the probability of each of them, both of shape (G,).
    interval_90 : tuple of float, optional
        Conformal interval, (low, high); the whole grid where too few simulations calibrate it.
    material_probabilities : dict
        Fabric -> probability; empty if the model does not predict it.
    alarm : bool, optional
        Whether the video is unlike the training data, so that the rest is not to be believed; None
        of a model without an out-of-distribution alarm.
    alarm_reason : str
        Why; empty without alarm.
    attention_weights : ndarray, shape (frames,), optional
        Weight of each frame in the decision, sum 1.
    points_m : ndarray, shape (frames, points, 3), optional
        Keypoints of the cloth (`slipstitch.images.keypoints`), if the model predicts them.
    """

    friction_coefficient: float = math.nan
    distribution: tuple[np.ndarray, np.ndarray] | None = None
    interval_90: tuple[float, float] | None = None
    material_probabilities: dict[str, float] = field(default_factory=dict)
    alarm: bool | None = None
    alarm_reason: str = ""
    attention_weights: np.ndarray | None = None
    points_m: np.ndarray | None = None

    @property
    def fabrics(self) -> list[str]:
        """Return the fabrics from the likeliest on."""
        names, shares = list(self.material_probabilities), [*self.material_probabilities.values()]
        return [names[k] for k in np.argsort(-np.array(shares), kind="stable")]
