"""Landed strip: a heavy strip lowered onto the floor; its foot slips, or its end folds under.

The side to which it buckles is set by a slight natural curl.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from slipstitch.base.errors import NotConverged
from slipstitch.config.section import FRICTION_MAX
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, Conditions
from slipstitch.physics.experiments import specimen, strip
from slipstitch.physics.experiments.strip import FLAT_FOOT_RAD, LENGTH_M, StripState

THICKNESS_M = 5.0e-4
SPEED_M_S = 0.004  # at the stage's 10 mm/s the heavy part still swings
CURL_PER_M = 0.05
LOWERED_ON_M = 0.010  # after the foot slipped or lay flat
SLIP_M = 2.0e-5
SMALLEST_FRICTION = 0.02
DEMANDS = (
    specimen.Demand("outcome"),
    specimen.Demand("slip_strain", 0.006, relative=False),
    specimen.Demand("flat_strain", 0.006, relative=False),
)
LARGEST_GAMMA = 3.0e3
BOUNDS = {
    "friction": (SMALLEST_FRICTION, FRICTION_MAX),
    "gravity_length_m": (LENGTH_M / LARGEST_GAMMA ** (1 / 3), LENGTH_M),
    "vertices": specimen.VERTICES_RANGE,
}
SMALLEST_FOOT_ANGLE_RAD = 0.02
# Weights by which the strip with weight is reached from the one without.
_LADDER = np.geomspace(1.0, 5.0e3, 23)
_STATIONS = np.linspace(0.0, 1.0, 201)


def _solve(gamma: float, foot_angle: float, guess):
    """Collocation; the unknowns are the strip's angle and path, and P and Q at the foot."""

    def slope(s, state, loads):
        angle = state[0]
        sine, cosine = np.sin(angle), np.cos(angle)
        thrust = loads[0] - gamma * (1.0 - s)
        return np.vstack((state[1], -(thrust * sine + loads[1] * cosine), sine, cosine))

    def ends(clamp, foot, _):
        return np.array([clamp[0], clamp[2], clamp[3], foot[1], foot[2], foot[0] + foot_angle])

    stations, states, loads = guess
    solution = solve_bvp(slope, ends, stations, states, p=loads, tol=1e-6, max_nodes=20000)
    if solution.status != 0:
        raise NotConverged(
            f"landed strip: no equilibrium at gamma {gamma:g}, foot angle {foot_angle:.3f} rad"
        )
    return solution.x, solution.y, solution.p


def _weightless(foot_angle: float):
    """The strip without weight, with the signs of this boundary value problem."""
    state = strip.strip_state_at_foot_angle(foot_angle)
    path = state.curve
    steps = np.gradient(path, _STATIONS, axis=0)
    angle = np.arctan2(steps[:, 0], steps[:, 1])
    side = -np.sign(angle[-1])
    states = (side * angle, side * np.gradient(angle, _STATIONS), side * path[:, 0], path[:, 1])
    # Moment balance about the clamp: its moment is Q times the foot's depth.
    loads = (state.vertical_load, -np.sign(states[1][0]) * state.horizontal_load)
    return _STATIONS, np.vstack(states), np.array(loads)


@lru_cache(maxsize=16)
def _flat_foot(gamma: float):
    guess = _weightless(FLAT_FOOT_RAD)
    for step in _LADDER[gamma > _LADDER]:
        guess = _solve(float(step), FLAT_FOOT_RAD, guess)
    return _solve(gamma, FLAT_FOOT_RAD, guess)


def _state(foot_angle: float, solved) -> StripState:
    _, states, loads = solved
    strain, (vertical, horizontal) = float(1.0 - states[3, -1]), loads
    return StripState(strain, foot_angle, float(vertical), float(abs(horizontal)), states[2:].T)


def landed_strip_theory(gamma: float) -> StripState:
    """State at which the foot of a lowered heavy strip comes to lie flat; Γ = w L³/B to 3000.

    A strip hangs from a clamp, straight down, and is lowered on a floor. Its foot, held by friction
    below the clamp, carries P and Q; the strip above buckles sideways: B θ'' = −((P − w (L − s))
    sin θ + Q cos θ), θ(0) = 0, θ'(L) = 0, ∫ sin θ ds = 0, θ from the vertical, s from the clamp, as
    of Sano, Yamaguchi & Wada (2017) but with weight. |Q|/P grows until the foot's tangent lies
    flat. With less friction than the ``load_ratio`` there the foot slips and the tail lies down
    straight; with more it is folded under.
    """
    gamma = specimen.require("gamma", gamma, 0.0, LARGEST_GAMMA)
    return _state(FLAT_FOOT_RAD, _flat_foot(gamma))


def landed_strip_slip_strain(friction: float, gamma: float) -> float | None:
    """Strain at which the foot of a lowered strip slips; None if it lies flat first."""
    friction = specimen.require("friction", friction, SMALLEST_FRICTION)
    flat = landed_strip_theory(gamma)
    if friction > flat.load_ratio:
        return None
    solved = {FLAT_FOOT_RAD: _flat_foot(float(gamma))}

    def at(angle: float) -> StripState:
        nearest = min(solved, key=lambda known: abs(known - angle))
        for step in np.linspace(nearest, angle, 2 + int(abs(nearest - angle) / 0.15))[1:]:
            solved[float(step)] = _solve(float(gamma), float(step), solved[nearest])
            nearest = float(step)
        return _state(nearest, solved[nearest])

    ends = SMALLEST_FOOT_ANGLE_RAD, FLAT_FOOT_RAD
    return at(brentq(lambda angle: at(angle).load_ratio - friction, *ends, xtol=1e-6)).strain


def landed_strip(
    settings: SimulationSettings,
    friction: float,
    gravity_length_m: float = 0.02,
    vertices: float = 149,
) -> dict[str, Any]:
    """Lower a strip that hangs straight down, its foot at the floor, until it slips or lies flat.

    The gravity length is (B/w)^(1/3), of bending rigidity and weight per area; `vertices` are the
    rows along the strip. Strains are the descent since the foot touched, over the length;
    ``outcome`` is slips, folds or stands; ``foot_moved_m`` is read a centimetre lower.
    """
    gamma = (LENGTH_M / gravity_length_m) ** 3
    flat = landed_strip_theory(gamma)
    slips_at = landed_strip_slip_strain(friction, gamma)
    measured = _lower(settings, friction, gravity_length_m, int(vertices), 2 * flat.strain)
    return {
        **measured,
        "theory_threshold_friction": flat.load_ratio,
        "gamma": gamma,
        "theory_outcome": "folds" if slips_at is None else "slips",
        "theory_slip_strain": slips_at,
        "theory_flat_strain": flat.strain if slips_at is None else None,
    }


def _lower(settings, friction, gravity_length_m, vertices, largest_strain) -> dict[str, Any]:
    solver, start_m = _hanging(settings, friction, gravity_length_m, vertices)
    step_s, clamp = settings.time_step_s, specimen.carried(start_m, 0.0, 0.0, -SPEED_M_S)
    slip_strain = flat_strain = None
    end_s = largest_strain * LENGTH_M / SPEED_M_S
    while solver.time_s < end_s:
        solver.advance(step_s, clamp)
        if slip_strain is not None or flat_strain is not None:
            continue
        middle = SPEED_M_S * (solver.time_s - step_s / 2) / LENGTH_M
        if np.abs(solver.positions_m[-2:, 0]).max() > SLIP_M:
            slip_strain = middle
        elif (solver.positions_m[-4:-2, 2] < 0).any():
            flat_strain = middle
        else:
            continue
        end_s = solver.time_s + LOWERED_ON_M / SPEED_M_S
    slips, folds = slip_strain is not None, flat_strain is not None
    return {
        "outcome": "slips" if slips else "folds" if folds else "stands",
        "slip_strain": slip_strain,
        "flat_strain": flat_strain,
        "foot_moved_m": float(np.abs(solver.positions_m[-2:, 0]).max()),
    }


def _hanging(settings, friction, gravity_length_m, vertices) -> tuple[ClothSolver, np.ndarray]:
    mesh, spacing_m = specimen.clamped_strip(vertices, LENGTH_M)
    across, down = mesh.rest_uv_m.T
    start_m = np.column_stack([0 * down, across, down[-1] - down])
    rigidity_Nm = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * gravity_length_m**3
    # What the foot bears is the weight of about one and a half gravity lengths.
    foot_N = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * gravity_length_m * spacing_m
    tables = specimen.cylindrical_strip_tables(12 * rigidity_Nm / THICKNESS_M**2, rigidity_Nm)
    tables = replace(tables, rest_curvature_per_m=CURL_PER_M)
    conditions, fixed = Conditions(nodal_force_N=foot_N), specimen.held(mesh, 2)
    return specimen.started(settings, mesh, tables, start_m, fixed, friction, conditions), start_m
