"""The isotropic cloth of the known-answer experiments, and how a strip of it hangs."""

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import SolverSettings
from slipstitch.physics.fabric import ElasticTables, isotropic_tables

AREAL_DENSITY_KG_M2 = 0.2
MEMBRANE_STIFFNESS_N_M = 200.0
HINGE_STIFFNESS_N_M = 5.0e-5
DIAGONALS_OVER_EDGES = 1000.0


def cylindrical_strip_tables(membrane_stiffness_N_m: float, rigidity_Nm: float) -> ElasticTables:
    """Tables of a strip that bends about the mesh lines across it and resists twist.

    A narrow mesh of alternating diagonals bends more easily than a cylinder, by ke/4.95 instead
    of ke/4: its cross edges tilt to and fro. Stiff diagonals keep them from it, and the
    rigidity is the cylinder's. The cells of the mesh must be squares.

    Parameters
    ----------
    membrane_stiffness_N_m : float
        Young's modulus times thickness.
    rigidity_Nm : float
        B of a unit width.
    """
    tables = isotropic_tables(AREAL_DENSITY_KG_M2, membrane_stiffness_N_m, 4 * rigidity_Nm)
    bending_N_m = tables.bending_N_m.copy()
    bending_N_m[1] *= DIAGONALS_OVER_EDGES
    return replace(tables, bending_N_m=bending_N_m)


def hanging_with_tail(down_m: np.ndarray, length_m: float, height_m: float):
    """Straight down, a quarter of a circle, a flat tail: where to start the drag from.

    Returns
    -------
    ahead_m, height_m : ndarray, shape of ``down_m``
    """
    radius_m = min(0.2 * height_m, (length_m - height_m) / (pi / 2 - 1) * 0.8)
    straight_m, arc_m = height_m - radius_m, radius_m * pi / 2
    angle = np.clip((down_m - straight_m) / radius_m, 0.0, pi / 2)
    ahead = -radius_m * (1 - np.cos(angle)) - np.maximum(down_m - straight_m - arc_m, 0.0)
    height = height_m - np.minimum(down_m, straight_m) - radius_m * np.sin(angle)
    return ahead, height


def solver_settings(settings: SimulationSettings, **changes: Any) -> SolverSettings:
    """The simulation's solver settings, some changed; these specimens never touch themselves."""
    return replace(SolverSettings.of(settings), self_contact=False, **changes)
