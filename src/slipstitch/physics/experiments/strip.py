"""Strip pushed on the floor: clamped vertically on top, its foot held by friction until it slips.

Sano, Yamaguchi & Wada, Phys. Rev. Lett. 118, 178001 (2017). Kept cylindrical: a discrete elastica
of rigidity ke/4. The push starts from the buckled strip: pushed straight, a perfect strip would
store its load and then be thrown into its buckle, foot and all.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from slipstitch.base.errors import NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothSolver, Conditions
from slipstitch.physics.experiments import specimen

LENGTH_M = 0.20
THICKNESS_M = 1.0e-3
SPEED_M_S = 0.010  # the stage's
START_STRAIN = 1.0e-4
LARGEST_STRAIN = 0.345  # past 0.3303, where the foot lies flat
LARGEST_GAMMA = 0.3  # above, the weight shifts the friction at slip by more than 0.5 %
SLIP_M = 1.0e-5  # the foot's elastic microslip stays below
BOUNDS = {
    "vertices": specimen.VERTICES_RANGE,
    "gamma": (0.0, LARGEST_GAMMA),
    "strain": (START_STRAIN, 0.5),
}
DEMANDS = (specimen.Demand("regime"), specimen.Demand("slip_strain", 0.006, relative=False))
FLAT_FOOT_RAD = math.pi / 2


@dataclass(frozen=True)
class StripState:
    """One equilibrium of the pushed strip, in units of its length and rigidity."""

    strain: float  # ε, the clamp's descent over the strip's length
    foot_angle_rad: float  # between the foot's tangent and the vertical; π/2 where it lies flat
    vertical_load: float  # P L²/B, the push on the floor
    horizontal_load: float  # |Q| L²/B, the friction that holds the foot
    curve: np.ndarray  # (n, 2): sideways and downwards from the clamp to the foot, over the length

    @property
    def load_ratio(self) -> float:
        """|Q|/P: the friction coefficient at which this state slips."""
        return self.horizontal_load / self.vertical_load


def strip_buckling_load() -> float:
    """Push P L²/B at which a clamped-hinged strip buckles: √P = tan √P (Euler 1744), 20.19."""
    return brentq(lambda x: math.sin(x) - x * math.cos(x), 4.0, 4.7, xtol=1e-14) ** 2


def _integrate(curvature: float, vertical: float, horizontal: float, stations=None):
    def slope(_, state):
        angle = state[0]
        sine, cosine = math.sin(angle), math.cos(angle)
        return (state[1], -(vertical * sine + horizontal * cosine), sine, cosine)

    start = (0.0, curvature, 0.0, 0.0)
    return solve_ivp(slope, (0.0, 1.0), start, "DOP853", stations, rtol=1e-11, atol=1e-13)


def _solve(foot_angle: float, guess) -> np.ndarray:
    """Clamp curvature, P and Q at a given foot angle, from a guess nearby."""

    def residual(unknowns):
        angle, curvature, sideways, _ = _integrate(*unknowns).y[:, -1]
        # Divided by the amplitude, so that the straight strip is no spurious solution.
        return np.array([angle + foot_angle, curvature, sideways]) / foot_angle

    scale = np.array([foot_angle, 1.0, foot_angle])
    solution = root(lambda x: residual(x * scale), guess / scale, tol=1e-11)
    if np.abs(solution.fun).max() > 1e-8:
        raise NotConverged(f"strip elastica: no equilibrium at foot angle {foot_angle:.4f} rad")
    return solution.x * scale


@lru_cache(maxsize=1)
def _branch() -> tuple[np.ndarray, np.ndarray]:
    """Follow the buckled branch from the straight strip to the flat foot."""
    load = strip_buckling_load()
    wave = math.sqrt(load)
    # Linear mode: θ = A (cos x − 1) + C sin x with x = √P s, foot angle 1.
    cosine, sine = math.cos(wave), math.sin(wave)
    system = np.array([[cosine - 1.0, sine], [-sine, cosine]])
    a, c = np.linalg.solve(system, (-1.0, 0.0))
    mode = np.array([c * wave, 0.0, a * load])
    angles = np.linspace(0.02, FLAT_FOOT_RAD, 40)
    states: list[np.ndarray] = []
    for index, angle in enumerate(angles):
        if index == 0:
            guess = mode * angle + (0.0, load, 0.0)
        elif index == 1:
            guess = states[0] * (angle / angles[0], 1.0, angle / angles[0])
        else:
            guess = 2.0 * states[-1] - states[-2]
        states.append(_solve(angle, guess))
    return angles, np.array(states)


@lru_cache(maxsize=256)
def strip_state_at_foot_angle(foot_angle_rad: float) -> StripState:
    """Equilibrium of the strip whose foot is tilted by 0.001 to π/2, where the foot lies flat.

    Solves B θ'' = −(P sin θ + Q cos θ), θ(0) = 0 (clamp), θ'(L) = 0 (hinged foot), ∫ sin θ ds = 0
    (foot under the clamp) by shooting, continued from the buckled straight strip.
    """
    angle = specimen.require("foot_angle_rad", foot_angle_rad, 1e-3, FLAT_FOOT_RAD)
    angles, states = _branch()
    guess = np.array([np.interp(angle, angles, column) for column in states.T])
    if angle < angles[0]:
        guess = states[0] * (angle / angles[0], 1.0, angle / angles[0])
    curvature, vertical, horizontal = _solve(angle, guess)
    curve = _integrate(curvature, vertical, horizontal, np.linspace(0.0, 1.0, 201)).y[2:].T
    loads = float(vertical), float(abs(horizontal))
    return StripState(float(1.0 - curve[-1, 1]), angle, *loads, curve)


def _at(quantity, target: float) -> StripState:
    """The state where a quantity that grows with the foot angle reaches the target."""
    angle = brentq(
        lambda x: quantity(strip_state_at_foot_angle(x)) - target, 1e-3, FLAT_FOOT_RAD, xtol=1e-10
    )
    return strip_state_at_foot_angle(angle)


def strip_state(strain: float) -> StripState:
    """Equilibrium, the foot held by friction, at a strain from 10⁻⁶ to 0.3303 (flat foot)."""
    flat = strip_state_at_foot_angle(FLAT_FOOT_RAD)
    strain = specimen.require("strain", strain, 1e-6, flat.strain)
    if strain == flat.strain:
        return flat
    return _at(lambda state: state.strain, strain)


@lru_cache(maxsize=64)
def strip_slip_strain(friction: float) -> float | None:
    """Strain at which the foot of a pushed strip slips; 0 without friction, None if it never does.

    The foot slips where |Q|/P, which grows with the strain, reaches μ. At ε = 0.3303, |Q|/P =
    0.3564 the foot lies flat: with more friction the strip never slips as a whole (Sano et al.
    2017).
    """
    friction = specimen.require("friction", friction, 0.0)
    smallest = strip_state_at_foot_angle(1e-3)
    if friction <= smallest.load_ratio:
        # Close to buckling the ratio grows with the root of the strain.
        return smallest.strain * (friction / smallest.load_ratio) ** 2
    if friction > strip_state_at_foot_angle(FLAT_FOOT_RAD).load_ratio:
        return None
    return _at(lambda state: state.load_ratio, friction).strain


def strip(
    settings: SimulationSettings,
    friction: float,
    vertices: float = 149,
    gamma: float = 0.0,
    strain: float = LARGEST_STRAIN,
) -> dict[str, Any]:
    """Push a 20 cm strip on the floor until its foot slips or lies flat.

    ``vertices`` are the rows along the strip, ``gamma`` is areal density x gravity x length^3 / B,
    and ``strain`` how far the strip is pushed, over its length. ``friction_at_slip`` is |Q|/P,
    ``strain`` and ``load_ratio`` are those of each step, ``shape_m`` is at ``shape_strain``.
    """
    push = _push(settings, friction, int(vertices), gamma, strain)
    slip_strain = push["slip_strain"]
    read = None
    if slip_strain is not None and slip_strain >= 1e-6:
        lies_flat = strip_state_at_foot_angle(FLAT_FOOT_RAD)
        read = strip_state(min(slip_strain, lies_flat.strain)).load_ratio
    regime = "slipped" if slip_strain is not None else "pinned"
    return {
        "slip_strain": slip_strain,
        "regime": regime if push["flat_strain"] is None else "partially slipped",
        "friction_at_slip": None if slip_strain is None else push["load_ratio"][-1],
        "friction_read_from_strain": read,
        "theory_slip_strain": strip_slip_strain(friction),
        "theory_regime": theory_regime(friction, strain),
        **push,
    }


def theory_regime(friction: float, strain: float = LARGEST_STRAIN) -> str:
    """Theoretical state of a weightless strip pushed to a strain."""
    slips_at = strip_slip_strain(friction)
    if slips_at is not None and slips_at <= strain:
        return "slipped"
    lies_flat_at = strip_state_at_foot_angle(FLAT_FOOT_RAD).strain
    return "partially slipped" if strain >= lies_flat_at else "pinned"


def _push(
    settings: SimulationSettings, friction: float, vertices: int, gamma: float, strain: float
) -> dict[str, Any]:
    """Push until the foot slips, lies flat, or the strain is reached.

    The foot slips where |Q|/P, extrapolated, reaches μ in the step in which the foot moved, and
    lies flat in the middle of that step.
    """
    solver, start_m = _buckled_strip(settings, friction, vertices, gamma)
    step_s = settings.time_step_s
    foot, clamp = slice(-2, None), specimen.carried(start_m, 0.0, 0.0, -SPEED_M_S)
    strains: list[float] = []
    ratios: list[float] = []
    slip_strain = flat_strain = None
    shape_m, shape_strain = _profile(solver), START_STRAIN
    rested_m = solver.positions_m[foot, 0].copy()
    steps = int(np.ceil((strain - START_STRAIN) * LENGTH_M / (SPEED_M_S * step_s) - 1e-9))
    for _ in range(steps):
        solver.advance(step_s, clamp)
        now = START_STRAIN + SPEED_M_S * solver.time_s / LENGTH_M
        force_N = solver.floor_forces().sum(axis=0)
        strains.append(now)
        ratios.append(float(abs(force_N[0]) / max(force_N[2], 1e-300)))
        if np.abs(solver.positions_m[foot, 0] - rested_m).max() > SLIP_M:
            slip_strain = _crossing(strains, ratios, friction)
            break
        if (solver.positions_m[-4:-2, 2] < 0).any():
            flat_strain = 0.5 * (now + shape_strain)
            break
        shape_m, shape_strain = _profile(solver), now
    return {
        "flat_strain": flat_strain,
        "slip_strain": slip_strain,
        "strain": strains,
        "load_ratio": ratios,
        "shape_m": shape_m.tolist(),
        "shape_strain": shape_strain,
        "newton_iterations": solver.record.newton_iterations,
    }


def _crossing(strains: list[float], ratios: list[float], friction: float) -> float:
    """Strain in the last step at which the load ratio of the steps before reaches the friction."""
    if len(strains) < 3:
        return strains[-1]
    (first, before, last), (ratio_first, ratio_before) = strains[-3:], ratios[-3:-1]
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
    mesh, spacing_m = specimen.clamped_strip(vertices, LENGTH_M)
    # Without weight as light as a strip of the largest gamma, so that inertia is nothing.
    weight_N_m2 = specimen.AREAL_DENSITY_KG_M2 * GRAVITY_M_S2
    rigidity_Nm = weight_N_m2 * LENGTH_M**3 / (gamma or LARGEST_GAMMA)
    wave = np.sqrt(strip_buckling_load())
    push_N = wave**2 * rigidity_Nm * spacing_m / LENGTH_M**2
    centres = np.clip((np.arange(vertices - 1)) * spacing_m / LENGTH_M, 0.0, 1.0)
    mode = np.cos(wave * centres) - 1 + wave * np.sin(wave * centres)
    turn = mode * np.sqrt(2 * START_STRAIN / np.mean(mode**2))
    sideways = np.concatenate([[0.0], np.cumsum(np.sin(turn))]) * spacing_m
    down = np.concatenate([[0.0], np.cumsum(np.cos(turn))]) * spacing_m
    start_m = np.column_stack(
        [np.repeat(sideways, 2), mesh.rest_uv_m[:, 0], np.repeat(down[-1] - down, 2)]
    )
    tables = specimen.cylindrical_strip_tables(12 * rigidity_Nm / THICKNESS_M**2, rigidity_Nm)
    gravity_m_s2 = (0.0, 0.0, -GRAVITY_M_S2 if gamma else 0.0)
    conditions = Conditions(gravity_m_s2=gravity_m_s2, nodal_force_N=push_N / 2)
    return specimen.started(
        settings, mesh, tables, start_m, specimen.held(mesh, 2), friction, conditions
    ), start_m
