"""The paper's results that ours are compared with (Rasheed et al., CVPR 2020, Sec. 6), its Fig. 6.

Shares in 0 ... 1. Figures that the paper does not print are missing here.
"""

from collections.abc import Iterable
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes

CITATION = (
    "Rasheed, Romero, Bertails-Descoubes, Wuhrer, Franco, Lazarus: Learning to Measure the Static "
    "Friction Coefficient in Cloth Contact, CVPR 2020"
)
NOT_PRINTED = "not printed"

TABLE_2 = {
    ("material_baseline", "material_top1"): 0.995,
    ("material_baseline", "material_top2"): 1.0,
    ("friction_baseline", "friction_lt_0.1"): 0.786,
    ("friction_baseline", "friction_lt_0.2"): 0.885,
    ("friction_conditional", "friction_lt_0.1"): 0.955,
    ("friction_conditional", "friction_lt_0.2"): 0.992,
}
TABLE_2_VIDEOS = 384
# One of each fabric and coefficient, so from one viewpoint.
UNSEEN_TEXTURE_VIDEOS = 160
UNSEEN_TEXTURE = {
    ("friction_conditional", "friction_lt_0.1"): 0.872,
    ("friction_conditional", "friction_lt_0.2"): 0.95,
}
# Turn in degrees -> shares below 0.1 and below 0.2, of so many random combinations each.
TABLE_3_VIDEOS = 20
TABLE_3 = {
    -15: (0.65, 0.70),
    -10: (0.75, 0.85),
    -5: (0.80, 0.95),
    5: (0.75, 0.80),
    10: (0.65, 0.80),
    15: (0.50, 0.65),
}
# Fig. 6 and Sec. 6.3, real films: subset -> metric -> share of the pairs of fabric and substrate,
# 36 of them matte: 39, 48, 31 and 59 pairs. Of five films of a pair whose answers differ the median
# counts. Reflective substrates alone are "clearly worse" than all.
CAPTURES_PAIRS = 63
CAPTURES = {
    "all": {"median_within_0.1": 0.619, "equal_predictions": 0.762},
    "matte": {"median_within_0.1": 0.861},
    "reflective": {},
    "all, reflective training": {"median_within_0.1": 0.936},
}


def captures_cells(subset: str, names: Iterable[str]) -> list[tuple[float | None, int]]:
    """Return the paper's figures of some metrics: (figure or None, columns that the cell spans)."""
    found: list[tuple[float | None, int]] = []
    for figure, same in groupby(CAPTURES[subset].get(name) for name in names):
        width = len(list(same))
        found += [(None, width)] if figure is None else [(figure, 1)] * width
    return found


def cumulative_error(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct errors in increasing order, and the share of videos with at most that."""
    values, counts = np.unique(np.round(errors, 9), return_counts=True)
    return values, np.cumsum(counts) / len(errors)


def draw_cumulative(axes: Axes, errors: np.ndarray, widest: float, **style) -> None:
    """Draw the steps from 0 to the largest error that the axes show."""
    values, shares = cumulative_error(errors)
    end = max(widest, values[-1])
    axes.step([0, *values, end], [0, *shares, 1.0], where="post", **style)
