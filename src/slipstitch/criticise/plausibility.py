"""Readings that no fabric gives: most likely another unit, or a sign the other way round."""

from __future__ import annotations

import numpy as np

from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.measurements import Measurements

SMALLEST_COEFFICIENT, LARGEST_COEFFICIENT = 0.01, 5.0
SMALLEST_ANGLE_DEG = 2.0
# How the plateau of a drag, the lag of an edge ... would come to lie there.
LIKELY = {
    "incline": "angles in radians, or zero?",
    "strip": "strains in percent, or zero?",
    "drag": "forces in N instead of mN, or of the other sign?",
    "drop_drag": "lengths in m or cm instead of mm?",
    "spring_slider": "forces in N instead of mN, or of the other sign?",
}


def implausible_readings(measurements: Measurements, null: Fit) -> list[str]:
    """One line for everything implausible, with the likely reason."""
    m, found = measurements, []
    angles = m.y[(m.rows["quantity"] == "angle_deg").to_numpy()]
    if len(angles) and np.all(np.abs(angles) < SMALLEST_ANGLE_DEG):
        found.append(f"all angles are below {SMALLEST_ANGLE_DEG:g}°: {LIKELY['incline']}")
    by_side = {"mu_edge": ["strip"]}
    for parameter, value in zip(null.parameters, null.values, strict=True):
        mu = float(np.exp(value))
        if SMALLEST_COEFFICIENT <= mu <= LARGEST_COEFFICIENT or found:
            continue
        there = set(m.protocol)
        protocols = by_side.get(parameter.name, [p for p in LIKELY if p != "strip"])
        likely = " ".join(dict.fromkeys(LIKELY[p] for p in protocols if p in there))
        found.append(f"{parameter.name} = {mu:.2g} is no friction of a fabric: {likely}")
    return found
