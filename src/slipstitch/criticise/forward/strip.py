"""(b) The strip pushed on the substrate (Sano, Yamaguchi and Wada 2017), with its own weight."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from slipstitch.friction_law import Contact, FrictionLaw

RATIO_POINTS = np.linspace(0.0, 1.0, 41)


@cache
def _table():
    data = json.loads((Path(__file__).parent / "strip_table.json").read_text())
    weight = np.array(data["weight"])
    ratio, strain, load = (np.array(data[key]) for key in ("friction_ratio", "strain", "load"))
    largest = ratio[:, -1]
    # Strain grows as the square of the ratio: interpolate strain / ratio^2, which is smooth.
    smooth = np.empty((2, len(weight), len(RATIO_POINTS)))
    for i in range(len(weight)):
        u = ratio[i] / largest[i]
        curvature = strain[i] / u**2
        points = np.clip(RATIO_POINTS, u[0], 1.0)
        smooth[0, i] = make_interp_spline(u, curvature, k=3)(points)
        smooth[1, i] = make_interp_spline(u, load[i], k=3)(points)
    return (
        RectBivariateSpline(weight, RATIO_POINTS, smooth[0]),
        RectBivariateSpline(weight, RATIO_POINTS, smooth[1]),
        make_interp_spline(weight, largest, k=3),
        (weight[0], weight[-1]),
    )


def largest_weight_number() -> float:
    """Largest tabulated rho g L^3 / B."""
    return _table()[3][1]


def areal_contact(weight_number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Friction ratio and strain at which the foot lies flat (areal contact) without a slip."""
    curvature, _, largest, _ = _table()
    return largest(weight_number), curvature.ev(weight_number, 1.0)


def foot(weight_number: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertical strain and foot load of a strip whose foot carries the friction ratio Q/P.

    Beyond areal contact the strain goes on linearly: a latent value, for censored trials.

    Returns
    -------
    strain, load : (n,) and (n,), the load in B width / L^2.
    """
    curvature, load, largest, (low, high) = _table()
    weight_number = np.clip(weight_number, low, high)
    u = np.maximum(ratio, 1e-6) / largest(weight_number)
    inside = np.minimum(u, 1.0)
    value = curvature.ev(weight_number, inside)
    slope = 2.0 * value + curvature.ev(weight_number, 1.0, dy=1)
    strain = np.where(u <= 1.0, value * inside**2, value + slope * (u - 1.0))
    return strain, load.ev(weight_number, inside)


def slip_strain(
    law: FrictionLaw,
    weight_number: np.ndarray,
    force_unit_N: np.ndarray,
    contact: Contact,
    tilt_downhill_rad: np.ndarray | float = 0.0,
    iterations: int = 12,
) -> np.ndarray:
    """Strain at which the foot slips: tan(atan(Q/P) + tilt) = F(P) / P.

    Parameters
    ----------
    weight_number : (n,) rho g L^3 / B.
    force_unit_N : (n,) B width / L^2.
    contact : an edge contact; its load is replaced.
    """
    ratio = np.full(np.shape(weight_number), law.coefficient, dtype=float)
    for _ in range(iterations):
        _, load = foot(weight_number, ratio)
        normal = load * force_unit_N
        limit = law.force_limit(contact.with_load(normal), static=True) / normal
        update = np.tan(np.clip(np.arctan(limit) - tilt_downhill_rad, 0.0, 1.5))
        change = np.max(np.abs(update - ratio), initial=0.0)
        ratio = update
        if change < 1e-9:
            break
    return foot(weight_number, ratio)[0]
