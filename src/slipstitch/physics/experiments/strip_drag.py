"""Steady drag of a strip that hangs from a holder, its tail on the floor."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import theory
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.specimen import (
    AREAL_DENSITY_KG_M2,
    MEMBRANE_STIFFNESS_N_M,
    cylindrical_strip_tables,
    hanging_with_tail,
    solver_settings,
)
from slipstitch.physics.gravity import GRAVITY_M_S2


def strip_drag(
    settings: SimulationSettings,
    friction: float,
    gravity_length_m: float = 0.02,
    length_m: float = 0.20,
    height_m: float = 0.15,
) -> dict[str, Any]:
    """A strip hinged at a holder above the floor, dragged until its shape is steady.

    Kept cylindrical, so that the plate rigidity is a quarter of the hinges' stiffness. As many
    vertices along it as along a side of the simulated cloth.

    Parameters
    ----------
    gravity_length_m : float
        (B/w)^(1/3), bending rigidity over weight per area.

    Returns
    -------
    dict
        ``pull_over_w_m``, ``floor_load_over_w_m``, ``flat_tail_m``,
        ``holder_ahead_of_tail_m``, each also as ``theory_...``; w is the weight per length.
    """
    rows = settings.vertices_per_side
    spacing_m = length_m / (rows - 1)
    mesh = rectangle(rows, 3, length_m, 2 * spacing_m)
    weight_N_m2 = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
    down = mesh.rest_uv_m[:, 1]
    ahead, height = hanging_with_tail(down, length_m, height_m)
    start_m = np.column_stack([ahead, mesh.rest_uv_m[:, 0], height])
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 1] = True
    fixed[down == 0] = True
    solver = ClothSolver(
        mesh,
        cylindrical_strip_tables(MEMBRANE_STIFFNESS_N_M, weight_N_m2 * gravity_length_m**3),
        start_m,
        friction=friction,
        fixed=fixed,
        settings=solver_settings(settings),
    )
    solver.start()
    # Far enough for the longest tail to be drawn out, slow enough for inertia to be nothing.
    speed_m_s, duration_s = 0.02, 20.0
    steps = round(duration_s / settings.time_step_s)

    def pulled(time_s: float) -> np.ndarray:
        return start_m + np.array([speed_m_s * time_s, 0.0, 0.0])

    for _ in range(steps):
        solver.advance(duration_s / steps, pulled)
    width_m = 2 * spacing_m
    w_N_m = weight_N_m2 * width_m
    normal_N = solver.floor_forces()[:, 2].reshape(rows, 3).sum(axis=1)
    along = solver.positions_m[:, 0].reshape(rows, 3).mean(axis=1)
    touching = np.flatnonzero(normal_N > 0)
    expected = theory.steady_strip_drag(
        friction, length_m, height_m, gravity_length_m, holder_angle_rad=None
    )
    measured = {
        "pull_over_w_m": float(solver.reactions()[:, 0].sum() / w_N_m),
        "floor_load_over_w_m": float(normal_N.sum() / w_N_m),
        "flat_tail_m": float(spacing_m * (rows - 1 - touching[0])) if len(touching) else 0.0,
        "holder_ahead_of_tail_m": float(along[0] - along[-1]),
    }
    return measured | {f"theory_{key}": getattr(expected, key) for key in measured}
