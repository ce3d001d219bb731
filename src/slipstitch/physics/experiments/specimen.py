"""Common parts of the known-answer experiments: specimens, their supports and motion, demands."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothMesh, ClothSolver, Conditions, SolverSettings, rectangle
from slipstitch.physics.fabric import ElasticTables, isotropic_tables

AREAL_DENSITY_KG_M2 = 0.2
MEMBRANE_STIFFNESS_N_M = 200.0
DIAGONALS_OVER_EDGES = 1000.0
REST_M = 1.0e-7  # largest movement in a step that counts as rest
STEPS_MAX = 400  # until it rests
VERTICES_RANGE = (8, math.inf)  # along a strip

Motion = Callable[[float], np.ndarray]  # positions (V, 3) at a time, as for `ClothSolver.advance`


@dataclass(frozen=True)
class Demand:
    """The largest error of one measured value; words must be equal."""

    key: str  # of the result
    allowed: float = 0.0  # largest error, in the value's unit if not relative
    relative: bool = True  # to theory's value
    zero: float = 0.0  # what counts as 0 where theory says 0
    theory: float | None = None  # None: what the result has under ``theory_<key>``

    def expected(self, result: Mapping[str, Any]) -> Any:
        """Theory's value."""
        return result[f"theory_{self.key}"] if self.theory is None else self.theory

    def verdict(self, result: Mapping[str, Any]) -> dict[str, Any]:
        """The error (None where a value is no number), what is allowed, and whether it is met."""
        measured, expected = result[self.key], self.expected(result)
        if measured is None or expected is None or isinstance(expected, str):
            error = 0.0 if measured == expected else math.inf
        else:
            error = abs(measured - expected)
            if self.relative and error > self.zero:
                error = error / abs(expected) if expected else math.inf
        known = math.isfinite(error)
        return {
            "error": error if known else None,
            "allowed": self.allowed,
            "relative": self.relative,
            "met": known and error <= max(self.allowed, self.zero),
        }


def require(name: str, value: float, lowest: float, highest: float = math.inf) -> float:
    """Return a number as a float; BadInput if it is not finite, or out of bounds."""
    if not isinstance(value, int | float | np.number):
        raise BadInput(f"{name} must be a number, not {value!r}")
    if not (math.isfinite(value) and lowest <= value <= highest):
        upper = "" if math.isinf(highest) else f" and at most {highest:.4g}"
        raise BadInput(f"{name} must be at least {lowest:.4g}{upper}, not {value:g}")
    return float(value)


def clamped_strip(rows: int, length_m: float) -> tuple[ClothMesh, float]:
    """Return the mesh of a strip two vertices wide, and its spacing in m.

    Two rows straddle the clamp: a hinge there turns by a whole spacing's curvature.
    """
    spacing_m = length_m / (rows - 1.5)
    return rectangle(rows, 2, length_m + 0.5 * spacing_m, spacing_m), spacing_m


def held(mesh: ClothMesh, rows: int, cylindrical: bool = True) -> np.ndarray:
    """Coordinates that are prescribed, (V, 3): first rows, and of a cylinder the ones across."""
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 1] = cylindrical
    fixed[: rows * mesh.shape[1]] = True
    return fixed


def cylindrical_strip_tables(membrane_stiffness_N_m: float, rigidity_Nm: float) -> ElasticTables:
    """Tables of a strip that bends about the mesh lines across it and resists twist; square cells.

    Narrow alternating diagonals would bend by ke/4.95, not ke/4: edges tilt, but for stiff
    diagonals.
    """
    tables = isotropic_tables(AREAL_DENSITY_KG_M2, membrane_stiffness_N_m, 4 * rigidity_Nm)
    bending_N_m = tables.bending_N_m.copy()
    bending_N_m[1] *= DIAGONALS_OVER_EDGES
    return replace(tables, bending_N_m=bending_N_m)


def hanging_with_tail(mesh: ClothMesh, height_m: float) -> np.ndarray:
    """Positions (V, 3): straight down, a quarter of a circle, a flat tail, to start a drag from."""
    across, down_m = mesh.rest_uv_m.T
    radius_m = min(0.2 * height_m, (down_m[-1] - height_m) / (math.pi / 2 - 1) * 0.8)
    straight_m, arc_m = height_m - radius_m, radius_m * math.pi / 2
    angle = np.clip((down_m - straight_m) / radius_m, 0.0, math.pi / 2)
    ahead = -radius_m * (1 - np.cos(angle)) - np.maximum(down_m - straight_m - arc_m, 0.0)
    height = height_m - np.minimum(down_m, straight_m) - radius_m * np.sin(angle)
    return np.column_stack([ahead, across, height])


def started(
    settings: SimulationSettings | SolverSettings,
    mesh: ClothMesh,
    tables: ElasticTables,
    start_m: np.ndarray,
    fixed: np.ndarray,
    friction: Any = 0.0,
    conditions: Conditions | None = None,
    **changes: Any,
) -> ClothSolver:
    """Return a solver at the beginning of the motion, some settings changed, no self-contact."""
    own = replace(SolverSettings.of(settings), self_contact=False, **changes)
    solver = ClothSolver(
        mesh, tables, start_m, friction=friction, fixed=fixed, settings=own, conditions=conditions
    )
    solver.start()
    return solver


def carried(start_m: np.ndarray, *velocity_m_s: float) -> Motion:
    """Return positions carried from a start (V, 3) at a velocity."""
    return lambda time_s: start_m + np.multiply(velocity_m_s, time_s)


def advance_evenly(
    solver: ClothSolver, duration_s: float, step_s: float, prescribed: Motion | None = None
) -> None:
    """Step through a duration in steps of about a length."""
    steps = round(duration_s / step_s)
    for _ in range(steps):
        solver.advance(duration_s / steps, prescribed)


def bring_to_rest(solver: ClothSolver, step_s: float, prescribed: Motion | None = None) -> None:
    """Step until nothing moves, or NotConverged; steps of the slowest motion's period or longer."""
    for step in range(STEPS_MAX):
        before_m = solver.positions_m.copy()
        solver.advance(step_s, prescribed)
        if step and abs(solver.positions_m - before_m).max() < REST_M:
            return
    moved_m = abs(solver.positions_m - before_m).max()
    raise NotConverged(
        f"not at rest after {STEPS_MAX} steps of {step_s:g} s: moves by {moved_m:.1e} m"
    )
