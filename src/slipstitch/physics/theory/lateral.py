"""Lateral buckling of a heavy strip held edgewise at one end."""

import math

from slipstitch.physics.theory.domain import require

# First root of J_{-1/6}(x/6) = 0 is x = 12.854: see the test, which solves the eigenproblem.
NARROW_STRIP = 12.853718


def lateral_buckling(width_over_length: float, poisson_ratio: float) -> float:
    """Critical weight of a strip clamped at one end, its plane vertical, that sags sideways.

    A beam under its own weight q per length buckles sideways at q L³ = 12.854 √(EI · GJ)
    (Prandtl 1899; Timoshenko & Gere 1961, sec. 6.3). For a thin strip of width b and plate rigidity
    D, EI = (1 − ν²) D b and GJ = 2 (1 − ν) D b, hence with Γ = ρ g L³ / D (areal density ρ)

        Γ* = 12.854 √2 (1 − ν) √(1 + ν),

    independent of the width as long as the strip is narrow.

    Parameters
    ----------
    width_over_length : float
        Width over free length, in (0, 0.5]. Only checked: above, the strip is a plate, and the
        clamp's hindrance of warping raises Γ* appreciably well before that.
    poisson_ratio : float
        Poisson ratio ν of the sheet, −1 < ν < 1.

    Returns
    -------
    float
        Γ*, dimensionless.

    Raises
    ------
    BadInput
        If an argument is out of range.
    """
    require("width_over_length", width_over_length, 0.0, 0.5, open_below=True)
    ratio = require("poisson_ratio", poisson_ratio, -1.0, 1.0, open_below=True, open_above=True)
    return lateral_buckling_of_beam(1.0 - ratio**2, 2.0 * (1.0 - ratio))


def lateral_buckling_of_beam(bending: float, torsion: float) -> float:
    """Critical weight of the same strip from its rigidities, whatever it is made of.

    q L³ = 12.854 √(EI · GJ), q the weight per length (Prandtl 1899).

    Parameters
    ----------
    bending, torsion : float
        Lateral bending rigidity EI and torsional rigidity GJ, both over D b.

    Returns
    -------
    float
        Γ* = ρ g L³ / D, dimensionless.

    Raises
    ------
    BadInput
        If a rigidity is not positive.
    """
    bending = require("bending", bending, 0.0, open_below=True)
    torsion = require("torsion", torsion, 0.0, open_below=True)
    return NARROW_STRIP * math.sqrt(bending * torsion)
