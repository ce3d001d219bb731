"""Slip angle of a piece of cloth with a carrier: balance of forces along the plane."""

import numpy as np

from support.departures.laws import GRAVITY_M_S2, friction_limit, tilt_of


def slip_angle_deg(rows, coefficient, effects, rho_kg_m2, steps=60):
    """Indicated slip angle (deg) of each trial; above 60: no slip was seen.

    Bisection on the plane's true slope for pull = friction; the reading is the slope less the
    floor's own lean along downhill.
    """
    mass = rho_kg_m2 * (1 + effects.get("mass_error", {}).get("mass_error", 0.0))
    mass = mass * rows["area_m2"] + rows["added_kg"]
    low = np.zeros(np.broadcast(mass, coefficient).shape)
    high = np.full(low.shape, np.pi / 2)
    for _ in range(steps):
        slope = (low + high) / 2
        weight = mass * GRAVITY_M_S2
        bearable = friction_limit(
            rows | {"load_N": weight * np.cos(slope)}, coefficient, effects, moving=False
        )
        slips = weight * np.sin(slope) > bearable
        high, low = np.where(slips, slope, high), np.where(slips, low, slope)
    tilt, towards = tilt_of(effects, rows["azimuth_deg"])
    return np.degrees((low + high) / 2) - tilt * towards
