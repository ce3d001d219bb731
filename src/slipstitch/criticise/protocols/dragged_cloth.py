"""Trailing edge and contact length of a planar heavy elastic cloth that is dragged."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from slipstitch.physics.friction_law import Contact, FrictionLaw

ITERATIONS = 25  # of Newton's method, for the tension


@cache
def _table():
    data = json.loads((Path(__file__).parent / "lifted_cloth_table.json").read_text())
    roots, tensions = np.array(data["stiffness_root"]), np.array(data["tension_root"])
    splines = [
        [RectBivariateSpline(roots, tensions, np.array(plane)) for plane in data[key]]
        for key in ("length", "extent", "point_load")
    ]
    return splines, data["lean"], roots[-1], tensions[-1]


def lifted_part(
    stiffness: np.ndarray, tension: np.ndarray, lean: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, extent along the floor (in h) and touchdown point load (in w h) of the lifted cloth.

    Parameters
    ----------
    stiffness : B / (w h^3), w the areal weight normal to the floor, h the height of the clamp.
    tension : tension along the floor at the touchdown, H / (w h).
    lean : tangent of the floor's slope, positive where the drag runs downhill.
    """
    splines, leans, largest_root, largest_tension = _table()
    root = np.clip(np.cbrt(stiffness), 0.0, largest_root)
    pull = np.clip(np.sqrt(np.maximum(tension, 0.0)), 0.0, largest_tension)
    level = leans.index(0.0)
    if not np.any(lean):
        return tuple(planes[level].ev(root, pull) for planes in splines)
    weights = [
        np.prod([(lean - other) / (own - other) for other in leans if other != own], axis=0)
        for own in leans
    ]
    return tuple(
        sum(weight * plane.ev(root, pull) for weight, plane in zip(weights, planes, strict=True))
        for planes in splines
    )


def sliding_state(
    law: FrictionLaw,
    areal_weight_N_m2: np.ndarray,
    bending_Nm: np.ndarray,
    cloth_length_m: np.ndarray,
    height_m: np.ndarray,
    contact: Contact,
    static: bool,
    tilt_downhill_rad: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Clamp-to-edge distance X and contact length c, (n,) m, when the tension equals the friction.

    Per unit width: H = F(N = w c cos(tilt) + R0, A = c) - w c sin(tilt); gravity leans on the
    lifted cloth as well.
    """
    w, h = np.asarray(areal_weight_N_m2, float), np.asarray(height_m, float)
    w, lean = w * np.cos(tilt_downhill_rad), np.tan(tilt_downhill_rad)
    stiffness = bending_Nm / (w * h**3)
    length = cloth_length_m / h
    tension = law.coefficient * np.maximum(length - 1.0, 0.0)
    for _ in range(ITERATIONS):
        lifted, extent, point = lifted_part(stiffness, tension, lean)
        flat = np.maximum(length - lifted, 1e-3)
        normal = (flat + point) * w * h
        touching = contact.with_load(normal, flat * h)
        limit = law.force_limit(touching, static) - lean * w * flat * h
        excess = tension - limit / (w * h)
        # Newton with the flexible cloth's slope: more tension lifts cloth, which lowers friction.
        slope = 1.0 + limit / np.maximum(normal, 1e-12) / np.sqrt(1.0 + 2.0 * tension)
        tension = np.maximum(tension - excess / slope, 0.0)
        if np.max(np.abs(excess), initial=0.0) < 1e-9:
            break
    lifted, extent, _ = lifted_part(stiffness, tension, lean)
    flat = np.maximum(length - lifted, 1e-3)
    return (extent + flat) * h, flat * h


def rest_state(
    areal_weight_N_m2: np.ndarray,
    bending_Nm: np.ndarray,
    cloth_length_m: np.ndarray,
    height_m: np.ndarray,
    tilt_downhill_rad: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Clamp-to-edge distance and contact length before the drag, at no tension."""
    h = np.asarray(height_m, float)
    stiffness = bending_Nm / (areal_weight_N_m2 * np.cos(tilt_downhill_rad) * h**3)
    lifted, extent, _ = lifted_part(stiffness, np.zeros_like(h), np.tan(tilt_downhill_rad))
    flat = np.maximum(cloth_length_m / h - lifted, 1e-3)
    return (extent + flat) * h, flat * h


def sticking_path(
    areal_weight_N_m2: float,
    bending_Nm: float,
    cloth_length_m: float,
    height_m: np.ndarray,
    tilt_downhill_rad: np.ndarray | float = 0.0,
    points: int = 300,
) -> tuple[np.ndarray, np.ndarray]:
    """How a cloth whose edge sticks lifts off while the clamp advances from 0.

    Advance and contact length in m, (heights, points) each.
    """
    tension = np.linspace(0.0, _table()[-1], points) ** 2
    h = np.asarray(height_m, float)[:, None]
    tilt = np.broadcast_to(tilt_downhill_rad, len(h))[:, None]
    stiffness = bending_Nm / (areal_weight_N_m2 * np.cos(tilt) * h**3)
    stiffness, tension = np.broadcast_arrays(stiffness, tension)
    lifted, extent, _ = lifted_part(stiffness, tension, np.tan(tilt))
    flat = cloth_length_m / h - lifted
    distance = extent + flat
    return (distance - distance[:, :1]) * h, flat * h
