"""Strip pushed on the floor: clamped vertically on top, its foot held by friction until it slips.

Sano, Yamaguchi & Wada, Phys. Rev. Lett. 118, 178001 (2017). Kept cylindrical, so that the mesh
is a discrete elastica of rigidity ke/4. The push starts from the buckled strip, at a strain of
1e-4: pushed straight, a perfect strip would store its load and then be thrown into its buckle,
foot and all.
"""

from __future__ import annotations

from dataclasses import dataclass
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

LENGTH_M = 0.20
THICKNESS_M = 1.0e-3
SPEED_M_S = 0.010  # the stage's
START_STRAIN = 1.0e-4
LARGEST_STRAIN = 0.345  # past 0.3303, where the foot lies flat
LARGEST_GAMMA = 0.3  # above, the weight shifts the friction at slip by more than 0.5 %
SLIP_M = 1.0e-5  # the foot's elastic microslip stays below


@dataclass
class StripPush:
    """One push, step by step.

    Attributes
    ----------
    strain : list of float
        Descent of the clamp over the length at the end of each step.
    load_ratio : list of float
        |Q|/P, friction over load on the floor.
    slip_strain : float or None
        Strain at which the foot slipped: |Q|/P extrapolated to the friction coefficient, within
        the step in which the foot moved.
    flat_strain : float or None
        Strain in the middle of the step in which the foot came to lie flat.
    shape_m : ndarray, shape (n, 2)
        Sideways and downwards from the clamp, at the last step before slipping or lying flat.
    shape_strain : float
        Strain of that step.
    newton_iterations : int
        What the push cost.
    """

    strain: list[float]
    load_ratio: list[float]
    slip_strain: float | None
    flat_strain: float | None
    shape_m: np.ndarray
    shape_strain: float
    newton_iterations: int = 0

    @property
    def regime(self) -> str:
        """``slipped``, ``partially slipped`` (flat before it slipped), or ``pinned``."""
        if self.flat_strain is not None:
            return "partially slipped"
        return "pinned" if self.slip_strain is None else "slipped"


def strip(
    settings: SimulationSettings,
    friction: float,
    vertices: float = 149,
    gamma: float = 0.0,
    strain: float = LARGEST_STRAIN,
) -> dict[str, Any]:
    """A 20 cm strip pushed on the floor until its foot slips or lies flat.

    Parameters
    ----------
    vertices : int
        Rows of vertices along the strip.
    gamma : float
        Weight over rigidity, areal density x gravity x length^3 / B; 0: without weight.
    strain : float
        How far it is pushed, over its length.

    Returns
    -------
    dict
        ``slip_strain`` (None if it never slips as a whole), ``regime``, ``friction_at_slip``
        (|Q|/P in the simulator when the foot slips), ``friction_read_from_strain`` (which
        friction theory reads off the slip strain), ``theory_slip_strain``, ``theory_regime``,
        ``flat_strain``; and what pictures need: ``strain`` and ``load_ratio`` of each step,
        ``shape_m`` at ``shape_strain``, ``newton_iterations``.
    """
    push = push_strip(settings, friction, int(vertices), gamma, strain)
    slips_at = theory.strip_slip_strain(friction)
    read = None
    if push.slip_strain is not None and push.slip_strain >= 1e-6:
        lies_flat = theory.strip_state_at_foot_angle(np.pi / 2)
        read = theory.strip_state(min(push.slip_strain, lies_flat.strain)).load_ratio
    return {
        "slip_strain": push.slip_strain,
        "regime": push.regime,
        "friction_at_slip": None if push.slip_strain is None else push.load_ratio[-1],
        "friction_read_from_strain": read,
        "theory_slip_strain": slips_at,
        "theory_regime": theory_regime(friction, strain),
        "flat_strain": push.flat_strain,
        "strain": push.strain,
        "load_ratio": push.load_ratio,
        "shape_m": push.shape_m.tolist(),
        "shape_strain": push.shape_strain,
        "newton_iterations": push.newton_iterations,
    }


def theory_regime(friction: float, strain: float = LARGEST_STRAIN) -> str:
    """Theoretical state of a weightless strip pushed to a strain."""
    slips_at = theory.strip_slip_strain(friction)
    if slips_at is not None and slips_at <= strain:
        return "slipped"
    lies_flat_at = theory.strip_state_at_foot_angle(np.pi / 2).strain
    return "partially slipped" if strain >= lies_flat_at else "pinned"


def push_strip(
    settings: SimulationSettings, friction: float, vertices: int, gamma: float, strain: float
) -> StripPush:
    """Push until the foot slips, lies flat, or the strain is reached.

    Raises
    ------
    BadInput
        Fewer than 8 vertices, too much weight, or a strain out of range.
    NotConverged
        The solver did not converge.
    """
    if vertices < 8:
        raise BadInput(f"protocol strip: vertices {vertices}: must be at least 8")
    if gamma > LARGEST_GAMMA:
        raise BadInput(
            f"protocol strip: gamma {gamma:g}: must be at most {LARGEST_GAMMA}, for the weight "
            "to be negligible"
        )
    if not START_STRAIN < strain <= 0.5:
        raise BadInput(
            f"protocol strip: strain {strain:g}: must be above {START_STRAIN:g}, at most 0.5"
        )
    solver, start_m = _buckled_strip(settings, friction, vertices, gamma)
    step_s = settings.time_step_s
    foot = slice(-2, None)
    push = StripPush([], [], None, None, _profile(solver), START_STRAIN)
    rested_m = solver.positions_m[foot, 0].copy()

    def clamp(time_s: float) -> np.ndarray:
        return start_m - np.array([0.0, 0.0, SPEED_M_S * time_s])

    steps = int(np.ceil((strain - START_STRAIN) * LENGTH_M / (SPEED_M_S * step_s) - 1e-9))
    for _ in range(steps):
        solver.advance(step_s, clamp)
        now = START_STRAIN + SPEED_M_S * solver.time_s / LENGTH_M
        force_N = solver.floor_forces().sum(axis=0)
        push.strain.append(now)
        push.load_ratio.append(float(abs(force_N[0]) / max(force_N[2], 1e-300)))
        if np.abs(solver.positions_m[foot, 0] - rested_m).max() > SLIP_M:
            push.slip_strain = _crossing(push, friction)
            break
        if (solver.positions_m[-4:-2, 2] < 0).any():
            push.flat_strain = 0.5 * (now + push.shape_strain)
            break
        push.shape_m, push.shape_strain = _profile(solver), now
    push.newton_iterations = solver.record.newton_iterations
    return push


def _crossing(push: StripPush, friction: float) -> float:
    """Strain in the last step at which the load ratio of the steps before reaches the friction."""
    if len(push.strain) < 3:
        return push.strain[-1]
    (first, before, last), (ratio_first, ratio_before) = push.strain[-3:], push.load_ratio[-3:-1]
    slope = (ratio_before - ratio_first) / (before - first)
    if slope <= 0:
        return last
    return float(np.clip(before + (friction - ratio_before) / slope, before, last))


def _profile(solver: ClothSolver) -> np.ndarray:
    """Sideways and downwards from the clamp, shape (n, 2)."""
    x = solver.positions_m.reshape(-1, 2, 3).mean(axis=1)
    clamp_z_m = x[:2, 2].mean()
    return np.column_stack([x[1:, 0], clamp_z_m - x[1:, 2]])


def _buckled_strip(
    settings: SimulationSettings, friction: float, vertices: int, gamma: float
) -> tuple[ClothSolver, np.ndarray]:
    """The strip in its buckling mode at the strain it starts from, loads in balance."""
    # Two clamped rows straddle the clamp: a hinge there turns by a whole spacing's curvature.
    spacing_m = LENGTH_M / (vertices - 1.5)
    mesh = rectangle(vertices, 2, LENGTH_M + 0.5 * spacing_m, spacing_m)
    # Without weight as light as a strip of the largest gamma, so that inertia is nothing.
    weight_N_m2 = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
    rigidity_Nm = weight_N_m2 * LENGTH_M**3 / (gamma or LARGEST_GAMMA)
    root = np.sqrt(theory.strip_buckling_load())
    push_N = root**2 * rigidity_Nm * spacing_m / LENGTH_M**2
    centres = np.clip((np.arange(vertices - 1)) * spacing_m / LENGTH_M, 0.0, 1.0)
    mode = np.cos(root * centres) - 1 + root * np.sin(root * centres)
    turn = mode * np.sqrt(2 * START_STRAIN / np.mean(mode**2))
    sideways = np.concatenate([[0.0], np.cumsum(np.sin(turn))]) * spacing_m
    down = np.concatenate([[0.0], np.cumsum(np.cos(turn))]) * spacing_m
    start_m = np.zeros((mesh.vertex_count, 3))
    start_m[:, 0] = np.repeat(sideways, 2)
    start_m[:, 1] = mesh.rest_uv_m[:, 0]
    start_m[:, 2] = np.repeat(down[-1] - down, 2)
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 1] = True
    fixed[:4] = True
    solver = ClothSolver(
        mesh,
        cylindrical_strip_tables(12 * rigidity_Nm / THICKNESS_M**2, rigidity_Nm),
        start_m,
        friction=friction,
        fixed=fixed,
        settings=solver_settings(settings),
        conditions=Conditions(
            gravity_m_s2=(0.0, 0.0, -GRAVITY_M_S2 if gamma else 0.0), nodal_force_N=push_N / 2
        ),
    )
    solver.start()
    return solver, start_m
