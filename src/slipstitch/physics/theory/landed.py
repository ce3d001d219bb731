"""A heavy strip lowered on a floor until its end lands: whether its foot slips or folds under."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from slipstitch.base.errors import NotConverged
from slipstitch.physics.theory.domain import require
from slipstitch.physics.theory.strip import FLAT_FOOT_RAD, strip_state_at_foot_angle

LARGEST_GAMMA = 3.0e3
SMALLEST_FOOT_ANGLE_RAD = 0.02
# Weights by which the strip with weight is reached from the one without.
_LADDER = np.geomspace(1.0, 5.0e3, 23)
_STATIONS = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True)
class LandedStrip:
    """One equilibrium of a lowered heavy strip, in units of its length and rigidity.

    Attributes
    ----------
    strain : float
        Descent since the foot touched, over the strip's length.
    foot_angle_rad : float
        Between the foot's tangent and the vertical (rad); π/2 where it lies flat.
    vertical_load, horizontal_load : float
        P L²/B and |Q| L²/B, what the foot presses and rubs the floor with.
    """

    strain: float
    foot_angle_rad: float
    vertical_load: float
    horizontal_load: float

    @property
    def load_ratio(self) -> float:
        """|Q|/P: the friction coefficient at which this state slips."""
        return self.horizontal_load / self.vertical_load


def _solve(gamma: float, foot_angle: float, guess):
    """Collocation; the unknowns are the strip's angle and path, and P and Q at the foot."""

    def slope(s, state, loads):
        angle = state[0]
        sine, cosine = np.sin(angle), np.cos(angle)
        thrust = loads[0] - gamma * (1.0 - s)
        return np.vstack((state[1], -(thrust * sine + loads[1] * cosine), sine, cosine))

    def ends(clamp, foot, _):
        return np.array([clamp[0], clamp[2], clamp[3], foot[1], foot[2], foot[0] + foot_angle])

    stations, states, loads = guess
    solution = solve_bvp(slope, ends, stations, states, p=loads, tol=1e-6, max_nodes=20000)
    if solution.status != 0:
        raise NotConverged(
            f"landed strip: no equilibrium at gamma {gamma:g}, foot angle {foot_angle:.3f} rad"
        )
    return solution.x, solution.y, solution.p


def _weightless(foot_angle: float):
    """The strip without weight, with the signs of this boundary value problem."""
    state = strip_state_at_foot_angle(foot_angle)
    path = state.curve
    steps = np.gradient(path, _STATIONS, axis=0)
    angle = np.arctan2(steps[:, 0], steps[:, 1])
    side = -np.sign(angle[-1])
    states = (side * angle, side * np.gradient(angle, _STATIONS), side * path[:, 0], path[:, 1])
    # Moment balance about the clamp: its moment is Q times the foot's depth.
    loads = (state.vertical_load, -np.sign(states[1][0]) * state.horizontal_load)
    return _STATIONS, np.vstack(states), np.array(loads)


@lru_cache(maxsize=16)
def _flat_foot(gamma: float):
    """The strip whose foot lies flat, continued from the weightless one."""
    guess = _weightless(FLAT_FOOT_RAD)
    for step in _LADDER[gamma > _LADDER]:
        guess = _solve(float(step), FLAT_FOOT_RAD, guess)
    return _solve(gamma, FLAT_FOOT_RAD, guess)


def _state(gamma: float, foot_angle: float, solved) -> LandedStrip:
    _, states, loads = solved
    return LandedStrip(
        float(1.0 - states[3, -1]), foot_angle, float(loads[0]), float(abs(loads[1]))
    )


def landed_strip(gamma: float) -> LandedStrip:
    """State at which the foot of a lowered heavy strip comes to lie flat.

    A strip hangs from a clamp, straight down, and is lowered on a floor. Its foot, held by
    friction below the clamp, carries P and Q; the strip above buckles sideways,

        B θ'' = −((P − w (L − s)) sin θ + Q cos θ),  θ(0) = 0,  θ'(L) = 0,  ∫ sin θ ds = 0,

    θ from the vertical, s from the clamp: the strip of Sano, Yamaguchi & Wada (2017) with its
    weight. |Q|/P grows until the foot's tangent lies flat. With less friction than the ratio
    there the foot slips, and the tail lies down straight; with more it is folded under.

    Parameters
    ----------
    gamma : float
        Γ = w L³/B, dimensionless, 0 ≤ Γ ≤ 3000.

    Returns
    -------
    LandedStrip
        ``load_ratio`` is the friction coefficient that parts slipping from folding.

    Raises
    ------
    BadInput
        If Γ is out of range.
    NotConverged
        If the boundary value problem is not solved.
    """
    gamma = require("gamma", gamma, 0.0, LARGEST_GAMMA)
    return _state(gamma, FLAT_FOOT_RAD, _flat_foot(gamma))


def landed_strip_slip_strain(friction: float, gamma: float) -> float | None:
    """Strain at which the foot of a lowered heavy strip slips.

    Parameters
    ----------
    friction : float
        Friction coefficient μ, at least 0.02.
    gamma : float
        Γ, as for `landed_strip`.

    Returns
    -------
    float or None
        Strain, dimensionless; None if it lies flat first.

    Raises
    ------
    BadInput
        If an argument is out of range.
    NotConverged
        If the boundary value problem is not solved.
    """
    friction = require("friction", friction, 0.02)
    flat = landed_strip(gamma)
    if friction > flat.load_ratio:
        return None
    solved = {FLAT_FOOT_RAD: _flat_foot(float(gamma))}

    def at(angle: float) -> LandedStrip:
        nearest = min(solved, key=lambda known: abs(known - angle))
        for step in np.linspace(nearest, angle, 2 + int(abs(nearest - angle) / 0.15))[1:]:
            solved[float(step)] = _solve(float(gamma), float(step), solved[nearest])
            nearest = float(step)
        return _state(gamma, nearest, solved[nearest])

    angle = brentq(
        lambda angle: at(angle).load_ratio - friction,
        SMALLEST_FOOT_ANGLE_RAD,
        FLAT_FOOT_RAD,
        xtol=1e-6,
    )
    return at(angle).strain
