"""Drop-and-drag of a planar cloth in the cloth simulator, tracked as a camera would.

A strip as long as the cloth is hinged to a holder at a height, its tail on the floor; then the
holder moves: the planar protocol (d) of docs/criticise-your-data.md, kept cylindrical.
"""

from dataclasses import dataclass, replace
from math import ceil, pi, sin, sqrt, tan

import numpy as np

from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, Conditions, SolverSettings, rectangle
from slipstitch.physics.experiments import specimen
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.friction_law.mechanisms import REFERENCE_HUMIDITY_PCT

MEMBRANE_STIFFNESS_N_M = 2000.0  # stretches the cloth by less than 0.01 mm
PENETRATION_M = 2.0e-8
ACCELERATION_M_S2 = 0.010
# A mesh bends at its last touching vertex already: the touchdown lies this part of a cell further
# in than its lifted vertices say (from meshes of 81 to 241 vertices, to 0.1).
LATE_LIFT_CELLS = 0.2
RELAXING_STEP_S, RELAXING_STEPS = 0.1, 150  # long steps: implicit Euler damps the swing
LIFT_RANGE_M = (2.0e-5, 6.0e-3)  # heights from which the touchdown is extrapolated


@dataclass(frozen=True)
class Sheet:
    """The cloth as it really is: areal density (kg/m2), bending rigidity (N m), length (m)."""

    areal_density_kg_m2: float
    bending_Nm: float
    length_m: float


@dataclass(frozen=True)
class DragRun:
    """One run: height of the holder, speed, and what a friction law may ask for.

    ``orientation_rad`` is from the warp to the direction of sliding.
    """

    height_m: float
    speed_m_s: float
    stroke_m: float
    orientation_rad: float = 0.0
    dwell_s: float = 0.0
    repeats: float = 0.0
    relative_humidity_pct: float = REFERENCE_HUMIDITY_PCT
    tilt_downhill_rad: float = 0.0  # of the floor along the motion


@dataclass(frozen=True)
class TrackedShape:
    """Advance of the trailing edge, and length on the floor, frame by frame (metres, seconds)."""

    time_s: np.ndarray
    stage_m: np.ndarray
    edge_m: np.ndarray
    contact_m: np.ndarray


def drag_tracked(
    law: FrictionLaw,
    sheet: Sheet,
    run: DragRun,
    rows: int = 161,
    step_s: float = 0.04,
    frame_rate_hz: float = 2.4,
) -> TrackedShape:
    """Simulate the forward stroke of one run, with a number of vertices along the cloth."""
    solver, start_m = _laid_down(law, sheet, run, rows)
    ramp_s = run.speed_m_s / ACCELERATION_M_S2

    def stage_m(time_s: float) -> float:
        if time_s < ramp_s:
            return 0.5 * ACCELERATION_M_S2 * time_s**2
        return run.speed_m_s * (time_s - ramp_s / 2)

    def holder(time_s: float) -> np.ndarray:
        return start_m + np.array([stage_m(time_s), 0.0, 0.0])

    frames = int((run.stroke_m / run.speed_m_s + ramp_s / 2) * frame_rate_hz)
    steps = ceil(1.0 / frame_rate_hz / step_s - 1e-9)
    seen = [_seen(solver)]
    for _ in range(frames):
        for _ in range(steps):
            solver.advance(1.0 / frame_rate_hz / steps, holder)
        seen.append(_seen(solver))
    time_s = np.arange(frames + 1) / frame_rate_hz
    edge, contact = np.array(seen).T
    stage = np.array([stage_m(moment_s) for moment_s in time_s])
    return TrackedShape(time_s, stage, edge - edge[0], contact)


def _laid_down(
    law: FrictionLaw, sheet: Sheet, run: DragRun, rows: int
) -> tuple[ClothSolver, np.ndarray]:
    """The cloth hung up, its tail on the floor without tension, and rested; where it lies."""
    settings = SolverSettings(penetration_m=PENETRATION_M)
    width_m = 2 * sheet.length_m / (rows - 1)
    mesh = rectangle(rows, 3, sheet.length_m, width_m)
    tables = replace(
        specimen.cylindrical_strip_tables(MEMBRANE_STIFFNESS_N_M, sheet.bending_Nm),
        areal_density_kg_m2=sheet.areal_density_kg_m2,
    )
    fixed = specimen.held(mesh, 1)
    along = sin(run.tilt_downhill_rad)
    # Without friction, on level ground: the tail comes to lie without tension.
    hung_m = specimen.hanging_with_tail(mesh, run.height_m)
    level = specimen.started(settings, mesh, tables, hung_m, fixed)
    for _ in range(RELAXING_STEPS):
        level.advance(RELAXING_STEP_S)
    start_m = level.positions_m
    # On a slope the cloth hangs plumb all the same: lean it, holder and all, before it is dragged.
    start_m[:, 0] -= tan(run.tilt_downhill_rad) * np.maximum(start_m[:, 2], 0.0)
    conditions = Conditions(
        gravity_m_s2=(GRAVITY_M_S2 * along, 0.0, -GRAVITY_M_S2 * sqrt(1 - along**2)),
        # The first stroke slides along -v, which is at -pi/2 from u.
        warp_angle_rad=-pi / 2 - run.orientation_rad,
        relative_humidity_pct=run.relative_humidity_pct,
        repeats=run.repeats,
    )
    solver = specimen.started(settings, mesh, tables, start_m, fixed, law, conditions)
    solver.floor.rest(run.dwell_s)
    return solver, start_m


def _seen(solver: ClothSolver) -> tuple[float, float]:
    """Place of the trailing edge, and length from it to the touchdown (between vertices)."""
    x, _, z = solver.positions_m.reshape(-1, 3, 3).mean(axis=1).T
    s = solver.mesh.rest_uv_m[::3, 1]
    length = s[-1]
    rising = np.flatnonzero(z > LIFT_RANGE_M[0])
    if not len(rising):
        return x[-1], length
    last = rising[-1]  # the lowest of the lifted vertices
    near = np.arange(max(last - 7, 0), last + 1)
    near = near[z[near] < LIFT_RANGE_M[1]]
    if len(near) < 3:
        return x[-1], length - s[last]
    # Near the touchdown the height grows as the cube of the length: its cube root is smooth.
    curve = np.polyfit(np.cbrt(z[near]), s[near], 3 if len(near) > 4 else 2)
    return x[-1], float(length - curve[-1] - LATE_LIFT_CELLS * (s[1] - s[0]))
