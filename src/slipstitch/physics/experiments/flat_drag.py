"""Flat drag: a square of cloth pulled along the floor by its leading edge."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.demand import Demand
from slipstitch.physics.experiments.specimen import (
    require,
    rest_on_the_floor,
    solver_settings,
    square_tables,
)
from slipstitch.physics.gravity import GRAVITY_M_S2

DEMANDS = (Demand("pull_over_weight", 0.005),)


def flat_drag_theory(friction: float) -> float:
    """Pull over weight of a sheet that lies flat and is dragged steadily.

    Every part of the sheet carries its own weight, so that the pull is μ times the whole weight
    whatever the shape (Amontons 1699).

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0.

    Returns
    -------
    float
        Horizontal pull divided by the weight, dimensionless.
    """
    return require("friction", friction, 0.0)


def flat_drag(settings: SimulationSettings, friction: float) -> dict[str, Any]:
    """A square of cloth lying flat, pulled along the floor by its leading edge.

    Returns
    -------
    dict
        ``pull_over_weight`` and ``theory_pull_over_weight``.
    """
    mesh = rectangle(11, 11, 0.1, 0.1)
    flat_m = np.column_stack(
        [0.1 - mesh.rest_uv_m[:, 1], mesh.rest_uv_m[:, 0], 0 * mesh.rest_uv_m[:, 0]]
    )
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[mesh.rest_uv_m[:, 1] == 0, 0] = True
    solver = ClothSolver(
        mesh,
        square_tables(),
        flat_m,
        friction=friction,
        fixed=fixed,
        settings=solver_settings(settings),
    )
    rest_on_the_floor(solver)
    solver.start()
    speed_m_s, duration_s = 0.01, 2.0
    steps = round(duration_s / settings.time_step_s)

    def pulled(time_s: float) -> np.ndarray:
        return flat_m + np.array([speed_m_s * time_s, 0.0, 0.0])

    for _ in range(steps):
        solver.advance(duration_s / steps, pulled)
    weight_N = solver.mass_kg.sum() * GRAVITY_M_S2
    return {
        "pull_over_weight": float(solver.reactions()[:, 0].sum() / weight_N),
        "theory_pull_over_weight": flat_drag_theory(friction),
    }
