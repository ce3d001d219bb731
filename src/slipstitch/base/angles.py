"""Angles that a table gives in degrees and that must be radians."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# No cloth slips at a lesser slope; a right angle is 1.57 rad.
SMALLEST_SLIP_ANGLE_DEG = 2.0


def in_radians(slip_angles: Iterable[float]) -> bool:
    """Say whether slip angles, stated in degrees, must be radians: none reaches 2."""
    angles = np.abs(np.asarray(list(slip_angles), float))
    return bool(np.isfinite(angles).any() and np.nanmax(angles) < SMALLEST_SLIP_ANGLE_DEG)


def directions_in_radians(directions: Iterable[float]) -> bool:
    """Say whether directions, stated in degrees, must be radians: multiples of 45 degrees in them.

    Some must not be 0, and none may be beyond a turn.
    """
    angles = np.asarray(list(directions), float)
    angles = np.abs(angles[np.isfinite(angles)])
    turned = angles[angles > 0]
    if not len(turned) or turned.max() > 2 * np.pi + 0.01:
        return False
    eighths = turned / (np.pi / 4)
    return bool(np.all(np.abs(eighths - np.round(eighths)) < 0.02) and np.all(eighths > 0.9))
