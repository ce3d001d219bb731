"""Pose of the camera relative to the calibrated viewpoint, as given to the network."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from slipstitch.images.camera import POSE

_SCALE = {"yaw_deg": 10.0, "pitch_deg": 5.0, "roll_deg": 2.0, "log_distance": 0.15}
#: Beyond the range of the training by more than this, a pose is refused.
TOLERANCE = {"yaw_deg": 2.5, "pitch_deg": 2.5, "roll_deg": 2.0, "log_distance": 0.05}
TITLES = {
    "yaw_deg": ("rotation about the vertical", "degrees"),
    "pitch_deg": ("elevation", "degrees"),
    "roll_deg": ("roll", "degrees"),
    "log_distance": ("distance", "times that of the calibrated viewpoint"),
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


def shown(name: str, value: float) -> str:
    """A number of a pose, relative to the calibrated viewpoint, without its unit."""
    return f"{np.exp(value):.2f}" if name == "log_distance" else f"{round(value, 1) + 0.0:+g}"


def in_words(name: str, value: float, limits: Sequence[float]) -> str:
    """A number of a pose with its training range."""
    low, high = (shown(name, limit) for limit in limits)
    trained_on = low if low == high else f"{low} ... {high}"
    what, unit = TITLES[name]
    return f"{what} {shown(name, value)} {unit} (trained on {trained_on})"


def outside(
    pose: Mapping[str, float],
    tested: Mapping[str, Sequence[float]],
    tolerance: Mapping[str, float] = TOLERANCE,
) -> list[str]:
    """Description of the parts of a pose beyond the training range of an instrument."""
    return [
        in_words(name, pose[name], (low, high))
        for name, (low, high) in ((name, tested[name]) for name in POSE)
        if not low - tolerance[name] <= pose[name] <= high + tolerance[name]
    ]


def just_beyond(pose: Mapping[str, float], tested: Mapping[str, Sequence[float]]) -> str:
    """What is to be said of a pose that only the tolerance admits; empty if the range holds it."""
    beyond = outside(pose, tested, dict.fromkeys(POSE, 1e-3))
    if not beyond or outside(pose, tested):
        return ""
    return f"just beyond the training range, within the tolerance: {'; '.join(beyond)}"
