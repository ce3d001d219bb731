"""Landed strip: a heavy strip lowered onto the floor; its foot slips, or its end folds under.

The side to which it buckles is set by a slight natural curl.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import theory
from slipstitch.physics.cloth import ClothSolver, Conditions, rectangle
from slipstitch.physics.experiments.specimen import (
    AREAL_DENSITY_KG_M2,
    cylindrical_strip_tables,
    solver_settings,
)
from slipstitch.physics.gravity import GRAVITY_M_S2
from slipstitch.physics.theory.landed import LARGEST_GAMMA

LENGTH_M = 0.20
THICKNESS_M = 5.0e-4
SPEED_M_S = 0.004  # at the stage's 10 mm/s the heavy part still swings
CURL_PER_M = 0.05
LOWERED_ON_M = 0.010  # after the foot slipped or lay flat
SLIP_M = 2.0e-5
SMALLEST_FRICTION = 0.02


def landed_strip(
    settings: SimulationSettings,
    friction: float,
    gravity_length_m: float = 0.02,
    vertices: float = 149,
) -> dict[str, Any]:
    """Lower a strip that hangs straight down, its foot at the floor, until it slips or lies flat.

    Kept cylindrical: rigidity ke/4.

    Parameters
    ----------
    gravity_length_m : float
        (B/w)^(1/3), bending rigidity over weight per area.
    vertices : int
        Rows of vertices along the strip.

    Returns
    -------
    dict
        ``outcome``, ``slips`` or ``folds`` (``stands`` if neither); ``slip_strain`` or
        ``flat_strain``, the descent since the foot touched, over the length, at which it did
        (else None); ``foot_moved_m``, in the end, a centimetre lower; ``gamma``, (length over
        gravity length)^3;
        ``theory_threshold_friction``, which parts slipping from folding; ``theory_outcome``,
        ``theory_slip_strain``, ``theory_flat_strain``.
    """
    gamma = (LENGTH_M / gravity_length_m) ** 3 if gravity_length_m > 0 else np.inf
    if not 1 <= gamma <= LARGEST_GAMMA:
        raise BadInput(
            f"protocol landed-strip: gravity_length_m {gravity_length_m:g}: must be between "
            f"{LENGTH_M / LARGEST_GAMMA ** (1 / 3):.4g} and {LENGTH_M:g}"
        )
    if friction < SMALLEST_FRICTION:
        raise BadInput(
            f"protocol landed-strip: friction {friction:g}: must be at least {SMALLEST_FRICTION:g}"
        )
    if vertices < 8:
        raise BadInput(f"protocol landed-strip: vertices {vertices:g}: must be at least 8")
    flat = theory.landed_strip(gamma)
    slips_at = theory.landed_strip_slip_strain(friction, gamma)
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
    step_s = settings.time_step_s

    def clamp(time_s: float) -> np.ndarray:
        return start_m - np.array([0.0, 0.0, SPEED_M_S * time_s])

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
    spacing_m = LENGTH_M / (vertices - 1.5)  # two clamped rows straddle the clamp
    mesh = rectangle(vertices, 2, LENGTH_M + 0.5 * spacing_m, spacing_m)
    across, down = mesh.rest_uv_m.T
    start_m = np.column_stack([0 * down, across, down[-1] - down])
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 1] = True
    fixed[:4] = True
    rigidity_Nm = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * gravity_length_m**3
    # What the foot bears is the weight of about one and a half gravity lengths.
    foot_N = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2 * gravity_length_m * spacing_m
    tables = cylindrical_strip_tables(12 * rigidity_Nm / THICKNESS_M**2, rigidity_Nm)
    solver = ClothSolver(
        mesh,
        replace(tables, rest_curvature_per_m=CURL_PER_M),
        start_m,
        friction=friction,
        fixed=fixed,
        settings=solver_settings(settings),
        conditions=Conditions(nodal_force_N=foot_N),
    )
    solver.start()
    return solver, start_m
