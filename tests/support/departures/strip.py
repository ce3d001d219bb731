"""A heavy strip, clamped upright above, pushed on to the substrate: Chebyshev collocation.

``theta'' = -(P - gamma s) sin(theta) + Q cos(theta)``, s from the foot, length = rigidity = 1;
``theta'(0) = 0`` (hinge), ``theta(1) = 0`` (clamp), no sideways offset, shortening eps.
"""

from functools import lru_cache

import numpy as np

from support.departures.laws import GRAVITY_M_S2, friction_limit, tilt_of

NODES = 24


@lru_cache
def chebyshev(n):
    """Points on [0, 1], differentiation matrix and quadrature weights (Clenshaw-Curtis)."""
    k = np.arange(n + 1)
    x = -np.cos(np.pi * k / n)
    c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
    gap = x[:, None] - x[None, :] + np.eye(n + 1)
    matrix = (c[:, None] / c[None, :]) / gap
    matrix -= np.diag(matrix.sum(axis=1))
    # Exact for polynomials: moments of the Chebyshev polynomials against their values.
    moments = np.where(k % 2 == 0, 2.0 / (1.0 - k.astype(float) ** 2 + (k == 1)), 0.0)
    values = np.cos(np.outer(np.arange(n + 1), np.arccos(np.clip(x, -1, 1))))
    weights = np.linalg.solve(values, moments)
    return (x + 1) / 2, matrix * 2, weights / 2


def _newton(theta, P, Q, gamma, eps):
    s, D, w = chebyshev(NODES)
    D2, n = D @ D, NODES
    for _ in range(40):
        sin, cos = np.sin(theta), np.cos(theta)
        residual = np.empty(n + 3)
        residual[: n + 1] = D2 @ theta + (P - gamma * s) * sin - Q * cos
        residual[0], residual[n] = D[0] @ theta, theta[n]
        residual[n + 1], residual[n + 2] = w @ sin, w @ (1 - cos) - eps
        jacobian = np.zeros((n + 3, n + 3))
        jacobian[: n + 1, : n + 1] = D2 + np.diag((P - gamma * s) * cos + Q * sin)
        jacobian[: n + 1, n + 1], jacobian[: n + 1, n + 2] = sin, -cos
        for row, line in ((0, D[0]), (n, np.eye(n + 1)[n])):
            jacobian[row, : n + 1], jacobian[row, n + 1 :] = line, 0.0
        jacobian[n + 1, : n + 1], jacobian[n + 2, : n + 1] = w * cos, w * sin
        step = np.linalg.solve(jacobian, residual)
        theta, P, Q = theta - step[: n + 1], P - step[n + 1], Q - step[n + 2]
        if np.abs(step).max() < 1e-10:
            return theta, P, Q
    raise ArithmeticError(f"no shape of the strip at gamma {gamma}, eps {eps}")


@lru_cache(maxsize=4096)
def pushed_strip(gamma):
    """(eps, P, Q, foot angle) from buckling until just after the foot lies flat, arrays."""
    s, _, _ = chebyshev(NODES)
    # Buckling mode without weight: sqrt(P) is the first root of tan x = x.
    k = 4.493409457909064
    theta = np.cos(k * s) - np.cos(k)
    eps = 0.002
    theta *= np.sqrt(2 * eps / (chebyshev(NODES)[2] @ theta**2))
    shape = (theta, k * k, k * k * (-np.cos(k)) * theta[0] / (1 - np.cos(k)))
    for weight in np.linspace(0, gamma, 2 + int(gamma / 4)):
        shape = _newton(*shape, weight, eps)
    rows = []
    before = None
    while eps < 0.75:
        rows.append((eps, shape[1], shape[2], abs(shape[0][0])))
        if abs(shape[0][0]) > 1.72:  # a little beyond flat, to interpolate
            break
        step = 0.004 if eps < 0.02 else 0.012
        guess = shape
        if before is not None:
            guess = tuple(
                a + (a - b) * step / before[1] for a, b in zip(shape, before[0], strict=True)
            )
        before = (shape, step)
        eps += step
        shape = _newton(*guess, gamma, eps)
    return np.array(rows).T


def slip_strain(rows, coefficient, effects, nominal):
    """(strain, slipped) of each trial: at slip, else where the foot first lies flat."""

    def error(name):
        return 1 + effects.get(name, {}).get(name, 0.0)

    rho = nominal["rho_kg_m2"] * error("mass_error") * rows["ply"]
    rigidity = nominal["B_strip_Nm"] * error("bending_error")
    rigidity = rigidity * rows["ply"] ** nominal["ply_exponent"]
    length, width = rows["length_m"], rows["width_m"]
    gamma = rho * GRAVITY_M_S2 * length**3 / rigidity
    unit_N = rigidity * width / length**2
    tilt, towards = tilt_of(effects, rows["azimuth_deg"])
    lean = np.radians(tilt * towards)
    strain, slipped = np.empty(len(gamma)), np.zeros(len(gamma), bool)
    coefficient = np.broadcast_to(coefficient, gamma.shape)
    for i in range(len(gamma)):
        eps, P, Q, foot = pushed_strip(float(f"{gamma[i]:.10g}"))
        one = {k: v[i] for k, v in rows.items() if np.ndim(v)} | {"edge": True}
        load = np.maximum(P, 1e-6) * unit_N[i]
        one["load_N"], one["area_m2"] = load, rows["area_m2"][i]
        bearable = friction_limit(one, coefficient[i], effects, moving=False)
        excess = np.tan(np.arctan2(np.abs(Q), P) + lean[i]) - bearable / load
        flat = np.interp(np.pi / 2, foot, eps)
        over = np.flatnonzero(excess >= 0)
        strain[i] = flat
        if len(over) == 0:
            continue
        j = over[0]
        at = eps[0] * max(0.0, bearable[0] / (bearable[0] + excess[0] * load[0]))
        if j:
            at = _root(eps, excess, j)
        if at < flat:
            strain[i], slipped[i] = at, True
    scale = effects.get("camera_scale", {}).get("camera_scale", 1.0)
    return strain * scale, slipped


def _root(x, y, j):
    """Zero of the cubic through four points about the crossing before index ``j``."""
    first = min(max(j - 2, 0), len(x) - 4)
    part = slice(first, first + 4)
    poly = np.polyfit(x[part] - x[j], y[part], 3)
    roots = np.roots(poly)
    roots = roots[np.abs(roots.imag) < 1e-9].real + x[j]
    good = roots[(roots >= x[j - 1] - 1e-12) & (roots <= x[j] + 1e-12)]
    return float(good[0]) if len(good) else float(np.interp(0, y[j - 1 : j + 1], x[j - 1 : j + 1]))
