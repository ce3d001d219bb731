"""Distributions of the friction coefficient, discretised on a grid, and conformal intervals.

Videos of one simulation (or of one material-substrate pair) are right or wrong together: they are
not exchangeable, the groups are. Every group therefore counts once, however many videos it has
(hierarchical conformal prediction: Lee, Barber & Willett, arXiv 2306.06342, 2023). A video of a new
group then scores at most the quantile with probability `level` at least.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from slipstitch.base.errors import BadInput

GRID_STEP = 0.01  # of mu


def friction_grid(largest: float) -> np.ndarray:
    """Values of mu from 0 to `largest`, float64 of shape (G,)."""
    return np.linspace(0.0, largest, round(largest / GRID_STEP) + 1)


def mixture_cumulative(parameters: Tensor, points: Tensor) -> Tensor:
    """Cumulative distribution function (n, G) of mixtures of normals, at points (G,).

    Parameters (n, 3, M): logits of the weights; means; logarithms of the standard deviations.
    """
    weights = parameters[:, 0].softmax(-1)
    away = points[None, :, None] - parameters[:, 1, None]
    below = 0.5 * (1.0 + torch.erf(away * (-parameters[:, 2, None]).exp() / math.sqrt(2.0)))
    return (below * weights[:, None]).sum(-1)


def ranked_probability_score(cumulative: Tensor, truth: Tensor, grid: Tensor) -> Tensor:
    """Continuous ranked probability score, in units of mu, shape (n,).

    Integral of (F(x) - [x >= truth])^2 over the grid by the midpoint rule (Gneiting & Raftery 2007,
    eq. 20); `cumulative` is F at the middles, (n, G - 1). In the truth's cell counts the share
    above.
    """
    step = grid[1] - grid[0]
    above = ((grid[1:][None] - truth[:, None]) / step).clamp(0.0, 1.0)
    # Mean over the cell of (F - [x >= truth])^2 with F constant in it.
    return (cumulative.square() * (1 - above) + (1 - cumulative).square() * above).sum(-1) * step


def medians(cumulative: Tensor, grid: Tensor) -> Tensor:
    """Points of the grid (G,) in whose cells the medians lie, from F at the middles (n, G - 1)."""
    return grid[(cumulative < 0.5).sum(1)]


def probabilities_on_grid(cumulative: np.ndarray) -> np.ndarray:
    """Probability of each point's cell from F at the middles (n, G - 1); ends take the tails."""
    padded = np.pad(cumulative, ((0, 0), (1, 1)), constant_values=((0, 0), (0.0, 1.0)))
    return np.maximum(np.diff(padded, axis=1), 0.0)


def spread(probabilities: np.ndarray, grid: np.ndarray, factor: float) -> np.ndarray:
    """Distributions (n, G) with their distances from their medians multiplied; clipped to the grid.

    Unlike a power of the probabilities (temperature scaling), it leaves the median where it is:
    a power makes the small modes of a mixture as good as its large one.
    """
    edges, rising = _rising(probabilities, grid)
    medians = quantiles(probabilities, grid, np.array([0.5]))[:, 0]
    back = medians[:, None] + (edges[1:-1] - medians[:, None]) / factor
    inner = np.array(
        [np.interp(places, edges, row) for places, row in zip(back, rising, strict=True)]
    )
    return probabilities_on_grid(inner)


def _rising(probabilities: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the points' cells (G + 1,), and the cumulative distributions there (n, G + 1)."""
    step = grid[1] - grid[0]
    edges = np.append(grid - step / 2, grid[-1] + step / 2)
    rising = np.pad(np.cumsum(probabilities, axis=1), ((0, 0), (1, 0)))
    return edges, rising / rising[:, -1:]


def quantiles(probabilities: np.ndarray, grid: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Quantiles (n, L) of distributions (n, G) on an even grid, linear within a cell."""
    edges, rising = _rising(probabilities, grid)
    rows = [np.interp(levels, row, edges) for row in rising]
    return np.clip(np.array(rows), grid[0], grid[-1])


def conformal_intervals(
    distributions: np.ndarray, grid: np.ndarray, coverage: float, scale: float
) -> np.ndarray:
    """Return medians and intervals, whose halves are scaled, shape (n, 3).

    Either half is at least one step of the grid before scaling, so that a distribution that is
    too sure of itself can be scaled at all. Clipped to the grid.
    """
    levels = np.array([(1 - coverage) / 2, 0.5, (1 + coverage) / 2])
    low, median, high = quantiles(distributions, grid, levels).T
    step = grid[1] - grid[0]
    if not math.isfinite(scale):
        return np.stack(
            [median, np.full_like(median, grid[0]), np.full_like(median, grid[-1])], axis=1
        )
    below = median - scale * np.maximum(median - low, step)
    above = median + scale * np.maximum(high - median, step)
    return np.stack([median, np.maximum(below, grid[0]), np.minimum(above, grid[-1])], axis=1)


def conformal_scales(intervals: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the factors by which intervals (median, low, high) reach their truths, shape (n,)."""
    median, low, high = intervals.T
    half = np.where(truth < median, median - low, high - median)
    # A half that the grid's end cut off is never too short.
    return np.abs(truth - median) / np.maximum(half, 1e-9)


def grouped_quantile(scores: np.ndarray, groups: Sequence[str], level: float) -> float:
    """Smallest score with weight `level` at or below it; infinite where the groups are too few.

    Each score weighs 1 / (videos of its group), and one group is added at infinity. BadInput
    without scores, with one that is no number, or if scores and groups are not equally many.
    """
    scores = np.asarray(scores, np.float64)
    if not len(scores) or len(scores) != len(groups) or np.isnan(scores).any():
        raise BadInput(
            f"{len(scores)} scores for {len(groups)} groups: must be one number each, no NaN"
        )
    _, number, count = np.unique(groups, return_inverse=True, return_counts=True)
    weights = 1.0 / (count[number] * (len(count) + 1))
    order = np.argsort(scores, kind="stable")
    reached = np.cumsum(weights[order]) >= level - 1e-12
    return float(scores[order][reached.argmax()]) if reached.any() else float("inf")


def least_groups(level: float) -> int:
    """Groups that a finite `grouped_quantile` needs: K with K / (K + 1) >= level."""
    return int(np.ceil(level / (1.0 - level) - 1e-9))
