"""Laws of dry friction that need no elasticity: inclined plane, flat drag, capstan."""

import math
from dataclasses import dataclass

from slipstitch.physics.gravity import GRAVITY_M_S2
from slipstitch.physics.theory.domain import require


@dataclass(frozen=True)
class Incline:
    """Motion of a body on an inclined plane.

    Attributes
    ----------
    sticks : bool
        Whether it stays where it is.
    acceleration_m_s2 : float
        Its acceleration down the slope (m/s²); 0 if it sticks.
    """

    sticks: bool
    acceleration_m_s2: float


def incline(friction: float, slope_rad: float, *, gravity_m_s2: float = GRAVITY_M_S2) -> Incline:
    """Amontons-Coulomb on an inclined plane, released at rest.

    Sticks while tan θ ≤ μ, else slides with a = g (sin θ − μ cos θ).

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0, static and kinetic alike.
    slope_rad : float
        Angle θ of the plane (rad), 0 ≤ θ < π/2.
    gravity_m_s2 : float
        Acceleration of gravity (m/s²).

    Returns
    -------
    Incline
        Whether it sticks, and its acceleration (m/s²).

    Raises
    ------
    BadInput
        If an argument is out of range.
    """
    friction = require("friction", friction, 0.0)
    slope = require("slope_rad", slope_rad, 0.0, math.pi / 2, open_above=True)
    gravity = require("gravity_m_s2", gravity_m_s2, 0.0, open_below=True)
    if math.tan(slope) <= friction:
        return Incline(sticks=True, acceleration_m_s2=0.0)
    return Incline(False, gravity * (math.sin(slope) - friction * math.cos(slope)))


def flat_drag(friction: float) -> float:
    """Pull over weight of a sheet that lies flat and is dragged steadily.

    Every part of the sheet carries its own weight, so that the pull is μ times the whole weight
    whatever the shape (Amontons 1699).

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0.

    Returns
    -------
    float
        Horizontal pull divided by the weight, dimensionless.

    Raises
    ------
    BadInput
        If the friction coefficient is negative or not finite.
    """
    return require("friction", friction, 0.0)


def capstan(friction: float, wrap_rad: float) -> float:
    """Ratio of the tensions of a strip that slips around a fixed cylinder.

    T₂/T₁ = exp(μ φ) (Euler 1769, Eytelwein 1808). A strip of bending rigidity B around radius R
    follows it for B/(T R²) < 0.01.

    Parameters
    ----------
    friction : float
        Friction coefficient μ ≥ 0.
    wrap_rad : float
        Angle φ of contact (rad), ≥ 0.

    Returns
    -------
    float
        Pulling over holding tension, dimensionless.

    Raises
    ------
    BadInput
        If an argument is out of range.
    """
    friction = require("friction", friction, 0.0)
    wrap = require("wrap_rad", wrap_rad, 0.0)
    return math.exp(friction * wrap)
