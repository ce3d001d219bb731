"""Capstan: a strip laid around a fixed cylinder, held at one end and pulled at the other.

Without weight: the cylinder is the ground, and what presses the strip on it is its tension.
"""

from math import cos, exp, expm1, radians, sin
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments import specimen

RADIUS_M = 0.020
TURN_A_VERTEX_RAD = radians(2.0)
SPAN_M = 0.010  # free, on either side
MEMBRANE_STIFFNESS_N_M = 2000.0
LARGEST_STRAIN = 5.0e-3  # about, where it is pulled
BENDING_OVER_TENSION = 1.0e-3  # B/(T R^2) at the held end; the law needs less than 0.01
BOUNDS = {"wrap_deg": (0.01, 270.0)}
LARGEST_RATIO = 100.0
PULL_S = 2.0
ROUNDS_MAX = 20  # of that, until nothing sticks any more
DEMANDS = (specimen.Demand("tension_ratio", 0.02),)


def capstan_theory(friction: float, wrap_rad: float) -> float:
    """Ratio of the tensions of a strip that slips around a fixed cylinder by an angle φ (rad).

    T₂/T₁ = exp(μ φ) (Euler 1769, Eytelwein 1808), of a bending rigidity B/(T R²) < 0.01.
    """
    return exp(
        specimen.require("friction", friction, 0.0) * specimen.require("wrap_rad", wrap_rad, 0.0)
    )


def capstan(settings: SimulationSettings, friction: float, wrap_deg: float) -> dict[str, Any]:
    """Pull a strip around a cylinder until all of it slips; its bending is B/(T R²) where held."""
    wrap = radians(wrap_deg)
    expected = capstan_theory(friction, wrap)
    if expected > LARGEST_RATIO:
        raise BadInput(
            f"protocol capstan: exp(friction x wrap) is {expected:.3g}: must be at most "
            f"{LARGEST_RATIO:g}"
        )
    held_strain = LARGEST_STRAIN / expected
    solver, start_m = _wrapped(settings, friction, wrap, held_strain)
    rows = solver.mesh.shape[0]
    tangent = np.array([cos(wrap / 2), 0.0, -sin(wrap / 2)])  # of the pulled end, last row
    pulled = np.arange(2 * rows) >= 2 * (rows - 1)
    # How much the strip grows until all of it slips; then as much again, to see it slide.
    growth = expm1(friction * wrap) / friction - wrap if friction else 0.0
    stretch_m = held_strain * (RADIUS_M * growth + SPAN_M * (exp(friction * wrap) - 1))
    stretch_m = 2 * stretch_m + held_strain * SPAN_M

    def pull(time_s: float) -> np.ndarray:
        return start_m + pulled[:, None] * tangent * (stretch_m * time_s / PULL_S)

    for _ in range(ROUNDS_MAX):
        specimen.advance_evenly(solver, PULL_S, settings.time_step_s, pull)
        if not (friction and solver.sticks().any()):
            break
    else:
        raise NotConverged(
            f"part of the strip still sticks {ROUNDS_MAX * PULL_S:g} s after it was pulled"
        )
    reactions_N = solver.reactions()
    pull_N = float(reactions_N[-2:].sum(axis=0) @ tangent)
    hold_N = float(reactions_N[:2].sum(axis=0) @ (tangent * (-1, 1, 1)))
    width_m = float(np.ptp(solver.mesh.rest_uv_m[:, 0]))
    rigidity_Nm = _rigidity(held_strain)
    return {
        "tension_ratio": pull_N / hold_N,
        "theory_tension_ratio": expected,
        "bending_over_tension": rigidity_Nm * width_m / (hold_N * RADIUS_M**2),
    }


def _rigidity(held_strain: float) -> float:
    tension_N_m = MEMBRANE_STIFFNESS_N_M * held_strain
    return BENDING_OVER_TENSION * tension_N_m * RADIUS_M**2


def _wrapped(
    settings: SimulationSettings, friction: float, wrap: float, held_strain: float
) -> tuple[ClothSolver, np.ndarray]:
    """The strip around the cylinder and off it along the tangents, stretched evenly."""
    turns = max(2, round(wrap / TURN_A_VERTEX_RAD))
    turn = wrap / turns
    spacing_m = 2 * RADIUS_M * sin(turn / 2)
    span = round(SPAN_M / spacing_m)
    rows = turns + 1 + 2 * span
    rest_m = spacing_m / (1 + held_strain)
    mesh = rectangle(rows, 2, (rows - 1) * rest_m, rest_m)
    number = np.arange(rows) - (rows - 1) / 2
    on = np.clip(number * turn, -wrap / 2, wrap / 2)
    off_m = (np.abs(number) - turns / 2).clip(0) * spacing_m * np.sign(number)
    x = RADIUS_M * np.sin(on) + off_m * np.cos(on)
    z = RADIUS_M * (np.cos(on) - 1) - off_m * np.sin(on)
    start_m = np.column_stack([np.repeat(x, 2), mesh.rest_uv_m[:, 0], np.repeat(z, 2)])
    fixed = specimen.held(mesh, 1)
    fixed[-2:] = True
    tension_N = MEMBRANE_STIFFNESS_N_M * held_strain * rest_m
    tables = specimen.cylindrical_strip_tables(MEMBRANE_STIFFNESS_N_M, _rigidity(held_strain))
    conditions = Conditions((0.0, 0.0, 0.0), 1 / RADIUS_M, nodal_force_N=tension_N * turn / 2)
    return specimen.started(settings, mesh, tables, start_m, fixed, friction, conditions), start_m
