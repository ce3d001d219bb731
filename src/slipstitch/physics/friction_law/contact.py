"""The state of a contact, as available to a friction law."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

REFERENCE_PRESSURE_PA = 50.0
REFERENCE_EDGE_FORCE_N = 2.0e-3
REFERENCE_DWELL_S = 1.0
REFERENCE_SPEED_M_S = 0.010
REFERENCE_HUMIDITY_PCT = 50.0


@dataclass(frozen=True)
class Contact:
    """State of one contact or an array of contacts.

    Every field is a number or an array; all broadcast together. A NaN means *not recorded*: a
    mechanism that needs it then leaves the friction as it is.

    Parameters
    ----------
    normal_force_N, area_m2
        Load and apparent area. Forces per width with areas per width do as well.
    direction_rad
        From the warp to the direction of sliding: 0 along the warp, pi/2 along the weft.
    dwell_s
        Rest in contact before the pull.
    speed_m_s
        Speed of sliding.
    repeats
        Slides that this place has made before, from 0.
    relative_humidity_pct
        Relative humidity of the air.
    place_m
        Place on the substrate, along the track.
    edge
        The contact is the edge of a sheet (strip), not its face.
    """

    normal_force_N: ArrayLike
    area_m2: ArrayLike = 1.0
    direction_rad: ArrayLike = 0.0
    dwell_s: ArrayLike = np.nan
    speed_m_s: ArrayLike = np.nan
    repeats: ArrayLike = 0.0
    relative_humidity_pct: ArrayLike = np.nan
    place_m: ArrayLike = np.nan
    edge: bool = False

    def with_load(self, normal_force_N: ArrayLike, area_m2: ArrayLike | None = None) -> Contact:
        """The same contact under another load (and on another area, if given)."""
        area = self.area_m2 if area_m2 is None else area_m2
        return replace(self, normal_force_N=normal_force_N, area_m2=area)

    def load_ratio(self) -> np.ndarray:
        """Load over the reference: pressure / 50 Pa for a face, force / 2 mN for an edge."""
        if self.edge:
            return np.asarray(self.normal_force_N) / REFERENCE_EDGE_FORCE_N
        return np.asarray(self.normal_force_N) / np.asarray(self.area_m2) / REFERENCE_PRESSURE_PA

    def quantity(self, name: str) -> np.ndarray:
        """A field, or ``load_ratio``, as a formula asks for it by the name of its argument."""
        if name == "load_ratio":
            return self.load_ratio()
        return np.asarray(getattr(self, name), dtype=float)
