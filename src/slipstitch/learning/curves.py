"""Learning curves as a line of text, for the terminal."""

import math
from collections.abc import Sequence
from itertools import pairwise

BARS = "▁▂▃▄▅▆▇█"


def curve(values: Sequence[float], width: int = 16) -> str:
    """Values as a row of bars from the lowest to the highest, averaged to at most `width`.

    Values that are not finite are shown as a gap; equal values as the lowest bar.
    """
    if not values:
        return ""
    count = min(width, len(values))
    edges = [place * len(values) // count for place in range(count + 1)]
    means = [sum(values[low:high]) / (high - low) for low, high in pairwise(edges)]
    finite = [value for value in means if math.isfinite(value)]
    if not finite:
        return " " * count
    low, spread = min(finite), max(finite) - min(finite)
    return "".join(
        BARS[int((len(BARS) - 1) * (value - low) / spread + 0.5) if spread else 0]
        if math.isfinite(value)
        else " "
        for value in means
    )
