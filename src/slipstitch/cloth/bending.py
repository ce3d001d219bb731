"""Bending of the sheet: hinges over inner edges (Warp kernels).

Energy of a hinge: ke l^2 / (8 (a0 + a1)) (theta - theta0)^2, with l the edge's length, a0 and
a1 the areas of its faces at rest, theta the dihedral angle. ke depends on the fold's direction
in the cloth and on the curvature parameter |theta| l / (2 (a0 + a1)), and is frozen in the
force (Wang, O'Brien and Ramamoorthi 2011; Bridson, Marino and Fedkiw 2003; ARCSim).

The kernels run over the hinges of all sheets, as those of :mod:`slipstitch.cloth.elasticity` over
their faces.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from slipstitch.cloth.mesh import ClothMesh
from slipstitch.material.law import CURVATURE_SPACING_PER_M, FOLD_DIRECTIONS

wp.set_module_options({"enable_backward": False})

mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
PER_CURVATURE = wp.constant(wp.float64(1.0 / CURVATURE_SPACING_PER_M))
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))


def hinge_geometry(mesh: ClothMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rest length l (m), rest area a0 + a1 (m^2), and position in the direction rows (0...2).

    Returns
    -------
    length_m, area_m2, direction : ndarray, shape (H,)
    """
    start, end, first, second = (mesh.rest_uv_m[mesh.hinges[:, k]] for k in range(4))
    edge = end - start
    length_m = np.linalg.norm(edge, axis=1)

    def twice_area(tip):
        return np.abs(edge[:, 0] * (tip - start)[:, 1] - edge[:, 1] * (tip - start)[:, 0])

    area_m2 = 0.5 * (twice_area(first) + twice_area(second))
    angle_deg = np.degrees(np.arctan2(np.abs(edge[:, 1]), np.abs(edge[:, 0])))
    return length_m, area_m2, angle_deg / 45.0


def rest_angles(mesh: ClothMesh, curvature_per_m: float) -> np.ndarray:
    """Dihedral angles at rest of a sheet that is a cylinder about u, shape (H,).

    Positive curvature curls towards the face's normal. The sheet turns by curvature times the
    distance between the faces' centres, along v.
    """
    length, area, _ = hinge_geometry(mesh)
    edge = np.diff(mesh.rest_uv_m[mesh.hinges[:, :2]], axis=1)[:, 0]
    across = np.abs(edge[:, 0]) / length
    height = 2 * area / length / 2  # the mean of the two faces' heights over the edge
    return curvature_per_m * height * across**2


@wp.func
def dihedral_angle(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> wp.float64:
    """Angle between the normals of faces (x0, x1, x2) and (x1, x0, x3), 0 where flat."""
    e = x1 - x0
    n0 = wp.cross(e, x2 - x0)
    n1 = wp.cross(x3 - x0, e)
    return wp.atan2(wp.dot(wp.cross(n0, n1), wp.normalize(e)), wp.dot(n0, n1))


@wp.func
def hinge_stiffness(
    table: wp.array(dtype=wp.float64, ndim=2),
    member: int,
    direction: wp.float64,
    curvature: wp.float64,
) -> wp.float64:
    row = wp.min(int(direction), 1)
    fr = direction - wp.float64(row)
    row += FOLD_DIRECTIONS * member
    position = wp.min(curvature * PER_CURVATURE, wp.float64(4.0))
    column = wp.min(int(position), 3)
    fc = position - wp.float64(column)
    low = table[row, column] * (ONE - fc) + table[row, column + 1] * fc
    high = table[row + 1, column] * (ONE - fc) + table[row + 1, column + 1] * fc
    return wp.max(low * (ONE - fr) + high * fr, ZERO)


@wp.func
def hinge_tangent_stiffness(
    table: wp.array(dtype=wp.float64, ndim=2),
    member: int,
    direction: wp.float64,
    curvature: wp.float64,
) -> wp.float64:
    """d(ke alpha)/d alpha, kept positive."""
    ke = hinge_stiffness(table, member, direction, curvature)
    tangent = ke
    if curvature * PER_CURVATURE < wp.float64(4.0):
        row = wp.min(int(direction), 1)
        fr = direction - wp.float64(row)
        row += FOLD_DIRECTIONS * member
        column = wp.min(int(curvature * PER_CURVATURE), 3)
        low = table[row, column + 1] - table[row, column]
        high = table[row + 1, column + 1] - table[row + 1, column]
        tangent = ke + (low * (ONE - fr) + high * fr) * PER_CURVATURE * curvature
    return wp.max(tangent, wp.float64(0.1) * ke)


@wp.kernel
def dihedral_angles(
    active: wp.array(dtype=wp.int32),
    members: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3d),
    hinges: wp.array(dtype=wp.int32, ndim=2),
    theta: wp.array(dtype=wp.float64),
):
    """Dihedral angle of each hinge, in radians."""
    h = wp.tid()
    if active[members[h]] == 0:
        return
    theta[h] = dihedral_angle(x[hinges[h, 0]], x[hinges[h, 1]], x[hinges[h, 2]], x[hinges[h, 3]])


@wp.func
def angle_gradient(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> mat43d:
    """Gradient of the dihedral angle: a row a vertex, in 1/m."""
    e = x1 - x0
    ll = wp.dot(e, e)
    length = wp.sqrt(ll)
    n0 = wp.cross(e, x2 - x0)
    n1 = wp.cross(x3 - x0, e)
    g2 = -n0 * (length / wp.dot(n0, n0))
    g3 = -n1 * (length / wp.dot(n1, n1))
    t2 = wp.dot(x2 - x0, e) / ll
    t3 = wp.dot(x3 - x0, e) / ll
    g0 = -(g2 * (ONE - t2) + g3 * (ONE - t3))
    g1 = -(g2 * t2 + g3 * t3)
    return wp.matrix_from_rows(g0, g1, g2, g3)


@wp.kernel
def bending_force(
    active: wp.array(dtype=wp.int32),
    members: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3d),
    hinges: wp.array(dtype=wp.int32, ndim=2),
    length: wp.array(dtype=wp.float64),
    area: wp.array(dtype=wp.float64),
    direction: wp.array(dtype=wp.float64),
    rest_angle: wp.array(dtype=wp.float64),
    table: wp.array(dtype=wp.float64, ndim=2),
    angle_before: wp.array(dtype=wp.float64),
    stiffness_of_start: wp.array(dtype=wp.int32),
    damping_ratio: wp.array(dtype=wp.float64),
    minus_force: wp.array(dtype=wp.vec3d),
):
    """Add minus the elastic and viscous nodal forces of each hinge."""
    h = wp.tid()
    member = members[h]
    if active[member] == 0:
        return
    x0 = x[hinges[h, 0]]
    x1 = x[hinges[h, 1]]
    x2 = x[hinges[h, 2]]
    x3 = x[hinges[h, 3]]
    theta = dihedral_angle(x0, x1, x2, x3)
    bent = theta
    if stiffness_of_start[member] == 1:
        bent = angle_before[h]
    curvature = wp.abs(bent) * length[h] / (wp.float64(2.0) * area[h])
    c = hinge_stiffness(table, member, direction[h], curvature) * length[h] * length[h]
    c = c / (wp.float64(4.0) * area[h])
    viscous = damping_ratio[member] * (theta - angle_before[h])
    moment = c * (theta - rest_angle[h] + viscous)
    d = angle_gradient(x0, x1, x2, x3)
    for a in range(4):
        wp.atomic_add(minus_force, hinges[h, a], d[a] * moment)


@wp.kernel
def bending_stiffness(
    active: wp.array(dtype=wp.int32),
    members: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3d),
    hinges: wp.array(dtype=wp.int32, ndim=2),
    length: wp.array(dtype=wp.float64),
    area: wp.array(dtype=wp.float64),
    direction: wp.array(dtype=wp.float64),
    table: wp.array(dtype=wp.float64, ndim=2),
    angle_before: wp.array(dtype=wp.float64),
    stiffness_of_start: wp.array(dtype=wp.int32),
    damping_ratio: wp.array(dtype=wp.float64),
    entry: wp.array(dtype=wp.int32, ndim=2),
    values: wp.array(dtype=wp.float64),
    entries: int,
):
    """Add each hinge's stiffness, without the curvature of theta, to the lower triangle."""
    h = wp.tid()
    member = members[h]
    if active[member] == 0:
        return
    x0 = x[hinges[h, 0]]
    x1 = x[hinges[h, 1]]
    x2 = x[hinges[h, 2]]
    x3 = x[hinges[h, 3]]
    per_angle = length[h] / (wp.float64(2.0) * area[h])
    if stiffness_of_start[member] == 1:
        ke = hinge_stiffness(table, member, direction[h], wp.abs(angle_before[h]) * per_angle)
    else:
        theta = dihedral_angle(x0, x1, x2, x3)
        ke = hinge_tangent_stiffness(table, member, direction[h], wp.abs(theta) * per_angle)
    c = ke * length[h] * length[h]
    c = c / (wp.float64(4.0) * area[h]) * (ONE + damping_ratio[member])
    d = angle_gradient(x0, x1, x2, x3)
    local = h - member * entry.shape[0]
    first = member * entries
    for a in range(4):
        for b in range(4):
            for p in range(3):
                for q in range(3):
                    e = entry[local, (a * 3 + p) * 12 + b * 3 + q]
                    if e >= 0:
                        wp.atomic_add(values, first + e, c * d[a, p] * d[b, q])
