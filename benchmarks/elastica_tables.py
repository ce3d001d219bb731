"""Tabulate the two elastica problems that the protocols' forward models interpolate in.

``python benchmarks/elastica_tables.py`` makes the JSON tables of the package anew (a few minutes);
a test compares them with closed forms and published values.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

TABLES = Path(__file__).parents[1] / "src/slipstitch/criticise/protocols"
FOOT_ANGLES = np.concatenate([[0.02, 0.05], np.linspace(0.1, np.pi / 2, 30)])
STRIP_LOADS = np.concatenate(
    [np.linspace(0, 4, 9), np.linspace(5, 20, 13), np.linspace(22, 60, 15)]
)
STIFFNESS_ROOTS = np.linspace(0.0, 1.2, 37)
TENSION_ROOTS = np.linspace(0.0, 3.2, 33)
# Tangents of the floor's slope along the drag; the tables are quadratic between them.
LEANS = (-0.08, 0.0, 0.08)


def strip_row(gamma: float, guess=None):
    """Solutions of the pushed heavy strip at one weight, the foot turning from 0 to 90 degrees.

    theta'' = -(P - gamma s) sin theta + Q cos theta, foot hinged (theta' = 0), top vertical
    (theta = 0), foot under the top (the integral of sin theta is 0); lengths in L, forces in
    B/L^2 (a width).

    Returns
    -------
    numpy.ndarray
        (angles, 3): friction ratio Q/P, vertical strain, P.
    """
    rows = []
    solution = guess
    for angle in FOOT_ANGLES:
        if solution is None:
            s = np.linspace(0, 1, 81)
            k = 4.4934
            shape = angle * (np.cos(k * s) - np.cos(k)) / (1 - np.cos(k))
            state = np.vstack([shape, np.gradient(shape, s), np.zeros_like(s)])
            unknown = np.array([20.19, 20.19 * angle * 0.2])
        else:
            s, state, unknown = solution.x, solution.y.copy(), solution.p.copy()
            factor = angle / state[0, 0]
            state *= factor
            if len(rows) < 3:
                unknown = np.array([unknown[0], unknown[1] * factor])

        def equations(s, y, p):
            turn = -(p[0] - gamma * s) * np.sin(y[0]) + p[1] * np.cos(y[0])
            return np.vstack([y[1], turn, np.sin(y[0])])

        def conditions(a, b, p, angle=angle):
            return np.array([a[0] - angle, a[1], a[2], b[0], b[2]])

        solution = solve_bvp(equations, conditions, s, state, p=unknown, tol=1e-7, max_nodes=4000)
        if not solution.success:
            raise RuntimeError(f"strip table: no solution at {gamma=} {angle=}: {solution.message}")
        fine = np.linspace(0, 1, 2001)
        strain = 1 - np.trapz(np.cos(solution.sol(fine)[0]), fine)
        load, push = solution.p
        rows.append((push / load, strain, load))
        if len(rows) == 1:
            first = solution
    return np.array(rows), first


def limp_row(lean: float):
    """:func:`lifted_row` without bending, by its integrals in closed form."""
    a = 1.0 + lean**2
    rows = []
    for tension in TENSION_ROOTS**2:
        if tension == 0.0:  # it hangs plumb
            rows.append((np.sqrt(a), -lean, 0.0))
            continue

        def inverse(length, tension=tension):
            """Integral of 1 / T from the touchdown, T^2 = s^2 + (eta - lean s)^2."""
            reach = np.arcsinh((a * length - tension * lean) / tension)
            return (reach + np.arcsinh(lean)) / np.sqrt(a)

        def height(length, tension=tension, inverse=inverse):
            pull = np.hypot(length, tension - lean * length)
            return (pull - tension) / a + tension * lean / a * inverse(length)

        length = brentq(lambda arc: height(arc) - 1.0, 0.5, 40.0, xtol=1e-13)
        rows.append((length, tension * inverse(length) - lean, 0.0))
    return np.array(rows)


def lifted_row(stiffness_root: float, lean: float = 0.0):
    """Lifted part of a cloth held at height 1 under a series of tensions.

    beta theta'' = (eta - lean s) sin theta - (s - r0) cos theta from the touchdown
    (theta = theta' = 0) to the hinged clamp (theta' = 0, height 1); forces in w h, w being the
    weight normal to the floor and ``lean`` that along the drag over w.

    Returns
    -------
    numpy.ndarray
        (tensions, 3): length, extent along the floor, point load r0 at the touchdown.
    """
    eta = TENSION_ROOTS**2
    if stiffness_root == 0.0:
        return limp_row(lean)
    beta = stiffness_root**3
    rows = []
    solution = None
    for tension in eta[::-1]:
        if solution is None:
            length = np.sqrt(1 + 2 * tension)
            t = np.linspace(-1, 1, 401)  # nodes crowd where the bending boundary layers are
            s = 0.5 * (1 + np.tanh(3.5 * t) / np.tanh(3.5))
            angle = np.arctan2(s * length, tension)
            height = np.sqrt(tension**2 + (s * length) ** 2) - tension
            state = np.vstack([angle, np.gradient(angle, s), height])
            unknown = np.array([length, 0.3 * stiffness_root])
        else:
            state, unknown = solution.sol(s), solution.p

        def equations(s, y, p, tension=tension):
            along = tension - lean * s * p[0]
            turn = along * np.sin(y[0]) - (s * p[0] - p[1]) * np.cos(y[0])
            return np.vstack([y[1], turn * p[0] ** 2 / beta, p[0] * np.sin(y[0])])

        def conditions(a, b, p):
            return np.array([a[0], a[1], a[2], b[1], b[2] - 1.0])

        solution = solve_bvp(equations, conditions, s, state, p=unknown, tol=1e-5, max_nodes=20000)
        if not solution.success:
            raise RuntimeError(
                f"cloth table: no solution at {stiffness_root=} {tension=} {lean=}: "
                f"{solution.message}"
            )
        length, load = solution.p
        fine = np.linspace(0, 1, 4001)
        extent = length * np.trapz(np.cos(solution.sol(fine)[0]), fine)
        rows.append((length, extent, load))
    return np.array(rows[::-1])


def main() -> None:
    """Write ``strip_table.json`` and ``lifted_cloth_table.json`` into the package."""
    strip, guess = [], None
    for gamma in STRIP_LOADS:
        row, guess = strip_row(gamma, guess)
        strip.append(row)
    strip = np.array(strip)
    table = {
        "weight": STRIP_LOADS.tolist(),
        "foot_angle_rad": FOOT_ANGLES.tolist(),
        "friction_ratio": strip[:, :, 0].round(9).tolist(),
        "strain": strip[:, :, 1].round(9).tolist(),
        "load": strip[:, :, 2].round(7).tolist(),
    }
    (TABLES / "strip_table.json").write_text(json.dumps(table))
    lifted = np.array([[lifted_row(root, lean) for root in STIFFNESS_ROOTS] for lean in LEANS])
    table = {
        "lean": list(LEANS),
        "stiffness_root": STIFFNESS_ROOTS.tolist(),
        "tension_root": TENSION_ROOTS.tolist(),
        "length": lifted[..., 0].round(8).tolist(),
        "extent": lifted[..., 1].round(8).tolist(),
        "point_load": lifted[..., 2].round(8).tolist(),
    }
    (TABLES / "lifted_cloth_table.json").write_text(json.dumps(table))


if __name__ == "__main__":
    main()
