"""The paper's results that ours are compared with (Rasheed et al., CVPR 2020).

Only the known figures of its Sec. 6 and its abstract. Unlisted figures are shown as not
available: among them all of Table 3, and all of Fig. 6 except one point of a curve.
"""

from collections.abc import Iterable
from itertools import groupby

CITATION = (
    "Rasheed, Romero, Bertails-Descoubes, Wuhrer, Franco, Lazarus: Learning to Measure the Static "
    "Friction Coefficient in Cloth Contact, CVPR 2020"
)
NOT_AVAILABLE = "not available"

# Shares of test videos.
TABLE_2 = {
    ("material_baseline", "material_top1"): 0.995,
    ("friction_conditional", "friction_lt_0.1"): 0.955,
    ("friction_conditional", "friction_lt_0.2"): 0.992,
}
UNSEEN_TEXTURE = {
    ("friction_conditional", "friction_lt_0.1"): 0.872,
    ("friction_conditional", "friction_lt_0.2"): 0.95,
}
# Of captures, by metric. "93.6% of all measurements predicted within 0.1 range of standard physics
# bench measurements" (abstract); of which network, and trained with which floors, it does not say.
CAPTURES = {"within_0.1": 0.936}


def captures_cells(names: Iterable[str]) -> list[tuple[float | None, int]]:
    """The paper's figures for captures as cells of a row: (figure or None, columns that it spans).

    Parameters
    ----------
    names : iterable of str
        Metrics, a column each; neighbours without a figure share a cell.
    """
    found: list[tuple[float | None, int]] = []
    for figure, same in groupby(CAPTURES.get(name) for name in names):
        width = len(list(same))
        found += [(None, width)] if figure is None else [(figure, 1)] * width
    return found
