"""Cumulative error: share of videos against the largest error allowed, as in the paper's Fig. 6."""

import numpy as np
from matplotlib.axes import Axes


def cumulative_error(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct errors in increasing order, and the share of videos with at most that error.

    Parameters
    ----------
    errors : ndarray, shape (n,)
        Not negative.
    """
    values, counts = np.unique(np.round(errors, 9), return_counts=True)
    return values, np.cumsum(counts) / len(errors)


def draw_cumulative(axes: Axes, errors: np.ndarray, widest: float, **style) -> None:
    """Draw the steps from 0 to the largest error that the axes show."""
    values, shares = cumulative_error(errors)
    end = max(widest, values[-1])
    axes.step([0, *values, end], [0, *shares, 1.0], where="post", **style)
