"""Heavy cantilever: a narrow strip clamped horizontally that bends under its own weight."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import theory
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.rest import bring_to_rest
from slipstitch.physics.experiments.specimen import AREAL_DENSITY_KG_M2, solver_settings
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.gravity import GRAVITY_M_S2

LENGTH_M = 0.20
ROWS = 81
COLUMNS = 2
THICKNESS_M = 2.0e-3  # thick against the sag across: the cross-section is free to curve
GAMMA_RANGE = (0.05, 200.0)
SMALL_GAMMA = 0.05  # sags by 0.6 % of its length: linear to 4e-5


def cantilever(settings: SimulationSettings, gamma: float) -> dict[str, Any]:
    """Height over width of a strip at rest, at a ratio of weight to rigidity.

    The rigidity is the one that the mesh has: read off a sag so small that it is linear
    (deflection of the tip Γ/8 of the length).

    Parameters
    ----------
    gamma : float
        Γ = areal density x gravity x length^3 / B.

    Returns
    -------
    dict
        ``height_over_width``, ``theory_height_over_width``, and
        ``hinge_stiffness_over_rigidity``, ke/B.
    """
    if not GAMMA_RANGE[0] <= gamma <= GAMMA_RANGE[1]:
        raise BadInput(
            f"protocol cantilever: gamma {gamma:g}: must be between {GAMMA_RANGE[0]:g} "
            f"and {GAMMA_RANGE[1]:g}"
        )
    ratio = hinge_stiffness_over_rigidity(settings)
    across_m, down_m = sag(settings, gamma, ratio)
    return {
        "height_over_width": down_m / across_m,
        "theory_height_over_width": theory.heavy_cantilever(gamma).height_over_width,
        "hinge_stiffness_over_rigidity": ratio,
    }


def hinge_stiffness_over_rigidity(settings: SimulationSettings) -> float:
    """ke/B of this mesh in small bending."""
    guess = 4.0
    _, down_m = sag(settings, SMALL_GAMMA, guess)
    return guess * (8 * down_m / LENGTH_M) / SMALL_GAMMA


def sag(
    settings: SimulationSettings, gamma: float, stiffness_over_rigidity: float
) -> tuple[float, float]:
    """Horizontal and vertical distance of the tip from the clamp, at rest, in m."""
    # Two clamped rows straddle the clamp.
    spacing_m = LENGTH_M / (ROWS - 1.5)
    mesh = rectangle(ROWS, COLUMNS, LENGTH_M + 0.5 * spacing_m, (COLUMNS - 1) * spacing_m)
    rigidity_Nm = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * LENGTH_M**3 / gamma
    height_m = 2 * LENGTH_M  # clear of the floor
    start_m = np.column_stack(
        [mesh.rest_uv_m[:, ::-1], np.full(mesh.vertex_count, height_m)]
    ) - np.array([0.5 * spacing_m, 0.0, 0.0])
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[: 2 * COLUMNS] = True
    solver = ClothSolver(
        mesh,
        isotropic_tables(
            AREAL_DENSITY_KG_M2,
            12 * rigidity_Nm / THICKNESS_M**2,
            stiffness_over_rigidity * rigidity_Nm,
        ),
        start_m,
        friction=0.0,
        fixed=fixed,
        # No friction here: the tolerance is relative to the lesser of weight and rigidity.
        settings=solver_settings(settings, friction_floor=min(1.0, 1.0 / gamma)),
    )
    solver.start()
    bring_to_rest(solver, sqrt(gamma * LENGTH_M / GRAVITY_M_S2))
    tip_m = solver.positions_m[-COLUMNS:].mean(axis=0)
    return float(tip_m[0]), float(height_m - tip_m[2])
