"""Inclined plane: threshold, creep and acceleration of a square of cloth."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import theory
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments.specimen import (
    AREAL_DENSITY_KG_M2,
    HINGE_STIFFNESS_N_M,
    MEMBRANE_STIFFNESS_N_M,
    solver_settings,
)
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.gravity import GRAVITY_M_S2

CREEP_MAX_M = 1.0e-6  # elastic microslip stays below; more than this in a second is sliding


def incline(settings: SimulationSettings, friction: float, slope_deg: float) -> dict[str, Any]:
    """A square of cloth on a plane tilted slowly to a slope, for one second from there.

    Sticks for tan(slope) < friction, else slides with g (sin - friction cos).

    Returns
    -------
    dict
        ``sticks``, ``creep_m`` (distance moved in 1 s), ``acceleration_m_s2`` (final speed over
        time), ``theory_acceleration_m_s2``.
    """
    slope = radians(slope_deg)
    mesh = rectangle(5, 5, 0.02, 0.02)
    flat_m = np.column_stack([mesh.rest_uv_m, np.zeros(mesh.vertex_count)])
    solver = ClothSolver(
        mesh,
        isotropic_tables(AREAL_DENSITY_KG_M2, MEMBRANE_STIFFNESS_N_M, HINGE_STIFFNESS_N_M),
        flat_m,
        friction=friction,
        fixed=np.zeros((mesh.vertex_count, 3), bool),
        settings=solver_settings(settings),
        conditions=Conditions(
            gravity_m_s2=(GRAVITY_M_S2 * sin(slope), 0.0, -GRAVITY_M_S2 * cos(slope))
        ),
    )
    # Resting on the floor, not dropped on it.
    solver.positions_m[:, 2] = (
        -solver.mass_kg * GRAVITY_M_S2 * cos(slope) / solver.contact_stiffness_N_m
    )
    weight_N = solver.mass_kg * GRAVITY_M_S2
    borne_N = weight_N * min(sin(slope), friction * cos(slope))
    solver.start(preload_N=np.column_stack([borne_N, 0 * borne_N]))
    steps = round(1.0 / settings.time_step_s)
    for _ in range(steps):
        solver.advance(1.0 / steps)
    moved = solver.positions_m - flat_m
    creep_m = float(np.linalg.norm(moved[:, :2].mean(axis=0)))
    expected = theory.incline(friction, slope)
    return {
        "sticks": creep_m < CREEP_MAX_M,
        "creep_m": creep_m,
        "acceleration_m_s2": float(solver.velocities_m_s[:, 0].mean() / solver.time_s),
        "theory_acceleration_m_s2": expected.acceleration_m_s2,
    }
