"""Lateral buckling: a strip clamped at one end, its plane vertical, turns over under its weight.

The mesh is no isotropic plate: a hinge over every edge, all equally stiff, resists twist two to
four times as much as one (the diagonals bear it). So theory gets the strip's own rigidities,
measured on the same mesh: bending from a small sag, torsion from a small twist.
"""

from math import sqrt
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments import specimen
from slipstitch.physics.fabric import isotropic_tables

LENGTH_M = 0.20
COLUMNS = 5
WIDTH_OVER_THICKNESS = 20.0  # 40 times as stiff in its plane as in twist
WEIGHT_GAMMA = 25.0  # of the strip under gravity; other weights by other gravity
RIGIDITY_NM = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * LENGTH_M**3 / WEIGHT_GAMMA
LONG_STEP_S = 10 * sqrt(WEIGHT_GAMMA * LENGTH_M / GRAVITY_M_S2)
SIDE_PUSH = 1.0e-3  # sideways over vertical weight, what the strip buckles from
FAR, NEAR = (0.85, 0.95), (0.96, 0.98)  # of the critical weight as known before
SMALL_GAMMA = 0.05  # sags by 0.6 % of its length: linear
SMALL_TWIST_RAD = 0.02
BOUNDS = {"width_over_length": (0.02, 0.5)}  # theory is for narrow strips
# First root of J_{-1/6}(x/6) = 0 is x = 12.854: see the test, which solves the eigenproblem.
NARROW_STRIP = 12.853718
DEMANDS = (specimen.Demand("critical_gamma", 0.05),)


def lateral_buckling_theory(bending: float, torsion: float) -> float:
    """Critical weight Γ* = ρ g L³ / D of a strip clamped at one end, its plane vertical.

    A beam under its own weight q per length buckles sideways at q L³ = 12.854 √(EI · GJ) (Prandtl
    1899; Timoshenko & Gere 1961, sec. 6.3), EI and GJ here over D b: of a thin isotropic strip of
    width b and plate rigidity D they are 1 − ν² and 2 (1 − ν).
    """
    return NARROW_STRIP * sqrt(bending * torsion)


def lateral_buckling(settings: SimulationSettings, width_over_length: float) -> dict[str, Any]:
    """Weight over rigidity at which the strip buckles sideways.

    A small sideways weight bends the strip by d, amplified by 1/(1 - (Γ/Γ*)²): Γ/d falls linearly
    in Γ² to zero at Γ* (Southwell 1932). Γ is over the plate's rigidity ke/4, the strip's
    rigidities over the plate's times width.
    """
    solver = _strip(settings, width_over_length, held_ends=1)
    bending = SMALL_GAMMA * LENGTH_M / (8 * _sideways_m(solver, SMALL_GAMMA, 1.0, 0.0))
    torsion = _torsion(settings, width_over_length)
    expected = lateral_buckling_theory(bending, torsion)
    # The other modes' share of the bending fades as the weight comes near: refined once.
    critical = _southwell(solver, _southwell(solver, expected, FAR), NEAR)
    return {
        "critical_gamma": critical,
        "theory_critical_gamma": expected,
        "bending_over_plate": bending,
        "torsion_over_plate": torsion,
    }


def _southwell(solver: ClothSolver, estimate: float, fractions: tuple[float, float]) -> float:
    """Γ*, from the bending at two fractions of an estimate of it."""
    gammas = np.array(fractions) * estimate
    over = gammas / [_sideways_m(solver, gamma, SIDE_PUSH, 1.0) for gamma in gammas]
    slope = (over[1] - over[0]) / (gammas[1] ** 2 - gammas[0] ** 2)
    return float(sqrt(gammas[1] ** 2 - over[1] / slope))


def _strip(settings: SimulationSettings, width_over_length: float, held_ends: int) -> ClothSolver:
    """The strip along x, its width along z; two clamped rows straddle each clamp."""
    width_m = width_over_length * LENGTH_M
    rows = round((COLUMNS - 1) / width_over_length) + 1 + held_ends
    spacing_m = LENGTH_M / (rows - 1 - 0.5 * held_ends)
    mesh = rectangle(rows, COLUMNS, (rows - 1) * spacing_m, width_m)
    across, down = mesh.rest_uv_m.T
    membrane_N_m = 12 * RIGIDITY_NM * (WIDTH_OVER_THICKNESS / width_m) ** 2
    # Clear of the floor.
    start_m = np.column_stack([down - 0.5 * spacing_m, 0 * across, across - width_m / 2 + LENGTH_M])
    fixed = specimen.held(mesh, 2, cylindrical=False)
    if held_ends == 2:
        fixed[-2 * COLUMNS :] = True
    tables = isotropic_tables(specimen.AREAL_DENSITY_KG_M2, membrane_N_m, 4 * RIGIDITY_NM)
    weightless = Conditions(gravity_m_s2=(0.0, 0.0, 0.0))
    floor = 10 * SIDE_PUSH  # out of balance by no more than 0.1 % of the sideways weight
    return specimen.started(
        settings, mesh, tables, start_m, fixed, conditions=weightless, friction_floor=floor
    )


def _sideways_m(solver: ClothSolver, gamma: float, side: float, down: float) -> float:
    """Lateral deflection of the tip's centre at rest; weights sideways and down in units of Γ."""
    gravity_m_s2 = GRAVITY_M_S2 * gamma / WEIGHT_GAMMA
    solver.set_gravity((0.0, side * gravity_m_s2, -down * gravity_m_s2))
    specimen.bring_to_rest(solver, LONG_STEP_S)
    return float(solver.positions_m[-COLUMNS:, 1].mean())


def _torsion(settings: SimulationSettings, width_over_length: float) -> float:
    """GJ over plate rigidity times width: torque over twist per length of the middle half."""
    solver = _strip(settings, width_over_length, held_ends=2)
    start_m = solver.positions_m.copy()
    last = slice(-2 * COLUMNS, None)
    specimen.bring_to_rest(solver, LONG_STEP_S, _turning(start_m, last))
    lever_m = solver.positions_m[last] - (0.0, 0.0, LENGTH_M)
    force_N = solver.reactions()[last]
    torque_Nm = (lever_m[:, 1] * force_N[:, 2] - lever_m[:, 2] * force_N[:, 1]).sum()
    x = solver.positions_m.reshape(-1, COLUMNS, 3)
    rows = len(x)
    low, high = rows // 4, rows - 1 - rows // 4
    tilt = np.arctan2(x[:, -1, 1] - x[:, 0, 1], x[:, -1, 2] - x[:, 0, 2])
    length_m = x[high, :, 0].mean() - x[low, :, 0].mean()
    rate = (tilt[high] - tilt[low]) / length_m
    return float(abs(torque_Nm / rate) / (RIGIDITY_NM * width_over_length * LENGTH_M))


def _turning(start_m: np.ndarray, end: slice) -> specimen.Motion:
    """Turn the held end about the strip's axis over the first step."""

    def at(time_s: float) -> np.ndarray:
        angle = SMALL_TWIST_RAD * min(time_s / LONG_STEP_S, 1.0)
        x = start_m.copy()
        lever = start_m[end, 2] - LENGTH_M
        x[end, 1] = lever * np.sin(angle)
        x[end, 2] = LENGTH_M + lever * np.cos(angle)
        return x

    return at
