"""Every covariate of a feature: how it is called, drawn, and searched for structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np


@dataclass(frozen=True)
class Covariate:
    """A column of the features along which friction may change.

    Attributes
    ----------
    name : the column; empty cells (NaN, or '' of a text) were not recorded.
    title, unit : as they are drawn and said.
    logarithmic : drawn, and searched, along its logarithm.
    from_zero : its logarithm is that of 1 + value, since it may be zero.
    trends : it is searched for a trend, a bow and an S-shaped curve.
    bumps : and for bumps at every place.
    patches : and for patches with sharp edges, of every width.
    waves : orders of the waves that are looked for in an angle.
    cycles : it is searched for cycles of several periods.
    text : it names something; its values have no order.
    """

    name: str
    title: str
    unit: str = ""
    logarithmic: bool = False
    from_zero: bool = False
    trends: bool = False
    bumps: bool = False
    patches: bool = False
    waves: tuple[int, ...] = ()
    cycles: bool = False
    text: bool = False

    @property
    def periodic(self) -> bool:
        """An angle in degrees."""
        return self.unit == "°"

    @property
    def axis_label(self) -> str:
        """The label of its axis."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{'log₁₀ ' if self.logarithmic else ''}{self.title}{unit}"

    def searched(self, values: np.ndarray) -> np.ndarray:
        """Values as the shapes see them, NaN where missing."""
        if self.from_zero:
            return np.log10(1.0 + values)
        if self.logarithmic:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.log10(values)
        return values

    def plain(self, searched: float) -> str:
        """A value as it was recorded, in words, from the one that shapes see."""
        if self.from_zero:
            return f"{10**searched - 1:.3g}"
        return f"{10**searched if self.logarithmic else searched:.3g}"


_ENTRIES = (
    Covariate(
        "pos_x_mm",
        "position on the substrate",
        "mm",
        trends=True,
        bumps=True,
        patches=True,
        cycles=True,
    ),
    Covariate(
        "clock_min",
        "time in the session",
        "min",
        trends=True,
        bumps=True,
        patches=True,
        cycles=True,
    ),
    Covariate("rh_pct", "relative humidity", "%", trends=True, bumps=True),
    Covariate("repeat_index", "earlier slides", trends=True),
    Covariate(
        "dwell_s",
        "rest before the pull",
        "s",
        logarithmic=True,
        from_zero=True,
        trends=True,
        bumps=True,
    ),
    Covariate("orientation_deg", "direction to the warp", "°", waves=(1, 2, 3, 4)),
    Covariate("azimuth_deg", "lab direction", "°", waves=(1, 2, 3)),
    Covariate("load_ratio", "load", "p/p₀", logarithmic=True, trends=True, bumps=True),
    Covariate("speed_mm_s", "speed", "mm/s", logarithmic=True, trends=True, bumps=True),
    Covariate("operator", "operator", text=True),
    Covariate("support", "support", text=True),
    Covariate("length_mm", "strip length", "mm"),
    Covariate("height_mm", "clamp height", "mm"),
)
COVARIATES: Mapping[str, Covariate] = MappingProxyType(
    {covariate.name: covariate for covariate in _ENTRIES}
)
