"""Pose of the camera relative to the calibrated viewpoint, as given to the network."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from slipstitch.render.pose import POSE

_SCALE = {"yaw_deg": 10.0, "pitch_deg": 5.0, "roll_deg": 2.0, "log_distance": 0.15}
#: Beyond the range of the training by more than this, a pose is refused.
TOLERANCE = {"yaw_deg": 2.5, "pitch_deg": 2.5, "roll_deg": 2.0, "log_distance": 0.05}
TITLES = {
    "yaw_deg": ("rotated about the vertical", "degrees"),
    "pitch_deg": ("higher", "degrees"),
    "roll_deg": ("rotated about its axis", "degrees"),
    "log_distance": ("farther, logarithm of the ratio", ""),
}


def poses_of(rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Poses of videos by their rows of the manifest, shape (n, 4); 0 where there are none."""
    return np.array([[row.get(f"pose_{name}") or 0.0 for name in POSE] for row in rows])


def scaled(poses: np.ndarray) -> Tensor:
    """Poses (n, 4) as the network takes them."""
    return torch.from_numpy(np.asarray(poses) / [_SCALE[name] for name in POSE]).float()


def pose_range(poses: np.ndarray) -> dict[str, list[float]]:
    """Least and largest of each number, as a card holds them."""
    return {
        name: [float(low), float(high)]
        for name, low, high in zip(POSE, poses.min(0), poses.max(0), strict=True)
    }


def outside(pose: Mapping[str, float], tested: Mapping[str, Sequence[float]]) -> list[str]:
    """Description of the parts of a pose outside the training range of an instrument."""
    found = []
    for name in POSE:
        low, high = tested[name]
        if not low - TOLERANCE[name] <= pose[name] <= high + TOLERANCE[name]:
            what, unit = TITLES[name]
            limits = f"{low:.3g} ... {high:.3g}" if abs(high - low) > 1e-6 else f"{low:.3g}"
            found.append(f"{what} by {pose[name]:.3g} {unit}".rstrip() + f", trained on {limits}")
    return found
