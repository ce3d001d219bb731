"""Split-conformal quantiles of scores that come in groups.

Videos of one simulation (or of one material-substrate pair) are right or wrong together: they are
not exchangeable, the groups are. Every group therefore counts once, however many videos it has
(hierarchical conformal prediction: Lee, Barber & Willett, arXiv 2306.06342, 2023). A video of a new
group then scores at most the quantile with probability `level` at least.
"""

from collections.abc import Sequence

import numpy as np

from slipstitch.base.errors import BadInput


def grouped_quantile(scores: np.ndarray, groups: Sequence[str], level: float) -> float:
    """Smallest score with weight `level` at or below it; infinite where the groups are too few.

    Each score weighs 1 / (videos of its group), and one group is added at infinity: fewer
    groups than level / (1 - level) cannot promise the level. BadInput without scores, with one
    that is no number, or if scores and groups are not equally many.
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


def covered(
    low: np.ndarray, high: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> tuple[float, float]:
    """Share of truths inside their intervals, and its standard error; every group counts once.

    The standard error is that of the mean over groups; NaN for a single group.
    """
    inside = (low - 1e-12 <= truth) & (truth <= high + 1e-12)
    names = np.asarray(groups)
    shares = np.array([inside[names == name].mean() for name in np.unique(names)])
    error = shares.std(ddof=1) / np.sqrt(len(shares)) if len(shares) > 1 else float("nan")
    return float(shares.mean()), float(error)


def least_groups(level: float) -> int:
    """Groups that a finite `grouped_quantile` needs: K with K / (K + 1) >= level."""
    return int(np.ceil(level / (1.0 - level) - 1e-9))
