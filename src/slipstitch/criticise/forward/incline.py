"""(a) The inclined plane: the slope at which a loaded piece of cloth slips."""

from __future__ import annotations

import numpy as np

from slipstitch.friction_law import Contact, FrictionLaw

LARGEST_ANGLE_RAD = np.radians(89.0)


def slip_angle_rad(
    law: FrictionLaw, weight_N: np.ndarray, contact: Contact, iterations: int = 30
) -> np.ndarray:
    """Slope alpha with ``W sin alpha = F(N = W cos alpha)``, static friction.

    Parameters
    ----------
    weight_N : (n,) weight of cloth and carrier.
    contact : area, direction, dwell ... of the contacts; its load is replaced.

    Returns
    -------
    (n,) radians, at most 89 degrees.
    """
    weight_N = np.asarray(weight_N, dtype=float)
    slope = np.full(weight_N.shape, np.arctan(max(law.coefficient, 1e-9)))
    for _ in range(iterations):
        normal = weight_N * np.cos(slope)
        ratio = law.force_limit(contact.with_load(normal), static=True) / normal
        update = np.minimum(np.arctan(ratio), LARGEST_ANGLE_RAD)
        change = np.max(np.abs(update - slope), initial=0.0)
        slope = update
        if change < 1e-10:
            break
    return slope


def reading_deg(slope_rad: np.ndarray, tilt_downhill_rad: np.ndarray | float) -> np.ndarray:
    """What the protractor says where the base already falls ``tilt_downhill_rad`` that way."""
    return np.degrees(slope_rad - tilt_downhill_rad)
