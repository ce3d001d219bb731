"""A square of cloth on a plane: inclined, tilted until it slides, or level and dragged."""

from math import atan, cos, nextafter, pi, radians, sin, tan
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments import specimen
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.friction_law import FrictionLaw

HINGE_STIFFNESS_N_M = 5.0e-5
CREEP_MAX_M = 1.0e-6  # elastic microslip stays below; more than this in a second is sliding
BELOW_UPRIGHT_RAD = nextafter(pi / 2, 0.0)
TILT_STEPS = 600  # up to the slope at which it should break away
TILT_BEYOND = 1.2  # times that slope, where the plane stops
TILT_SLIDES_M = 1.0e-5  # elastic microslip stays below
INCLINE_DEMANDS = (
    specimen.Demand("acceleration_m_s2", 0.01, zero=2e-4),
)  # 0.1 mm in 1 s: it sticks
TILT_DEMANDS = (specimen.Demand("slope_at_slip", 0.005),)
FLAT_DRAG_DEMANDS = (specimen.Demand("pull_over_weight", 0.005),)


def incline_theory(friction: float, slope_rad: float) -> float:
    """Acceleration (m/s²) of a body on an inclined plane, released at rest; 0 where it sticks.

    Amontons-Coulomb: sticks while tan θ ≤ μ, else slides with a = g (sin θ − μ cos θ); 0 ≤ θ < π/2.
    """
    friction = specimen.require("friction", friction, 0.0)
    slope = specimen.require("slope_rad", slope_rad, 0.0, BELOW_UPRIGHT_RAD)
    if tan(slope) <= friction:
        return 0.0
    return GRAVITY_M_S2 * (sin(slope) - friction * cos(slope))


def _square(
    settings: SimulationSettings,
    friction: float | FrictionLaw,
    slope_rad: float = 0.0,
    vertices: int = 5,
    side_m: float = 0.02,
    led: bool = False,
) -> ClothSolver:
    """Cloth that lies as deep in the plane as its weight presses it; led: by its edge v = 0."""
    mesh = rectangle(vertices, vertices, side_m, side_m)
    across, down = mesh.rest_uv_m.T
    place = [side_m - down, across] if led else [across, down]
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 0] = led & (down == 0)
    tables = isotropic_tables(
        specimen.AREAL_DENSITY_KG_M2, specimen.MEMBRANE_STIFFNESS_N_M, HINGE_STIFFNESS_N_M
    )
    start_m = np.column_stack([*place, np.zeros(mesh.vertex_count)])
    conditions = Conditions(gravity_m_s2=_gravity_on(slope_rad))
    solver = specimen.started(settings, mesh, tables, start_m, fixed, friction, conditions)
    weight_N = solver.mass_kg * GRAVITY_M_S2
    solver.positions_m[:, 2] = -weight_N * cos(slope_rad) / solver.contact_stiffness_N_m
    solver.start()
    return solver


def _gravity_on(slope_rad: float) -> tuple[float, float, float]:
    return GRAVITY_M_S2 * sin(slope_rad), 0.0, -GRAVITY_M_S2 * cos(slope_rad)


def incline(settings: SimulationSettings, friction: float, slope_deg: float) -> dict[str, Any]:
    """Tilt a square of cloth slowly to a slope, and let it go for one second from there."""
    slope = radians(slope_deg)
    solver = _square(settings, friction, slope)
    start_m = solver.positions_m[:, :2]
    weight_N = solver.mass_kg * GRAVITY_M_S2
    borne_N = weight_N * min(sin(slope), friction * cos(slope))
    solver.start(preload_N=np.column_stack([borne_N, 0 * borne_N]))
    specimen.advance_evenly(solver, 1.0, settings.time_step_s)
    creep_m = float(np.linalg.norm((solver.positions_m[:, :2] - start_m).mean(axis=0)))
    return {
        "sticks": creep_m < CREEP_MAX_M,
        "creep_m": creep_m,
        "acceleration_m_s2": float(solver.velocities_m_s[:, 0].mean() / solver.time_s),
        "theory_acceleration_m_s2": incline_theory(friction, slope),
    }


def tilt(
    settings: SimulationSettings, friction: float, static_kinetic: float = 0.0
) -> dict[str, Any]:
    """Tilt a plane with a square of cloth slowly until the cloth slides; tangent there, or None.

    The static coefficient exceeds the kinetic one, ``friction``, by ``static_kinetic`` of it.
    """
    law = FrictionLaw(friction, {"static_kinetic": {"static_kinetic": static_kinetic}})
    expected = friction * (1 + static_kinetic)
    solver = _square(settings, law)
    start_m = solver.positions_m[:, 0].mean()
    slope_at_slip = None
    for step in range(1, round(TILT_BEYOND * TILT_STEPS) + 1):
        slope = expected * step / TILT_STEPS
        solver.set_gravity(_gravity_on(atan(slope)))
        solver.advance(settings.time_step_s)
        if solver.positions_m[:, 0].mean() - start_m > TILT_SLIDES_M:
            slope_at_slip = slope
            break
    return {"slope_at_slip": slope_at_slip, "theory_slope_at_slip": expected}


def flat_drag(settings: SimulationSettings, friction: float) -> dict[str, Any]:
    """Pull a square of cloth that lies flat along the floor by its leading edge.

    The pull is μ times the whole weight, whatever the shape (Amontons 1699).
    """
    solver = _square(settings, friction, vertices=11, side_m=0.1, led=True)
    pulled = specimen.carried(solver.positions_m, 0.01, 0.0, 0.0)
    specimen.advance_evenly(solver, 2.0, settings.time_step_s, pulled)
    weight_N = solver.mass_kg.sum() * GRAVITY_M_S2
    return {
        "pull_over_weight": float(solver.reactions()[:, 0].sum() / weight_N),
        "theory_pull_over_weight": friction,
    }
