"""Heavy cantilever: a narrow strip clamped horizontally that bends under its own weight."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.experiments import specimen
from slipstitch.physics.fabric import isotropic_tables

LENGTH_M = 0.20
ROWS = 81
THICKNESS_M = 2.0e-3  # thick against the sag across: the cross-section is free to curve
BOUNDS = {"gamma": (0.05, 200.0)}
SMALL_GAMMA = 0.05  # sags by 0.6 % of its length: linear to 4e-5
DEMANDS = (specimen.Demand("height_over_width", 0.02),)
THEORY_GAMMAS = (1.0e-3, 1.0e4)
# Bounds of the shooting parameter that enclose that range of Γ.
_PARAMETERS = (-10.0, 80.0)


@dataclass(frozen=True)
class HeavyCantilever:
    """Shape of a heavy cantilever of length 1."""

    gamma: float  # Γ = ρ g L³ / B: areal density ρ, bending rigidity B of a unit width
    height_over_width: float  # sag of the tip over its horizontal distance from the clamp
    tip_angle_rad: float  # below the horizontal


def _from_the_tip(parameter: float) -> HeavyCantilever:
    """Integrate from the free end, where two of the three unknowns are known.

    With lengths in units of (B/ρg)^(1/3) and δ = π/2 − θ, δ'' = s sin δ from δ(0) = δ₀, δ'(0) = 0
    to the clamp, where δ first reaches π/2. Every δ₀ is the tip of one strip and Γ is the cube of
    its length: no other branch can be met by mistake. δ₀ falls to 0 as the parameter, and Γ, grow.
    """
    tip_deficit = 0.5 * math.pi / (1.0 + math.exp(parameter))

    def slope(s, state):  # of δ, δ', and horizontal and vertical distance from the tip
        deficit, curvature = state[0], state[1]
        sine = math.sin(deficit)
        return (curvature, s * sine, sine, math.cos(deficit))

    def clamp(_, state):
        return state[0] - math.pi / 2

    clamp.terminal = True  # type: ignore[attr-defined]  # how SciPy is told to stop there
    solution = solve_ivp(
        slope,
        (0.0, 50.0),
        (tip_deficit, 0.0, 0.0, 0.0),
        method="DOP853",
        events=clamp,
        rtol=1e-11,
        atol=1e-60,
    )
    across, down = solution.y_events[0][0, 2:]
    return HeavyCantilever(
        solution.t_events[0][0] ** 3, float(down / across), 0.5 * math.pi - tip_deficit
    )


def heavy_cantilever(gamma: float) -> HeavyCantilever:
    """Sag of a strip clamped horizontally at one end, 10⁻³ ≤ Γ ≤ 10⁴.

    Solves θ'' = −Γ (1 − s) cos θ with θ(0) = 0 at the clamp and θ'(1) = 0 at the tip (θ below the
    horizontal; Bickley 1934; Peirce 1930 for cloth), by shooting from the tip.
    """
    gamma = specimen.require("gamma", gamma, *THEORY_GAMMAS)
    parameter = brentq(lambda x: math.log(_from_the_tip(x).gamma / gamma), *_PARAMETERS, xtol=1e-12)
    return _from_the_tip(parameter)


def cantilever(settings: SimulationSettings, gamma: float) -> dict[str, Any]:
    """Height over width of a strip at rest, at Γ = areal density x gravity x length^3 / B.

    The mesh's rigidity is read off a sag so small that it is linear (Γ/8 of the length).
    """
    guess = 4.0
    _, down_m = _sag(settings, SMALL_GAMMA, guess)
    ratio = guess * (8 * down_m / LENGTH_M) / SMALL_GAMMA
    across_m, down_m = _sag(settings, gamma, ratio)
    return {
        "height_over_width": down_m / across_m,
        "theory_height_over_width": heavy_cantilever(gamma).height_over_width,
        "hinge_stiffness_over_rigidity": ratio,
    }


def _sag(
    settings: SimulationSettings, gamma: float, stiffness_over_rigidity: float
) -> tuple[float, float]:
    """Horizontal and vertical distance of the tip from the clamp, at rest, in m."""
    mesh, spacing_m = specimen.clamped_strip(ROWS, LENGTH_M)
    rigidity_Nm = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * LENGTH_M**3 / gamma
    height_m = 2 * LENGTH_M  # clear of the floor
    start_m = np.column_stack(
        [mesh.rest_uv_m[:, ::-1], np.full(mesh.vertex_count, height_m)]
    ) - np.array([0.5 * spacing_m, 0.0, 0.0])
    stiffness = 12 * rigidity_Nm / THICKNESS_M**2, stiffness_over_rigidity * rigidity_Nm
    tables = isotropic_tables(specimen.AREAL_DENSITY_KG_M2, *stiffness)
    # No friction here: the tolerance is relative to the lesser of weight and rigidity.
    floor = min(1.0, 1.0 / gamma)
    fixed = specimen.held(mesh, 2, cylindrical=False)
    solver = specimen.started(settings, mesh, tables, start_m, fixed, friction_floor=floor)
    specimen.bring_to_rest(solver, math.sqrt(gamma * LENGTH_M / GRAVITY_M_S2))
    tip_m = solver.positions_m[-2:].mean(axis=0)
    return float(tip_m[0]), float(height_m - tip_m[2])
