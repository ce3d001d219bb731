"""The experiments: inclined plane, flat drag, steady drag of a hanging strip.

Each runs on the cloth's own solver, with the numerical settings of a simulation, and returns
what was measured and what theory says (SI units; keys as ``slipstitch protocol`` writes them).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import cos, isfinite, pi, radians, sin, tan
from typing import Any

import numpy as np

from slipstitch import theory
from slipstitch.cloth import ClothSolver, SolverSettings, rectangle
from slipstitch.cloth.solver import GRAVITY_M_S2
from slipstitch.errors import BadInput
from slipstitch.material import isotropic_tables
from slipstitch.simulate.settings import SimulationSettings

AREAL_DENSITY_KG_M2 = 0.2
MEMBRANE_STIFFNESS_N_M = 200.0
HINGE_STIFFNESS_N_M = 5.0e-5
CREEP_MAX_M = 1.0e-6  # elastic microslip stays below; more than this in a second is sliding


def incline(settings: SimulationSettings, friction: float, slope_deg: float) -> dict[str, Any]:
    """A square of cloth on a plane tilted slowly to a slope, for one second from there.

    Sticks for tan(slope) < friction, else slides with g (sin - friction cos).

    Returns
    -------
    dict
        ``sticks``, ``creep_m`` (distance moved in 1 s), ``acceleration_m_s2`` (final speed over
        time), ``theory_acceleration_m_s2``.
    """
    slope = radians(slope_deg)
    # Near the threshold the net force is a small part of the friction: resolve that part.
    margin = min(1.0, abs(tan(slope) - friction) / max(friction, 1e-3))
    tolerance = settings.friction_tolerance * max(margin, 1e-6)
    mesh = rectangle(5, 5, 0.02, 0.02)
    flat_m = np.column_stack([mesh.rest_uv_m, np.zeros(mesh.vertex_count)])
    solver = ClothSolver(
        mesh,
        isotropic_tables(AREAL_DENSITY_KG_M2, MEMBRANE_STIFFNESS_N_M, HINGE_STIFFNESS_N_M),
        flat_m,
        friction=friction,
        fixed=np.zeros((mesh.vertex_count, 3), bool),
        settings=replace(SolverSettings.of(settings), friction_tolerance=tolerance),
        gravity_m_s2=(GRAVITY_M_S2 * sin(slope), 0.0, -GRAVITY_M_S2 * cos(slope)),
    )
    # Resting on the floor, not dropped on it.
    solver.positions_m[:, 2] = (
        -solver.mass_kg * GRAVITY_M_S2 * cos(slope) / solver.normal_stiffness_N_m
    )
    weight_N = solver.mass_kg * GRAVITY_M_S2
    borne_N = weight_N * min(sin(slope), friction * cos(slope))
    solver.start(preload_N=np.column_stack([borne_N, 0 * borne_N]))
    steps = round(1.0 / settings.time_step_s)
    for _ in range(steps):
        solver.advance(1.0 / steps)
    moved = solver.positions_m - flat_m
    creep_m = float(np.linalg.norm(moved[:, :2].mean(axis=0)))
    expected = theory.incline(friction, slope)
    return {
        "sticks": creep_m < CREEP_MAX_M,
        "creep_m": creep_m,
        "acceleration_m_s2": float(solver.velocities_m_s[:, 0].mean() / solver.time_s),
        "theory_acceleration_m_s2": expected.acceleration_m_s2,
    }


def flat_drag(settings: SimulationSettings, friction: float) -> dict[str, Any]:
    """A square of cloth lying flat, pulled along the floor by its leading edge.

    Returns
    -------
    dict
        ``pull_over_weight`` and ``theory_pull_over_weight``.
    """
    mesh = rectangle(11, 11, 0.1, 0.1)
    flat_m = np.column_stack(
        [0.1 - mesh.rest_uv_m[:, 1], mesh.rest_uv_m[:, 0], 0 * mesh.rest_uv_m[:, 0]]
    )
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[mesh.rest_uv_m[:, 1] == 0, 0] = True
    solver = ClothSolver(
        mesh,
        isotropic_tables(AREAL_DENSITY_KG_M2, MEMBRANE_STIFFNESS_N_M, HINGE_STIFFNESS_N_M),
        flat_m,
        friction=friction,
        fixed=fixed,
        settings=SolverSettings.of(settings),
    )
    solver.positions_m[:, 2] = -solver.mass_kg * GRAVITY_M_S2 / solver.normal_stiffness_N_m
    solver.start()
    speed_m_s, duration_s = 0.01, 2.0
    steps = round(duration_s / settings.time_step_s)

    def pulled(time_s: float) -> np.ndarray:
        return flat_m + np.array([speed_m_s * time_s, 0.0, 0.0])

    for _ in range(steps):
        solver.advance(duration_s / steps, pulled)
    weight_N = solver.mass_kg.sum() * GRAVITY_M_S2
    return {
        "pull_over_weight": float(solver.reactions()[:, 0].sum() / weight_N),
        "theory_pull_over_weight": float(theory.flat_drag(friction)),
    }


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
    ahead, height = _hanging_with_tail(down, length_m, height_m)
    start_m = np.column_stack([ahead, mesh.rest_uv_m[:, 0], height])
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[:, 1] = True
    fixed[down == 0] = True
    solver = ClothSolver(
        mesh,
        isotropic_tables(
            AREAL_DENSITY_KG_M2, MEMBRANE_STIFFNESS_N_M, 4 * weight_N_m2 * gravity_length_m**3
        ),
        start_m,
        friction=friction,
        fixed=fixed,
        settings=SolverSettings.of(settings),
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
    expected = theory.steady_strip_drag(
        friction, length_m, height_m, gravity_length_m, holder_angle_rad=None
    )
    measured = {
        "pull_over_w_m": float(solver.reactions()[:, 0].sum() / w_N_m),
        "floor_load_over_w_m": float(normal_N.sum() / w_N_m),
        "flat_tail_m": float(spacing_m * (rows - 1 - touching[0])) if len(touching) else 0.0,
        "holder_ahead_of_tail_m": float(along[0] - along[-1]),
    }
    return measured | {f"theory_{key}": getattr(expected, key) for key in measured}


def _hanging_with_tail(down_m: np.ndarray, length_m: float, height_m: float):
    """Straight down, a quarter of a circle, a flat tail: where to start the drag from."""
    radius_m = min(0.2 * height_m, (length_m - height_m) / (pi / 2 - 1) * 0.8)
    straight_m, arc_m = height_m - radius_m, radius_m * pi / 2
    angle = np.clip((down_m - straight_m) / radius_m, 0.0, pi / 2)
    ahead = -radius_m * (1 - np.cos(angle)) - np.maximum(down_m - straight_m - arc_m, 0.0)
    height = height_m - np.minimum(down_m, straight_m) - radius_m * np.sin(angle)
    return ahead, height


@dataclass(frozen=True)
class Protocol:
    """An experiment and its options: name to (type, default, meaning); default None: required."""

    run: Callable[..., dict[str, Any]]
    options: Mapping[str, tuple[float | None, str]]


_FRICTION = (None, "friction coefficient")
PROTOCOLS: dict[str, Protocol] = {
    "incline": Protocol(incline, {"friction": _FRICTION, "slope_deg": (None, "slope in degrees")}),
    "flat-drag": Protocol(flat_drag, {"friction": _FRICTION}),
    "strip-drag": Protocol(
        strip_drag,
        {
            "friction": _FRICTION,
            "gravity_length_m": (0.02, "(B/w)^(1/3): bending rigidity over weight per area, in m"),
        },
    ),
}


def run_protocol(
    name: str, options: Mapping[str, float], settings: SimulationSettings | None = None
) -> dict[str, Any]:
    """Run one experiment.

    Parameters
    ----------
    name : str
        A key of ``PROTOCOLS``.
    options : mapping
        Its options, by name.
    settings : SimulationSettings, optional
        Numerical settings (time step, tolerance, damping ...).

    Raises
    ------
    BadInput
        Unknown experiment or option, a missing one, or a value out of range.
    NotConverged
        The solver did not converge.
    """
    if name not in PROTOCOLS:
        raise BadInput(f"unknown protocol {name!r}; allowed: {', '.join(PROTOCOLS)}")
    protocol = PROTOCOLS[name]
    unknown = set(options) - set(protocol.options)
    if unknown:
        raise BadInput(
            f"protocol {name}: unknown option {min(unknown)!r}; "
            f"allowed: {', '.join(protocol.options)}"
        )
    values = {}
    for option, (default, _) in protocol.options.items():
        value = options.get(option, default)
        if value is None:
            raise BadInput(f"protocol {name}: {option} is missing")
        if not isfinite(value) or value < 0:
            raise BadInput(f"protocol {name}: {option} {value}: must be finite and at least 0")
        values[option] = float(value)
    return protocol.run(settings or SimulationSettings(), **values)
