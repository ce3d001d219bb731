"""The heavy cantilever: a strip clamped horizontally that bends under its own weight."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slipstitch.physics.theory.domain import require

SMALLEST_GAMMA = 1.0e-3
LARGEST_GAMMA = 1.0e4
# Bounds of the shooting parameter that enclose that range of Γ.
_PARAMETERS = (-10.0, 80.0)


@dataclass(frozen=True)
class HeavyCantilever:
    """Shape of a heavy cantilever of length 1.

    Attributes
    ----------
    gamma : float
        Γ = ρ g L³ / B, dimensionless (areal density ρ, bending rigidity B of a unit width).
    height_over_width : float
        Sag of the tip over its horizontal distance from the clamp.
    tip_angle_rad : float
        Angle of the tip below the horizontal (rad).
    curve : ndarray, shape (n, 2)
        Points from the clamp to the tip: horizontal distance and height over the length
        (heights ≤ 0).
    """

    gamma: float
    height_over_width: float
    tip_angle_rad: float
    curve: np.ndarray

    @property
    def chord_angle_rad(self) -> float:
        """Angle of the straight line from clamp to tip below the horizontal (rad)."""
        return math.atan(self.height_over_width)


def _from_the_tip(plumb_deficit: float, stations: int | None = None):
    """Integrate from the free end, where two of the three unknowns are known.

    With lengths in units of (B/ρg)^(1/3) and δ = π/2 − θ, the equation is δ'' = s sin δ from
    δ(0) = δ₀, δ'(0) = 0; the clamp is where δ first reaches π/2. Every δ₀ is the tip of one strip
    and Γ is the cube of its length, so that no other branch can be met by mistake.

    Returns
    -------
    length : float
        Distance from the tip to the clamp.
    states : ndarray, shape (4, n)
        δ, δ', horizontal and vertical distance from the tip, at the clamp or at n stations.
    """

    def slope(s, state):
        deficit, curvature = state[0], state[1]
        sine = math.sin(deficit)
        return (curvature, s * sine, sine, math.cos(deficit))

    def clamp(_, state):
        return state[0] - math.pi / 2

    clamp.terminal = True  # type: ignore[attr-defined]  # how SciPy is told to stop there
    solution = solve_ivp(
        slope,
        (0.0, 50.0),
        (plumb_deficit, 0.0, 0.0, 0.0),
        method="DOP853",
        events=clamp,
        rtol=1e-11,
        atol=1e-60,
        dense_output=stations is not None,
    )
    length = solution.t_events[0][0]
    if stations is None:
        return length, solution.y_events[0].T
    return length, solution.sol(np.linspace(0.0, length, stations))


def _plumb_deficit(parameter: float) -> float:
    """π/2 minus the tip's angle, for a parameter that grows with Γ without bound."""
    return 0.5 * math.pi / (1.0 + math.exp(parameter))


def _shape(parameter: float) -> HeavyCantilever:
    deficit = _plumb_deficit(parameter)
    length, states = _from_the_tip(deficit, 201)
    across, down = states[2] / length, states[3] / length
    curve = np.column_stack((across[-1] - across, down - down[-1]))[::-1]
    ratio = float(down[-1] / across[-1])
    return HeavyCantilever(length**3, ratio, 0.5 * math.pi - deficit, curve)


def heavy_cantilever(gamma: float) -> HeavyCantilever:
    """Sag of a strip clamped horizontally at one end.

    Solves θ'' = −Γ (1 − s) cos θ with θ(0) = 0 at the clamp and θ'(1) = 0 at the tip (θ below the
    horizontal; Bickley 1934; Peirce 1930 for cloth), by shooting from the tip.

    Parameters
    ----------
    gamma : float
        Γ = ρ g L³ / B, dimensionless, 10⁻³ ≤ Γ ≤ 10⁴.

    Returns
    -------
    HeavyCantilever
        Height over width, tip angle (rad) and the shape.

    Raises
    ------
    BadInput
        If Γ is out of range.
    """
    gamma = require("gamma", gamma, SMALLEST_GAMMA, LARGEST_GAMMA)
    parameter = brentq(
        lambda x: math.log(_from_the_tip(_plumb_deficit(x))[0] ** 3 / gamma),
        *_PARAMETERS,
        xtol=1e-12,
    )
    return _shape(parameter)


def cantilever_rule_gamma(chord_angle_rad: float = math.radians(41.5)) -> float:
    """Γ at which the chord of a heavy cantilever has a given angle.

    The textile bending test (Peirce 1930; ASTM D1388) feeds a strip over an edge until its chord
    stands at 41.5°, and takes B = ρ g (L/2)³, that is Γ = 8.

    Parameters
    ----------
    chord_angle_rad : float
        Angle of the chord below the horizontal (rad), 0.001 ≤ angle ≤ 1.5.

    Returns
    -------
    float
        Γ, dimensionless.

    Raises
    ------
    BadInput
        If the angle is out of range.
    """
    angle = require("chord_angle_rad", chord_angle_rad, 1e-3, 1.5)
    parameter = brentq(lambda x: _shape(x).chord_angle_rad - angle, *_PARAMETERS, xtol=1e-12)
    return _shape(parameter).gamma
