"""Repeats of one pair combined: mean, interval, scatter between the videos, outliers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from slipstitch.learning.instrument.measuring import COVERAGE, HALF_WIDTH

FEWEST_FOR_OUTLIERS = 3
OUTLIER_CHANCE = 0.05  # of naming any video of a pair, where none is an outlier


@dataclass(frozen=True)
class Repeats:
    """Combined result of n videos of one pair."""

    friction_coefficient: float  # mean over the videos
    interval_90: tuple[float, float]  # (low, high), within the instrument's grid
    scatter: float  # standard deviation between the videos (posterior median); NaN for one video
    # videos that the others did not lead one to expect; they count in the mean all the same
    outliers: list[int]


def combined(
    friction: Sequence[float],
    intervals_90: Sequence[tuple[float, float]],
    ends: tuple[float, float],
) -> Repeats:
    """Combine medians and 90 % intervals of n videos of one pair of fabric and substrate.

    A video's error has two parts. One is shared by all videos of the pair (the fabric, the camera,
    what the instrument learnt) and stays however many are filmed; the other differs from video to
    video and averages out. The instrument states the whole, s; the scatter between videos tells the
    second, v. The pair's coefficient is then the mean of n videos with variance
    max(s² - v², 0) + v² / n, averaged over what is not known of v (prior 1 / (s + v): flat below s,
    without a scale above). The halves of the interval below and above the median have an s each.
    `ends` are those of the instrument's grid of mu, to which its intervals are clipped.
    """
    values, intervals = np.asarray(friction, float), np.asarray(intervals_90, float)
    mean = float(values.mean())
    if len(values) == 1:
        low, high = intervals[0]
        return Repeats(mean, (float(low), float(high)), float("nan"), [])
    deviations = _deviations(values, intervals, ends)
    if not np.isfinite(deviations).all():  # a video without an error bar
        return Repeats(mean, (float(ends[0]), float(ends[1])), float(values.std(ddof=1)), [])
    scatter, weights = _scatter(values, _root_mean_square(deviations.mean(axis=1)))
    below, above = (
        _quantile(
            np.sqrt(np.maximum(stated**2 - scatter**2, 0) + scatter**2 / len(values)),
            weights,
            COVERAGE,
        )
        for stated in map(_root_mean_square, deviations.T)
    )
    order = np.cumsum(weights)
    return Repeats(
        mean,
        (max(mean - below, float(ends[0])), min(mean + above, float(ends[1]))),
        float(np.interp(0.5, order, scatter)),
        _outliers(values, deviations) if len(values) >= FEWEST_FOR_OUTLIERS else [],
    )


def _deviations(values: np.ndarray, intervals: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Standard deviations below and above each median that the halves imply, shape (n, 2).

    A half that an end of the grid cuts off is at least as long as the other one; infinite where
    both are cut off.
    """
    halves = np.abs(intervals - values[:, None])
    cut = np.abs(intervals - np.asarray(ends)) < 1e-9
    longest = np.where(cut.all(axis=1), np.inf, halves.max(axis=1))
    return np.where(cut, longest[:, None], halves) / HALF_WIDTH


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


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


def _outliers(values: np.ndarray, deviations: np.ndarray) -> list[int]:
    """Videos further from the mean of the others than a new video would be."""
    found = []
    for number, value in enumerate(values):
        others = np.delete(values, number)
        stated = _root_mean_square(np.delete(deviations, number, axis=0).mean(axis=1))
        scatter, weights = _scatter(others, stated)
        spread = scatter * np.sqrt(1 + 1 / len(others))
        if abs(value - others.mean()) > _quantile(
            spread, weights, 1 - OUTLIER_CHANCE / len(values)
        ):
            found.append(number)
    return found
