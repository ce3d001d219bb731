"""A strip clamped vertically and pushed down on a floor: the strain at which its foot slips.

The experiment of Sano, Yamaguchi & Wada, "Slip Morphology of Elastic Strips on Frictional Rigid
Substrates", Phys. Rev. Lett. 118, 178001 (2017). The strip (length L, bending rigidity B, weight
negligible) hangs from a clamp with its free lower end on the floor straight below; the clamp goes
down by ε L. Above the buckling load P = 20.19 B/L² it bows to one side and its foot, still a hinge,
pushes sideways with Q. It slips when |Q| = μ P.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from slipstitch.base.errors import NotConverged
from slipstitch.physics.theory.domain import require

FLAT_FOOT_RAD = math.pi / 2


@dataclass(frozen=True)
class StripState:
    """One equilibrium of the pushed strip, in units of its length and rigidity.

    Attributes
    ----------
    strain : float
        ε, the clamp's descent over the strip's length.
    foot_angle_rad : float
        Angle between the foot's tangent and the vertical (rad); π/2 where it lies flat.
    vertical_load : float
        P L²/B, the push on the floor.
    horizontal_load : float
        |Q| L²/B, the friction that holds the foot.
    curve : ndarray, shape (n, 2)
        Points from the clamp to the foot: sideways and downwards, over the length.
    """

    strain: float
    foot_angle_rad: float
    vertical_load: float
    horizontal_load: float
    curve: np.ndarray

    @property
    def load_ratio(self) -> float:
        """|Q|/P: the friction coefficient at which this state slips."""
        return self.horizontal_load / self.vertical_load


def strip_buckling_load() -> float:
    """Push P L²/B at which a clamped-hinged strip buckles.

    √P is the first positive root of tan x = x (Euler 1744): P = 20.19.

    Returns
    -------
    float
        P L²/B, dimensionless.
    """
    return brentq(lambda x: math.sin(x) - x * math.cos(x), 4.0, 4.7, xtol=1e-14) ** 2


def _integrate(curvature: float, vertical: float, horizontal: float, stations=None):
    def slope(_, state):
        angle = state[0]
        sine, cosine = math.sin(angle), math.cos(angle)
        return (state[1], -(vertical * sine + horizontal * cosine), sine, cosine)

    return solve_ivp(
        slope,
        (0.0, 1.0),
        (0.0, curvature, 0.0, 0.0),
        method="DOP853",
        t_eval=stations,
        rtol=1e-11,
        atol=1e-13,
    )


def _solve(foot_angle: float, guess) -> np.ndarray:
    """Clamp curvature, P and Q at a given foot angle, from a guess nearby."""

    def residual(unknowns):
        angle, curvature, sideways, _ = _integrate(*unknowns).y[:, -1]
        # Divided by the amplitude, so that the straight strip is no spurious solution.
        return np.array([angle + foot_angle, curvature, sideways]) / foot_angle

    scale = np.array([foot_angle, 1.0, foot_angle])
    solution = root(lambda x: residual(x * scale), np.asarray(guess) / scale, tol=1e-11)
    if np.abs(solution.fun).max() > 1e-8:
        raise NotConverged(f"strip elastica: no equilibrium at foot angle {foot_angle:.4f} rad")
    return solution.x * scale


@lru_cache(maxsize=1)
def _branch() -> tuple[np.ndarray, np.ndarray]:
    """Follow the buckled branch from the straight strip to the flat foot, once."""
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


def strip_state_at_foot_angle(foot_angle_rad: float) -> StripState:
    """Equilibrium of the strip whose foot is tilted by a given angle.

    Solves B θ'' = −(P sin θ + Q cos θ), θ(0) = 0 (clamp), θ'(L) = 0 (hinged foot),
    ∫ sin θ ds = 0 (foot under the clamp) by shooting, continued from the buckled straight strip.

    Parameters
    ----------
    foot_angle_rad : float
        Angle of the foot's tangent from the vertical (rad), 0.001 ≤ angle ≤ π/2. At π/2 the foot
        lies flat, and the hinge stops being one.

    Returns
    -------
    StripState
        Strain, loads and shape.

    Raises
    ------
    BadInput
        If the angle is out of range.
    NotConverged
        If the shooting fails.
    """
    angle = require("foot_angle_rad", foot_angle_rad, 1e-3, FLAT_FOOT_RAD)
    angles, states = _branch()
    guess = np.array([np.interp(angle, angles, column) for column in states.T])
    if angle < angles[0]:
        guess = states[0] * (angle / angles[0], 1.0, angle / angles[0])
    unknowns = _solve(angle, guess)
    curvature, vertical, horizontal = unknowns
    solution = _integrate(curvature, vertical, horizontal, np.linspace(0.0, 1.0, 201))
    curve = solution.y[2:].T
    return StripState(
        strain=float(1.0 - curve[-1, 1]),
        foot_angle_rad=angle,
        vertical_load=float(unknowns[1]),
        horizontal_load=float(abs(unknowns[2])),
        curve=curve,
    )


def _at(quantity, target: float) -> StripState:
    """The state where a quantity that grows with the foot angle reaches the target."""
    angle = brentq(
        lambda x: quantity(strip_state_at_foot_angle(x)) - target, 1e-3, FLAT_FOOT_RAD, xtol=1e-10
    )
    return strip_state_at_foot_angle(angle)


def strip_state(strain: float) -> StripState:
    """Equilibrium of the strip, its foot held by friction, at a given strain.

    Parameters
    ----------
    strain : float
        ε, the clamp's descent over the length: at least 10⁻⁶, at most 0.3303, where the foot
        lies flat.

    Returns
    -------
    StripState
        Loads, foot angle (rad) and shape; ``load_ratio`` is the friction it needs to hold.

    Raises
    ------
    BadInput
        If the strain is out of range.
    NotConverged
        If the shooting fails.
    """
    flat = strip_state_at_foot_angle(FLAT_FOOT_RAD)
    strain = require("strain", strain, 1e-6, flat.strain)
    if strain == flat.strain:
        return flat
    return _at(lambda state: state.strain, strain)


def strip_slip_strain(friction: float) -> float | None:
    """Strain at which the foot of a pushed strip slips.

    |Q|/P grows with the strain; the foot slips where it reaches μ. At ε = 0.3303, |Q|/P = 0.3564
    the foot lies flat: with more friction the strip never slips as a whole (Sano et al. 2017).

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0.

    Returns
    -------
    float or None
        Slip strain ε, dimensionless; 0 without friction, None if it never slips.

    Raises
    ------
    BadInput
        If the friction coefficient is negative or not finite.
    NotConverged
        If the shooting fails.
    """
    friction = require("friction", friction, 0.0)
    smallest = strip_state_at_foot_angle(1e-3)
    if friction <= smallest.load_ratio:
        # Close to buckling the ratio grows with the root of the strain.
        return smallest.strain * (friction / smallest.load_ratio) ** 2
    if friction > strip_state_at_foot_angle(FLAT_FOOT_RAD).load_ratio:
        return None
    return _at(lambda state: state.load_ratio, friction).strain
