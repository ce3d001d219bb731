"""Steady drag: a heavy strip hung by one end at a fixed height, its tail dragged over the floor.

At a constant and slow speed every part on the floor slips: the floor takes the load N and pulls
back with μ N. Weight per length is w, bending rigidity B (of the strip's whole width), and the
gravity length (B/w)^(1/3). Loads are given over w, as lengths.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import rectangle
from slipstitch.physics.experiments import specimen
from slipstitch.physics.experiments.specimen import Demand, require

DEMANDS = (Demand("pull_over_w_m", 0.02), Demand("flat_tail_m", 1e-3, relative=False))
LENGTH_M, HOLDER_M = 0.20, 0.15  # of the simulated strip, and height of its holder, a hinge
BOUNDS = {"gravity_length_m": (0.0, LENGTH_M)}


@dataclass(frozen=True)
class SteadyDrag:
    """Steady shape and loads of a dragged strip."""

    pull_over_w_m: float  # horizontal pull at the holder over the weight per length
    floor_load_over_w_m: float  # load on the floor over the weight per length
    flat_tail_m: float  # length that lies flat on the floor; 0 if only the end touches
    holder_ahead_of_tail_m: float  # horizontally, from the tail's end, in the direction of the drag
    regime: str  # what touches the floor: flat tail, end only, clear of the floor
    curve_m: np.ndarray  # (n, 2) from the tail's end to the holder: ahead of the end, height


def flexible_strip_drag(friction: float, length_m: float, height_m: float) -> SteadyDrag:
    """Steady drag of a strip without bending rigidity.

    A catenary that runs into the floor tangentially: with a tail of length c on the floor the
    tension there is μ w c, and (H + μ c)² = (μ c)² + (L − c)², hence c = L + μ H − √((L + μ H)² −
    L² + H²), pull = μ w c. With a holder's height H ≥ L the strip hangs clear of the floor.
    """
    friction = require("friction", friction, 0.0)
    length, height = require("length_m", length_m, 1e-9), require("height_m", height_m, 1e-9)
    if height >= length:
        plumb = np.array([[0.0, height - length], [0.0, height]])
        return SteadyDrag(0.0, 0.0, 0.0, 0.0, "clear of the floor", plumb)
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


@dataclass(frozen=True)
class _Elastica:
    """The hanging part as a boundary value problem, lengths in units of the gravity length.

    With s from the touchdown (or the end that touches), tension T = μ N in the drag direction and
    R the floor's point load at s = 0, moment balance is θ'' = T sin θ − (s − R) cos θ.
    """

    friction: float
    length: float
    height: float
    holder_angle: float | None

    def solve(self, station, guess, *unknowns):
        """Solve for load and length off the floor; for the load alone if the end alone touches."""
        tail_lies = len(unknowns) == 2

        def slope(x, state, unknowns):
            load, span = unknowns if tail_lies else (unknowns[0], self.length)
            tension = self.friction * (self.length - span + load)
            sine, cosine = np.sin(state[0]), np.cos(state[0])
            bending = tension * sine - (span * x - load) * cosine
            return span * np.vstack((state[1], bending, cosine, sine))

        def ends(start, end, _):
            at_the_floor = start if tail_lies else start[1:]
            held = end[1] if self.holder_angle is None else end[0] - self.holder_angle
            return np.array([*at_the_floor, end[3] - self.height, held])

        return solve_bvp(slope, ends, station, guess, p=unknowns, tol=1e-7, max_nodes=20000)


def _flexible_guess(friction: float, length: float, height: float):
    """Shape of the flexible strip, its corner at the touchdown rounded over the gravity length."""
    flexible = flexible_strip_drag(friction, length, height)
    tail = flexible.flat_tail_m
    span = length - tail
    tension = max(flexible.pull_over_w_m, 1e-3 * length)
    station = np.linspace(0.0, 1.0, 401)
    arc = station * span
    angle = np.arctan2(arc, tension) * -np.expm1(-arc)
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
    """Steady drag of a strip of a gravity length (B/w)^(1/3), up to the strip's own.

    Above the touchdown the strip is a heavy elastica, B θ'' = T sin θ − (w s − R) cos θ, with θ
    from the horizontal and s from the touchdown. There θ = θ' = 0 (no adhesion), and the floor
    gives a point load R, because the flat tail carries no shear; tension T = μ (w c + R). The
    holder clamps the strip at an angle above the horizontal, or is a hinge (None; θ' = 0), as a
    single row of pinned vertices is. If no tail lies flat, the end alone touches: θ' = 0 there, θ ≥
    0 free, T = μ R. Solved by collocation, continued from the flexible strip.
    """
    flexible = flexible_strip_drag(friction, length_m, height_m)
    unit = require("gravity_length_m", gravity_length_m, 0.0, length_m)
    if holder_angle_rad is not None:
        require("holder_angle_rad", holder_angle_rad, 0.0, math.pi)
        if height_m >= length_m:
            raise BadInput("height_m must be below length_m where the holder clamps the strip")
    if height_m >= length_m or unit < 1e-3 * length_m:
        # Boundary layers thinner than a thousandth of the strip change nothing that is reported.
        return flexible

    length, height = length_m / unit, height_m / unit
    problem = _Elastica(friction, length, height, holder_angle_rad)
    station, guess, tail, span = _flexible_guess(friction, length, height)
    solution = problem.solve(station, guess, 0.1, span)
    if solution.success and 0.0 <= solution.p[1] <= length and solution.p[0] >= 0.0:
        load, span = solution.p
        return _result(problem, solution, float(load), float(span), "flat tail", unit)

    # The end alone touches: start from the flat-tail shape stretched over the whole strip.
    for start in (tail, 0.5 * tail, 0.25 * tail, 0.1 * tail):
        solution = problem.solve(station, guess, start)
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
    loads_m = problem.friction * floor_load * unit, floor_load * unit
    return SteadyDrag(*loads_m, tail * unit, float(curve[-1, 0]) * unit, regime, curve * unit)


def strip_drag(
    settings: SimulationSettings, friction: float, gravity_length_m: float = 0.02
) -> dict[str, Any]:
    """Drag a strip hinged at a holder above the floor until its shape is steady.

    It has as many vertices as a side of the cloth; the gravity length is (B/w)^(1/3) per area.
    """
    rows = settings.vertices_per_side
    spacing_m = LENGTH_M / (rows - 1)
    mesh = rectangle(rows, 3, LENGTH_M, 2 * spacing_m)
    weight_N_m2 = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
    start_m = specimen.hanging_with_tail(mesh, HOLDER_M)
    stiffness = specimen.MEMBRANE_STIFFNESS_N_M, weight_N_m2 * gravity_length_m**3
    tables = specimen.cylindrical_strip_tables(*stiffness)
    hinge = specimen.held(mesh, 1)
    solver = specimen.started(settings, mesh, tables, start_m, hinge, friction)
    # Far enough for the longest tail to be drawn out, slow enough for inertia to be nothing.
    drag = specimen.carried(start_m, 0.02, 0.0, 0.0)
    specimen.advance_evenly(solver, 20.0, settings.time_step_s, drag)
    width_m = 2 * spacing_m
    w_N_m = weight_N_m2 * width_m
    normal_N = solver.floor_forces()[:, 2].reshape(rows, 3).sum(axis=1)
    along = solver.positions_m[:, 0].reshape(rows, 3).mean(axis=1)
    touching = np.flatnonzero(normal_N > 0)
    expected = steady_strip_drag(
        friction, LENGTH_M, HOLDER_M, gravity_length_m, holder_angle_rad=None
    )
    measured = {
        "pull_over_w_m": float(solver.reactions()[:, 0].sum() / w_N_m),
        "floor_load_over_w_m": float(normal_N.sum() / w_N_m),
        "flat_tail_m": float(spacing_m * (rows - 1 - touching[0])) if len(touching) else 0.0,
        "holder_ahead_of_tail_m": float(along[0] - along[-1]),
    }
    return measured | {f"theory_{key}": getattr(expected, key) for key in measured}
