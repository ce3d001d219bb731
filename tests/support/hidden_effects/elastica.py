"""The two elasticas by other methods than the package's tables: shooting and collocation."""

import numpy as np


def pushed_strip(weight, ratio):
    """Heavy strip, hinged foot, clamped top: Runge-Kutta shooting, Newton on (foot angle, P).

    Returns strain, P (in B/L^2) and whether the foot lies flat (the strain is then that of
    areal contact), for arrays of rho g L^3/B and of Q/P.
    """
    weight, ratio = np.broadcast_arrays(np.asarray(weight, float), np.asarray(ratio, float))
    ratio = np.maximum(ratio, 1e-4)
    foot = np.minimum(ratio / 0.2, 1.6)
    load = 20.5 + 0.33 * weight

    def shoot(foot, load, ratio, steps=80):
        state = np.stack([foot, np.zeros_like(foot), np.zeros_like(foot), np.zeros_like(foot)])
        step = 1.0 / steps

        def slope(s, z):
            turn = -(load - weight * s) * np.sin(z[0]) + ratio * load * np.cos(z[0])
            return np.stack([z[1], turn, np.sin(z[0]), np.cos(z[0])])

        for i in range(steps):
            s = i * step
            k1 = slope(s, state)
            k2 = slope(s + step / 2, state + step / 2 * k1)
            k3 = slope(s + step / 2, state + step / 2 * k2)
            k4 = slope(s + step, state + step * k3)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return state

    def newton(unknown, fixed_foot):
        for _ in range(40):
            a, b = unknown
            foot_, load_, ratio_ = (foot0, a, b) if fixed_foot else (a, b, ratio)
            end = shoot(foot_, load_, ratio_)
            residual = np.stack([end[0], end[2]])
            if np.max(np.abs(residual)) < 1e-10:
                break
            jacobian = np.empty((2, 2, *a.shape))
            for j in range(2):
                size = 1e-6 * np.maximum(np.abs(unknown[j]), 1e-3)
                moved = unknown.copy()
                moved[j] = moved[j] + size
                f, p, q = (foot0, moved[0], moved[1]) if fixed_foot else (moved[0], moved[1], ratio)
                other = shoot(f, p, q)
                jacobian[0, j] = (other[0] - end[0]) / size
                jacobian[1, j] = (other[2] - end[2]) / size
            det = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
            change = np.stack(
                [
                    (residual[0] * jacobian[1, 1] - residual[1] * jacobian[0, 1]) / det,
                    (residual[1] * jacobian[0, 0] - residual[0] * jacobian[1, 0]) / det,
                ]
            )
            limit = np.array([0.3, 3.0]) if not fixed_foot else np.array([3.0, 0.1])
            change = np.clip(change, -limit[:, None], limit[:, None])
            unknown = unknown - change
        return unknown, end

    foot0 = np.full_like(ratio, np.pi / 2)
    (flat_load, flat_ratio), flat_end = newton(
        np.stack([22.5 + 0.3 * weight, np.full_like(ratio, 0.36)]), True
    )
    flat = ratio >= flat_ratio
    ratio_kept = ratio.copy()
    ratio = np.where(flat, 0.9 * flat_ratio, ratio)
    foot = np.minimum(ratio / 0.2, 1.45)
    (_, load), end = newton(np.stack([foot, load]), False)
    ratio = ratio_kept
    strain = np.where(flat, 1 - flat_end[3], 1 - end[3])
    return strain, np.where(flat, flat_load, load), flat


def _chebyshev(n):
    k = np.arange(n + 1)
    x = np.cos(np.pi * k / n)
    c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
    difference = x[:, None] - x[None, :]
    matrix = np.outer(c, 1 / c) / (difference + np.eye(n + 1))
    matrix -= np.diag(matrix.sum(axis=1))
    # Clenshaw-Curtis weights by exact integration of the cardinal functions.
    moments = np.array([0.0 if j % 2 else 2.0 / (1 - j * j) for j in range(n + 1)])
    basis = np.cos(np.outer(k, np.pi * k / n))
    weights = np.linalg.solve(basis, moments)
    s = (1 - x) / 2
    return s, -2 * matrix, weights / 2


def hanging_cloth(stiffness, tension, lean=0.0, nodes=44):
    """Lifted part of a cloth at height 1: Chebyshev collocation, one Newton over all cases.

    Returns length, extent along the floor and touchdown point load, for arrays of B/(w h^3), of
    H/(w h) and of the weight along the drag over that normal to the floor, w.
    """
    stiffness, tension, lean = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(one, float)) for one in (stiffness, tension, lean))
    )
    shape = stiffness.shape
    stiffness, tension, lean = stiffness.ravel(), tension.ravel(), lean.ravel()
    s, d, w = _chebyshev(nodes)
    d2 = d @ d
    n, m = len(stiffness), nodes + 1
    length = np.sqrt(1 + 2 * tension) + 0.8 * np.cbrt(stiffness)
    point = 0.3 * np.cbrt(stiffness)
    arc = s * length[:, None]
    layer = np.cbrt(stiffness)[:, None]
    angle = np.arctan2(np.maximum(arc - 0.5 * layer, 0), np.maximum(tension[:, None], 0.3 * layer))
    angle = angle * (1 - np.exp(-((arc / layer) ** 2)))
    for _ in range(60):
        arc = s * length[:, None]
        sin, cos = np.sin(angle), np.cos(angle)
        along = tension[:, None] - lean[:, None] * arc
        force = along * sin - (arc - point[:, None]) * cos
        scale = (stiffness / length**2)[:, None]
        residual = np.empty((n, m + 2))
        jacobian = np.zeros((n, m + 2, m + 2))
        bend = angle @ d2.T
        residual[:, :m] = scale * bend - force
        jacobian[:, :m, :m] = scale[:, :, None] * d2
        i = np.arange(m)
        jacobian[:, i, i] -= along * cos + (arc - point[:, None]) * sin
        jacobian[:, :m, m] = -2 * scale / length[:, None] * bend + s * (cos + lean[:, None] * sin)
        jacobian[:, :m, m + 1] = -cos
        for row, line in ((0, np.eye(m)[0]), (m - 1, d[-1]), (m, d[0])):
            residual[:, row] = angle @ line
            jacobian[:, row, :] = 0.0
            jacobian[:, row, :m] = line
        height = sin @ w
        residual[:, m + 1] = length * height - 1
        jacobian[:, m + 1, :m] = length[:, None] * w * cos
        jacobian[:, m + 1, m] = height
        step = np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0]
        damp = np.minimum(1.0, 0.4 / np.maximum(np.abs(step[:, :m]).max(axis=1), 1e-12))
        damp = np.minimum(damp, 0.3 / np.maximum(np.abs(step[:, m]), 1e-12))
        angle = angle - damp[:, None] * step[:, :m]
        length = length - damp * step[:, m]
        point = point - damp * step[:, m + 1]
        if np.max(np.abs(step)) < 1e-9:
            break
    else:
        raise RuntimeError("the hanging cloth did not converge")
    extent = length * (np.cos(angle) @ w)
    return length.reshape(shape), extent.reshape(shape), point.reshape(shape)
