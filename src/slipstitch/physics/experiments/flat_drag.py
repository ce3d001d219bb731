"""Flat drag: a square of cloth pulled along the floor by its leading edge."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import theory
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.specimen import (
    AREAL_DENSITY_KG_M2,
    HINGE_STIFFNESS_N_M,
    MEMBRANE_STIFFNESS_N_M,
    solver_settings,
)
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.gravity import GRAVITY_M_S2


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
        isotropic_tables(AREAL_DENSITY_KG_M2, MEMBRANE_STIFFNESS_N_M, HINGE_STIFFNESS_N_M),
        flat_m,
        friction=friction,
        fixed=fixed,
        settings=solver_settings(settings),
    )
    solver.positions_m[:, 2] = -solver.mass_kg * GRAVITY_M_S2 / solver.contact_stiffness_N_m
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
        "theory_pull_over_weight": float(theory.flat_drag(friction)),
    }
