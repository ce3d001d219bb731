"""Tilted plane: the slope at which a square of cloth that rests on it breaks away."""

from __future__ import annotations

from math import atan, cos, sin
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.demand import Demand
from slipstitch.physics.experiments.specimen import (
    rest_on_the_floor,
    solver_settings,
    square_tables,
)
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.gravity import GRAVITY_M_S2

STEPS = 600  # up to the slope at which it should break away
BEYOND = 1.2  # times that slope, where the plane stops
SLIDES_M = 1.0e-5  # elastic microslip stays below
DEMANDS = (Demand("slope_at_slip", 0.005),)


def tilt(
    settings: SimulationSettings, friction: float, static_kinetic: float = 0.0
) -> dict[str, Any]:
    """A square of cloth on a plane that is tilted slowly from the horizontal until it slides.

    Parameters
    ----------
    friction : float
        Kinetic coefficient.
    static_kinetic : float
        How far the static one exceeds it, over the kinetic one.

    Returns
    -------
    dict
        ``slope_at_slip``, the tangent of the slope where it breaks away (None: it does not), and
        ``theory_slope_at_slip``.
    """
    law = FrictionLaw(friction, {"static_kinetic": {"static_kinetic": static_kinetic}})
    expected = friction * (1 + static_kinetic)
    mesh = rectangle(5, 5, 0.02, 0.02)
    solver = ClothSolver(
        mesh,
        square_tables(),
        np.column_stack([mesh.rest_uv_m, np.zeros(mesh.vertex_count)]),
        friction=law,
        fixed=np.zeros((mesh.vertex_count, 3), bool),
        settings=solver_settings(settings),
    )
    rest_on_the_floor(solver)
    start_m = solver.positions_m[:, 0].mean()
    solver.start()
    slope_at_slip = None
    for step in range(1, round(BEYOND * STEPS) + 1):
        slope = expected * step / STEPS
        angle = atan(slope)
        solver.set_gravity((GRAVITY_M_S2 * sin(angle), 0.0, -GRAVITY_M_S2 * cos(angle)))
        solver.advance(settings.time_step_s)
        if solver.positions_m[:, 0].mean() - start_m > SLIDES_M:
            slope_at_slip = slope
            break
    return {"slope_at_slip": slope_at_slip, "theory_slope_at_slip": expected}
