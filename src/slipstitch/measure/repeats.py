"""Several videos of one pair of fabric and substrate: what they say together.

A video's error has two parts. One is shared by all videos of the pair (the fabric, the camera, what
the instrument learnt) and stays however many are filmed; the other differs from video to video and
averages out. The instrument states the whole, s; the scatter between videos tells the second, v.
The pair's coefficient is then the mean of n videos with variance max(s² - v², 0) + v² / n, averaged
over what is not known of v (prior 1 / (s + v): flat below s, without a scale above).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

COVERAGE = 0.9
HALF_WIDTH = float(ndtri((1 + COVERAGE) / 2))  # standard deviations, of a normal distribution
FEWEST_FOR_OUTLIERS = 3
OUTLIER_CHANCE = 0.05  # of naming any video of a pair, where none is an outlier


@dataclass(frozen=True)
class Repeats:
    """Combined result of n videos of one pair.

    Attributes
    ----------
    friction_coefficient : float
        Mean over the videos.
    interval_90 : tuple of float
        (low, high); never below 0.
    scatter : float
        Standard deviation between the videos (posterior median); NaN for one video.
    outliers : list of int
        Videos that the others did not lead one to expect; they count in the mean all the same.
    """

    friction_coefficient: float
    interval_90: tuple[float, float]
    scatter: float
    outliers: list[int]


def combined(friction: Sequence[float], intervals_90: Sequence[tuple[float, float]]) -> Repeats:
    """Combine the measurements of one pair.

    Parameters
    ----------
    friction : sequence of float, length n
        Medians of the videos.
    intervals_90 : sequence of (low, high), length n
    """
    values, intervals = np.asarray(friction, float), np.asarray(intervals_90, float)
    if len(values) == 1:
        low, high = intervals[0]
        return Repeats(float(values[0]), (float(low), float(high)), float("nan"), [])
    stated = _stated(intervals)
    scatter, weights = _scatter(values, stated)
    variance = np.maximum(stated**2 - scatter**2, 0) + scatter**2 / len(values)
    half = _quantile(np.sqrt(variance), weights, COVERAGE)
    mean = float(values.mean())
    order = np.cumsum(weights)
    return Repeats(
        mean,
        (max(mean - half, 0.0), mean + half),
        float(np.interp(0.5, order, scatter)),
        _outliers(values, intervals) if len(values) >= FEWEST_FOR_OUTLIERS else [],
    )


def _stated(intervals: np.ndarray) -> float:
    """Standard deviation implied by the videos' intervals, root mean square."""
    return float(np.sqrt(np.mean((np.diff(intervals, axis=1) / (2 * HALF_WIDTH)) ** 2)))


def _scatter(values: np.ndarray, stated: float) -> tuple[np.ndarray, np.ndarray]:
    """Posterior of the standard deviation between videos: grid and weights, sum 1."""
    squares = float(((values - values.mean()) ** 2).sum())
    grid = np.geomspace(stated / 50, max(20 * stated, 20 * np.sqrt(squares)), 120)
    # Restricted likelihood, prior, and the grid's logarithmic spacing.
    log_weight = (
        -(len(values) - 1) * np.log(grid)
        - squares / (2 * grid**2)
        - np.log1p(grid / stated)
        + np.log(grid)
    )
    weights = np.exp(log_weight - log_weight.max())
    return grid, weights / weights.sum()


def _quantile(deviations: np.ndarray, weights: np.ndarray, coverage: float) -> float:
    """Half-width that a mixture of centred normal distributions keeps within by `coverage`."""
    if not deviations.max() > 0:
        return 0.0
    return float(
        brentq(
            lambda half: float((2 * ndtr(half / deviations) - 1) @ weights) - coverage,
            0.0,
            deviations.max() * 6,
            xtol=1e-6,
        )
    )


def _outliers(values: np.ndarray, intervals: np.ndarray) -> list[int]:
    """Videos further from the mean of the others than a new video would be."""
    found = []
    for number, value in enumerate(values):
        others = np.delete(values, number)
        scatter, weights = _scatter(others, _stated(np.delete(intervals, number, axis=0)))
        spread = scatter * np.sqrt(1 + 1 / len(others))
        if abs(value - others.mean()) > _quantile(
            spread, weights, 1 - OUTLIER_CHANCE / len(values)
        ):
            found.append(number)
    return found
