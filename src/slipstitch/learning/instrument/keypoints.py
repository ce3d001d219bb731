"""Keypoints of the cloth as the instrument's network learns them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from slipstitch.dataset.videos import Videos
from slipstitch.learning.instrument.network import InstrumentNetwork

KEYPOINT_SPREAD_MIN_M = 1e-3
# The unit of the loss of places: in that of their spread, tails count little.
KEYPOINT_ERROR_M = 0.005


def keypoints_in_unit(network: InstrumentNetwork, videos: Videos, training: np.ndarray) -> Tensor:
    """Places of the videos' points minus the mean of those that train, over the mean distance.

    The network is given both, as the unit of its places.
    """
    points_m = torch.from_numpy(videos.points_m)
    known_m = points_m[training].double()
    mean_m = known_m.mean((0, 1))
    spread_m = (known_m - mean_m).abs().mean((0, 1)).clamp(min=KEYPOINT_SPREAD_MIN_M)
    network.points_mean_m.copy_(mean_m)
    network.points_spread_m.copy_(spread_m)
    return (points_m - network.points_mean_m) / network.points_spread_m


def keypoint_errors(network: InstrumentNetwork, differences: Tensor) -> Tensor:
    """Distances along the axes of places (..., points, 3) in the network's unit.

    In units of `KEYPOINT_ERROR_M`: a millimetre is as wrong at the tail, which moves most and tells
    friction, as at a point that hardly moves.
    """
    return differences.abs() * (network.points_spread_m / KEYPOINT_ERROR_M)


def next_frictions(rows: Sequence[dict[str, Any]], training: np.ndarray) -> np.ndarray:
    """For every video, one of the same fabric and replicate at the next larger coefficient.

    Itself without one.

    Of videos that train, and only where one of the two lies between simulations itself: there a
    cloth changes smoothly with the coefficient, so that places between theirs are a cloth's too.
    """
    result = np.arange(len(rows))
    of_cloth: dict[tuple[str, str], list[int]] = {}
    for number in np.flatnonzero(training):
        cloth = rows[number]["material_id"], rows[number]["replicate_id"]
        of_cloth.setdefault(cloth, []).append(int(number))
    for numbers in of_cloth.values():
        numbers.sort(key=lambda number: rows[number]["friction"])
        for place, number in enumerate(numbers):
            larger = numbers[place + 1 :]
            friction = rows[number]["friction"]
            other = next((one for one in larger if rows[one]["friction"] > friction), number)
            if rows[number].get("interpolated") or rows[other].get("interpolated"):
                result[number] = other
    return result


def noisy_keypoints(
    points: Tensor, spread_m: Tensor, noise_m: float, generator: np.random.Generator
) -> Tensor:
    """Places (n, frames, points, 3) in the network's unit as they might be found in images.

    Shifted as a whole, as by the error of a calibration; each point shifted; and in every frame
    each point again.
    """
    videos, _, count, axes = points.shape
    shapes = (videos, 1, 1, axes), (videos, 1, count, axes), points.shape
    noise = sum(generator.standard_normal(shape, np.float32) for shape in shapes)
    return points + noise_m * torch.from_numpy(noise) / spread_m
