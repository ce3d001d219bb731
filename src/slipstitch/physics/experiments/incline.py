"""Inclined plane: threshold, creep and acceleration of a square of cloth."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, nextafter, pi, radians, sin, tan
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments.demand import Demand
from slipstitch.physics.experiments.specimen import (
    require,
    rest_on_the_floor,
    solver_settings,
    square_tables,
)
from slipstitch.physics.gravity import GRAVITY_M_S2

CREEP_MAX_M = 1.0e-6  # elastic microslip stays below; more than this in a second is sliding
BELOW_UPRIGHT_RAD = nextafter(pi / 2, 0.0)
DEMANDS = (Demand("acceleration_m_s2", 0.01, zero=2e-4),)  # 0.1 mm in 1 s: it sticks


@dataclass(frozen=True)
class Incline:
    """Motion of a body on an inclined plane.

    Attributes
    ----------
    sticks : bool
        Whether it stays where it is.
    acceleration_m_s2 : float
        Its acceleration down the slope (m/s²); 0 if it sticks.
    """

    sticks: bool
    acceleration_m_s2: float


def incline_theory(
    friction: float, slope_rad: float, *, gravity_m_s2: float = GRAVITY_M_S2
) -> Incline:
    """Amontons-Coulomb on an inclined plane, released at rest.

    Sticks while tan θ ≤ μ, else slides with a = g (sin θ − μ cos θ).

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0, static and kinetic alike.
    slope_rad : float
        Angle θ of the plane (rad), 0 ≤ θ < π/2.
    gravity_m_s2 : float
        Acceleration of gravity (m/s²).

    Returns
    -------
    Incline
        Whether it sticks, and its acceleration (m/s²).
    """
    friction = require("friction", friction, 0.0)
    slope = require("slope_rad", slope_rad, 0.0, BELOW_UPRIGHT_RAD)
    if tan(slope) <= friction:
        return Incline(sticks=True, acceleration_m_s2=0.0)
    return Incline(False, gravity_m_s2 * (sin(slope) - friction * cos(slope)))


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
        square_tables(),
        flat_m,
        friction=friction,
        fixed=np.zeros((mesh.vertex_count, 3), bool),
        settings=solver_settings(settings),
        conditions=Conditions(
            gravity_m_s2=(GRAVITY_M_S2 * sin(slope), 0.0, -GRAVITY_M_S2 * cos(slope))
        ),
    )
    rest_on_the_floor(solver, cos(slope))
    weight_N = solver.mass_kg * GRAVITY_M_S2
    borne_N = weight_N * min(sin(slope), friction * cos(slope))
    solver.start(preload_N=np.column_stack([borne_N, 0 * borne_N]))
    steps = round(1.0 / settings.time_step_s)
    for _ in range(steps):
        solver.advance(1.0 / steps)
    moved = solver.positions_m - flat_m
    creep_m = float(np.linalg.norm(moved[:, :2].mean(axis=0)))
    expected = incline_theory(friction, slope)
    return {
        "sticks": creep_m < CREEP_MAX_M,
        "creep_m": creep_m,
        "acceleration_m_s2": float(solver.velocities_m_s[:, 0].mean() / solver.time_s),
        "theory_acceleration_m_s2": expected.acceleration_m_s2,
    }
