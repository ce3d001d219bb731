"""Steady drag: a heavy strip hung by one end at a fixed height, its tail dragged over the floor.

At a constant and slow speed every part on the floor slips: the floor takes the load N and pulls
back with μ N. Weight per length is w, bending rigidity B (of the strip's whole width), and the
gravity length (B/w)^(1/3). Loads are given over w, as lengths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, rectangle
from slipstitch.physics.experiments.specimen import (
    AREAL_DENSITY_KG_M2,
    MEMBRANE_STIFFNESS_N_M,
    Demand,
    cylindrical_strip_tables,
    hanging_with_tail,
    held,
    require,
    solver_settings,
)

DEMANDS = (Demand("pull_over_w_m", 0.02), Demand("flat_tail_m", 1e-3, relative=False))
SHORTEST_M = 1e-9


@dataclass(frozen=True)
class SteadyDrag:
    """Steady shape and loads of a dragged strip.

    Attributes
    ----------
    pull_over_w_m : float
        Horizontal pull at the holder over the weight per length (m).
    floor_load_over_w_m : float
        Load on the floor over the weight per length (m).
    flat_tail_m : float
        Length of the tail that lies flat on the floor (m); 0 if only the end touches.
    holder_ahead_of_tail_m : float
        Horizontal distance from the tail's end to the holder, positive in the direction of the
        drag (m).
    regime : {"flat tail", "end only", "clear of the floor"}
        What touches the floor.
    curve_m : ndarray, shape (n, 2)
        Points from the tail's end to the holder: distance ahead of the tail's end, height (m).
    """

    pull_over_w_m: float
    floor_load_over_w_m: float
    flat_tail_m: float
    holder_ahead_of_tail_m: float
    regime: str
    curve_m: np.ndarray


def _checked(friction: float, length_m: float, height_m: float) -> tuple[float, float, float]:
    return (
        require("friction", friction, 0.0),
        require("length_m", length_m, SHORTEST_M),
        require("height_m", height_m, SHORTEST_M),
    )


def _plumb(length: float, height: float) -> SteadyDrag:
    curve = np.array([[0.0, height - length], [0.0, height]])
    return SteadyDrag(0.0, 0.0, 0.0, 0.0, "clear of the floor", curve)


def flexible_strip_drag(friction: float, length_m: float, height_m: float) -> SteadyDrag:
    """Steady drag of a strip without bending rigidity.

    A catenary that runs into the floor tangentially: with a tail of length c on the floor the
    tension there is μ w c, and (H + μ c)² = (μ c)² + (L − c)², hence

        c = L + μ H − √((L + μ H)² − L² + H²),    pull = μ w c.

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0 between strip and floor.
    length_m : float
        Length L of the strip (m).
    height_m : float
        Height H of the holder above the floor (m). With H ≥ L the strip hangs clear of the floor.

    Returns
    -------
    SteadyDrag
        Loads, tail and shape (m).
    """
    friction, length, height = _checked(friction, length_m, height_m)
    if height >= length:
        return _plumb(length, height)
    reach = length + friction * height
    # The smaller root written without cancellation.
    tail = (length**2 - height**2) / (reach + math.sqrt(reach**2 - length**2 + height**2))
    scale = friction * tail
    arc = np.linspace(0.0, length - tail, 201)
    if scale > 0.0:
        ahead = tail + scale * np.arcsinh(arc / scale)
        up = arc**2 / (scale + np.hypot(scale, arc))
    else:
        ahead, up = np.full_like(arc, tail), arc
    curve = np.vstack(([0.0, 0.0], np.column_stack((ahead, up))))
    return SteadyDrag(scale, tail, tail, float(ahead[-1]), "flat tail", curve)


class _Elastica:
    """The hanging part as a boundary value problem, lengths in units of the gravity length.

    With s from the touchdown (or the end that touches), tension T = μ N in the drag direction and
    R the point load of the floor at s = 0, moment balance is θ'' = T sin θ − (s − R) cos θ.
    """

    def __init__(self, friction: float, length: float, height: float, holder_angle: float | None):
        self.friction = friction
        self.length = length
        self.height = height
        self.holder_angle = holder_angle

    def _slope(self, tension, load, span, station, state):
        angle, curvature = state[0], state[1]
        sine, cosine = np.sin(angle), np.cos(angle)
        bending = tension * sine - (span * station - load) * cosine
        return span * np.vstack((curvature, bending, cosine, sine))

    def _at_the_holder(self, end) -> float:
        return end[1] if self.holder_angle is None else end[0] - self.holder_angle

    def flat_tail(self, station, guess, load, span):
        """Unknown: the point load at the touchdown and the length off the floor."""

        def slope(x, state, unknowns):
            load, span = unknowns
            tension = self.friction * (self.length - span + load)
            return self._slope(tension, load, span, x, state)

        def ends(start, end, unknowns):
            return np.array([*start, end[3] - self.height, self._at_the_holder(end)])

        return _solve(slope, ends, station, guess, (load, span))

    def end_only(self, station, guess, load):
        """Unknown: the load on the end that touches; its angle is free."""

        def slope(x, state, unknowns):
            load = unknowns[0]
            return self._slope(self.friction * load, load, self.length, x, state)

        def ends(start, end, unknowns):
            return np.array([*start[1:], end[3] - self.height, self._at_the_holder(end)])

        return _solve(slope, ends, station, guess, (load,))


def _solve(slope, ends, station, guess, unknowns):
    return solve_bvp(slope, ends, station, guess, p=unknowns, tol=1e-7, max_nodes=20000)


def _flexible_guess(friction: float, length: float, height: float, bending_length: float):
    """Shape of the flexible strip, its corner at the touchdown rounded over the bending length."""
    flexible = flexible_strip_drag(friction, length, height)
    tail = flexible.flat_tail_m
    span = length - tail
    tension = max(flexible.pull_over_w_m, 1e-3 * length)
    station = np.linspace(0.0, 1.0, 401)
    arc = station * span
    angle = np.arctan2(arc, tension) * -np.expm1(-arc / bending_length)
    curvature = np.gradient(angle, arc)
    ahead = np.concatenate(([0.0], np.cumsum(np.diff(arc) * np.cos(angle[1:]))))
    up = np.concatenate(([0.0], np.cumsum(np.diff(arc) * np.sin(angle[1:]))))
    up *= height / up[-1]
    return station, np.vstack((angle, curvature, ahead, up)), tail, span


@lru_cache(maxsize=256)
def steady_strip_drag(
    friction: float,
    length_m: float,
    height_m: float,
    gravity_length_m: float,
    *,
    holder_angle_rad: float | None = math.pi / 2,
) -> SteadyDrag:
    """Steady drag of a strip with bending rigidity.

    Above the touchdown the strip is a heavy elastica, B θ'' = T sin θ − (w s − R) cos θ, with θ
    from the horizontal and s from the touchdown. At the touchdown θ = θ' = 0 (no adhesion), and
    the floor gives a point load R, because the flat tail carries no shear. Tension there is
    T = μ (w c + R). The holder is hinged (θ' = 0) or clamps the strip at a given angle. If no
    tail lies flat, the end alone touches: θ' = 0 there, θ ≥ 0 free, T = μ R. Solved as a boundary
    value problem by collocation (SciPy's ``solve_bvp``), continued from the flexible strip.

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0 between strip and floor.
    length_m : float
        Length L of the strip (m).
    height_m : float
        Height H of the holder above the floor (m).
    gravity_length_m : float
        (B/w)^(1/3) (m): 0 for a flexible strip, at most L.
    holder_angle_rad : float or None
        Angle above the horizontal at which the holder clamps the strip (rad). π/2, the default,
        for a strip that leaves its clamp straight down; None for a hinge, as a single row of
        pinned vertices is. At a gravity length of 2 cm the hinge holds the end 1 mm further
        ahead; the pull hardly differs.

    Returns
    -------
    SteadyDrag
        Loads, tail and shape (m).
    """
    friction, length_m, height_m = _checked(friction, length_m, height_m)
    unit = require("gravity_length_m", gravity_length_m, 0.0, length_m)
    if holder_angle_rad is not None:
        require("holder_angle_rad", holder_angle_rad, 0.0, math.pi)
    if height_m >= length_m:
        if holder_angle_rad is not None:
            raise BadInput("height_m must be below length_m where the holder clamps the strip")
        return _plumb(length_m, height_m)
    if unit < 1e-3 * length_m:
        # Boundary layers thinner than a thousandth of the strip change nothing that is reported.
        return flexible_strip_drag(friction, length_m, height_m)

    length, height = length_m / unit, height_m / unit
    problem = _Elastica(friction, length, height, holder_angle_rad)
    station, guess, tail, span = _flexible_guess(friction, length, height, 1.0)
    solution = problem.flat_tail(station, guess, 0.1, span)
    if solution.success and 0.0 <= solution.p[1] <= length and solution.p[0] >= 0.0:
        load, span = solution.p
        return _result(problem, solution, float(load), float(span), "flat tail", unit)

    # The end alone touches: start from the flat-tail shape stretched over the whole strip.
    for start in (tail, 0.5 * tail, 0.25 * tail, 0.1 * tail):
        solution = problem.end_only(station, guess, start)
        if solution.success and solution.p[0] >= 0.0 and solution.sol(0.0)[0] >= 0.0:
            return _result(problem, solution, float(solution.p[0]), length, "end only", unit)
    raise NotConverged(
        f"steady drag: no equilibrium at friction {friction:g}, length {length_m:g} m, "
        f"height {height_m:g} m, gravity length {unit:g} m"
    )


def _result(
    problem: _Elastica, solution, load: float, span: float, regime: str, unit: float
) -> SteadyDrag:
    tail = problem.length - span
    floor_load = tail + load
    _, _, ahead, up = solution.sol(np.linspace(0.0, 1.0, 401))
    curve = np.column_stack((tail + ahead, up))
    if tail > 0.0:
        curve = np.vstack(([0.0, 0.0], curve))
    return SteadyDrag(
        pull_over_w_m=problem.friction * floor_load * unit,
        floor_load_over_w_m=floor_load * unit,
        flat_tail_m=tail * unit,
        holder_ahead_of_tail_m=float(curve[-1, 0]) * unit,
        regime=regime,
        curve_m=curve * unit,
    )


def strip_drag(
    settings: SimulationSettings,
    friction: float,
    gravity_length_m: float = 0.02,
    length_m: float = 0.20,
    height_m: float = 0.15,
) -> dict[str, Any]:
    """A strip hinged at a holder above the floor, dragged until its shape is steady.

    Kept cylindrical, so that the plate rigidity is a quarter of the hinges' stiffness. As many
    vertices along it as along a side of the simulated cloth.

    Parameters
    ----------
    gravity_length_m : float
        (B/w)^(1/3), bending rigidity over weight per area.

    Returns
    -------
    dict
        ``pull_over_w_m``, ``floor_load_over_w_m``, ``flat_tail_m``,
        ``holder_ahead_of_tail_m``, each also as ``theory_...``; w is the weight per length.
    """
    rows = settings.vertices_per_side
    spacing_m = length_m / (rows - 1)
    mesh = rectangle(rows, 3, length_m, 2 * spacing_m)
    weight_N_m2 = AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
    down = mesh.rest_uv_m[:, 1]
    ahead, height = hanging_with_tail(down, length_m, height_m)
    start_m = np.column_stack([ahead, mesh.rest_uv_m[:, 0], height])
    solver = ClothSolver(
        mesh,
        cylindrical_strip_tables(MEMBRANE_STIFFNESS_N_M, weight_N_m2 * gravity_length_m**3),
        start_m,
        friction=friction,
        fixed=held(mesh, 1),
        settings=solver_settings(settings),
    )
    solver.start()
    # Far enough for the longest tail to be drawn out, slow enough for inertia to be nothing.
    speed_m_s, duration_s = 0.02, 20.0
    steps = round(duration_s / settings.time_step_s)

    def pulled(time_s: float) -> np.ndarray:
        return start_m + np.array([speed_m_s * time_s, 0.0, 0.0])

    for _ in range(steps):
        solver.advance(duration_s / steps, pulled)
    width_m = 2 * spacing_m
    w_N_m = weight_N_m2 * width_m
    normal_N = solver.floor_forces()[:, 2].reshape(rows, 3).sum(axis=1)
    along = solver.positions_m[:, 0].reshape(rows, 3).mean(axis=1)
    touching = np.flatnonzero(normal_N > 0)
    expected = steady_strip_drag(
        friction, length_m, height_m, gravity_length_m, holder_angle_rad=None
    )
    measured = {
        "pull_over_w_m": float(solver.reactions()[:, 0].sum() / w_N_m),
        "floor_load_over_w_m": float(normal_N.sum() / w_N_m),
        "flat_tail_m": float(spacing_m * (rows - 1 - touching[0])) if len(touching) else 0.0,
        "holder_ahead_of_tail_m": float(along[0] - along[-1]),
    }
    return measured | {f"theory_{key}": getattr(expected, key) for key in measured}
