"""The bench and the fabric as they really are: what departs from the nominal values."""

from __future__ import annotations

from dataclasses import dataclass

from slipstitch.bench.gravity import GRAVITY_M_S2

STANDARD_GRAVITY_M_S2 = GRAVITY_M_S2


@dataclass(frozen=True)
class Bench:
    """Departures of the instrument and of the fabric; the defaults are the nominal ones.

    ``tilt_along_rad`` and ``tilt_across_rad`` are the components of the floor's slope towards lab
    azimuth 0 and 90 degrees (positive: it falls that way).
    """

    mass_error: float = 0.0
    bending_error: float = 0.0
    tilt_along_rad: float = 0.0
    tilt_across_rad: float = 0.0
    backlash_m: float = 0.0
    camera_scale: float = 1.0
    force_offset_N: float = 0.0
    force_gain: float = 0.0
    time_lag_s: float = 0.0
