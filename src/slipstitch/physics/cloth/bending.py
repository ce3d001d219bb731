"""Bending of the sheet: hinges over inner edges (Warp kernels).

Energy of a hinge: ke l^2 / (8 (a0 + a1)) (theta - theta0)^2, with l the edge's length, a0 and
a1 the areas of its faces at rest, theta the dihedral angle. ke depends on the fold's direction
in the cloth and on the curvature parameter |theta| l / (2 (a0 + a1)), and is frozen in the
force (Wang, O'Brien and Ramamoorthi 2011; Bridson, Marino and Fedkiw 2003; ARCSim).
"""

import numpy as np
import warp as wp

from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.tangent import Entries, add_entry
from slipstitch.physics.fabric import CURVATURE_SPACING_PER_M, FOLD_CURVATURES, ElasticTables

wp.set_module_options({"enable_backward": False})

mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
PER_CURVATURE = wp.constant(wp.float64(1.0 / CURVATURE_SPACING_PER_M))
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))
LAST_NODE = wp.constant(wp.float64(FOLD_CURVATURES - 1))

OF_END = wp.constant(0)
OF_START = wp.constant(1)
STIFFNESS_RULES = {"end": 0, "start": 1, "rising": 2}


def hinge_geometry(mesh: ClothMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rest length l (m), rest area a0 + a1 (m^2), and position in the direction rows (0...2)."""
    start, end, first, second = (mesh.rest_uv_m[mesh.hinges[:, k]] for k in range(4))
    edge = end - start
    length_m = np.linalg.norm(edge, axis=1)

    def twice_area(tip):
        return np.abs(edge[:, 0] * (tip - start)[:, 1] - edge[:, 1] * (tip - start)[:, 0])

    area_m2 = 0.5 * (twice_area(first) + twice_area(second))
    angle_deg = np.degrees(np.arctan2(np.abs(edge[:, 1]), np.abs(edge[:, 0])))
    return length_m, area_m2, angle_deg / 45.0


def rest_angles(mesh: ClothMesh, curvature_per_m: float) -> np.ndarray:
    """Dihedral angles at rest (H,) of a sheet that is a cylinder about u, curled to the normal."""
    length, area, _ = hinge_geometry(mesh)
    edge = np.diff(mesh.rest_uv_m[mesh.hinges[:, :2]], axis=1)[:, 0]
    across = np.abs(edge[:, 0]) / length
    height = 2 * area / length / 2  # the mean of the two faces' heights over the edge
    return curvature_per_m * height * across**2


def hinge_stiffness(mesh: ClothMesh, bending_N_m: np.ndarray) -> np.ndarray:
    """Stiffness ke (N m) of each hinge at the table's curvatures, shape (H, columns)."""
    direction = hinge_geometry(mesh)[2]
    row = np.minimum(direction.astype(int), len(bending_N_m) - 2)
    part = (direction - row)[:, None]
    return np.maximum(bending_N_m[row] * (1 - part) + bending_N_m[row + 1] * part, 0.0)


@wp.struct
class Hinges:
    """The hinges of the sheet and their bending law."""

    nodes: wp.array(dtype=wp.int32, ndim=2)
    per_angle: wp.array(dtype=wp.float64)  # curvature parameter over angle, in 1/m
    shape: wp.array(dtype=wp.float64)  # moment per angle over ke: l^2 / (4 (a0 + a1))
    rest_angle: wp.array(dtype=wp.float64)
    angle_before: wp.array(dtype=wp.float64)  # at the beginning of the step
    stiffness_before: wp.array(dtype=wp.float64)  # ke there, in N m
    table: wp.array(dtype=wp.float64, ndim=2)  # ke (N m) at the curvatures of the table
    stiffness_rule: int  # which curvature in a step ke follows
    damping_ratio: wp.array(dtype=wp.float64)  # one number: damping time over step


def hinges_of(
    mesh: ClothMesh, tables: ElasticTables, damping_ratio: wp.array, device: str
) -> Hinges:
    """Put the hinges of a sheet on a device."""

    def numbers(values):
        return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device)

    length_m, area_m2, _ = hinge_geometry(mesh)
    stiffness_N_m = hinge_stiffness(mesh, tables.bending_N_m)
    hinges = Hinges()
    hinges.nodes = wp.array(mesh.hinges, dtype=wp.int32, device=device)
    hinges.per_angle = numbers(length_m / (2 * area_m2))
    hinges.shape = numbers(length_m**2 / (4 * area_m2))
    hinges.rest_angle = numbers(rest_angles(mesh, tables.rest_curvature_per_m))
    hinges.angle_before = numbers(np.zeros(len(length_m)))
    hinges.table, hinges.stiffness_before = numbers(stiffness_N_m), numbers(stiffness_N_m[:, 0])
    hinges.damping_ratio = damping_ratio
    return hinges


@wp.func
def dihedral_angle(x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> wp.float64:
    """Angle between the normals of faces (x0, x1, x2) and (x1, x0, x3), 0 where flat."""
    e = x1 - x0
    n0 = wp.cross(e, x2 - x0)
    n1 = wp.cross(x3 - x0, e)
    # (n0 x n1) . e = -|e|^2 n0 . (x3 - x0)
    return wp.atan2(-wp.length(e) * wp.dot(n0, x3 - x0), wp.dot(n0, n1))


@wp.func
def stiffness_at(hinges: Hinges, h: int, curvature: wp.float64) -> wp.vec2d:
    """Stiffness ke at a curvature, and its slope there (zero beyond the table)."""
    position = wp.min(curvature * PER_CURVATURE, LAST_NODE)
    column = wp.min(int(position), int(LAST_NODE) - 1)
    part = position - wp.float64(column)
    low = hinges.table[h, column]
    high = hinges.table[h, column + 1]
    slope = ZERO
    if position < LAST_NODE:
        slope = (high - low) * PER_CURVATURE
    return wp.vec2d(low * (ONE - part) + high * part, slope)


@wp.func
def is_between(one: wp.float64, value: wp.float64, other: wp.float64) -> bool:
    """Strictly; whichever of the two is larger."""
    return (value - one) * (other - value) > ZERO


@wp.func
def stiffness_in_step(
    hinges: Hinges, h: int, before: wp.float64, curvature: wp.float64
) -> wp.vec2d:
    """Stiffness and slope at a curvature in a step from another.

    Taken at the start of the step, a stiffness that grows faster than in proportion to curvature
    never settles: under a given moment M the curvature M / ke(curvature before) jumps to and fro.
    Taken at the end, one that falls faster leaves the step without a stable solution nearby. The
    third rule is the end's, but holds the moment where it would fall as curvature grows.
    """
    rule = hinges.stiffness_rule
    if rule == OF_END:
        return stiffness_at(hinges, h, curvature)
    start = hinges.stiffness_before[h]
    if rule == OF_START:
        return wp.vec2d(start, ZERO)
    # The moment's largest value on the way up, its smallest on the way down.
    end = stiffness_at(hinges, h, curvature)
    way = wp.sign(curvature - before)
    held = way * start * before
    first = int(wp.min(before, curvature) * PER_CURVATURE)
    last = int(wp.min(wp.max(before, curvature) * PER_CURVATURE, LAST_NODE))
    for column in range(first, last + 1):
        node, ke = wp.float64(column) / PER_CURVATURE, hinges.table[h, column]
        if is_between(before, node, curvature):
            held = wp.max(held, way * ke * node)
        # Behind a node stiffness is a straight line, the moment a parabola.
        slope = ZERO
        if column < int(LAST_NODE):
            slope = (hinges.table[h, column + 1] - ke) * PER_CURVATURE
        if slope != ZERO:
            top = (node - ke / slope) * HALF
            next_node = node + ONE / PER_CURVATURE
            if is_between(before, top, curvature) and is_between(node, top, next_node):
                held = wp.max(held, way * (ke + slope * (top - node)) * top)
    if held > way * end[0] * curvature and curvature > ZERO:
        stiffness = way * held / curvature
        return wp.vec2d(stiffness, -stiffness / curvature)
    return end


@wp.func
def corners_of(x: wp.array(dtype=wp.vec3d), hinges: Hinges, h: int) -> mat43d:
    """Rows: edge ends, then the vertex opposite in the first and in the second face."""
    return wp.matrix_from_rows(
        x[hinges.nodes[h, 0]], x[hinges.nodes[h, 1]], x[hinges.nodes[h, 2]], x[hinges.nodes[h, 3]]
    )


@wp.kernel
def dihedral_angles(x: wp.array(dtype=wp.vec3d), hinges: Hinges):
    """Note the dihedral angle of each hinge, in radians, and the stiffness there."""
    h = wp.tid()
    p = corners_of(x, hinges, h)
    theta = dihedral_angle(p[0], p[1], p[2], p[3])
    hinges.angle_before[h] = theta
    hinges.stiffness_before[h] = stiffness_at(hinges, h, wp.abs(theta) * hinges.per_angle[h])[0]


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
    x: wp.array(dtype=wp.vec3d), hinges: Hinges, minus_force: wp.array(dtype=wp.vec3d)
):
    """Add minus the elastic and viscous nodal forces of each hinge."""
    h = wp.tid()
    p = corners_of(x, hinges, h)
    theta = dihedral_angle(p[0], p[1], p[2], p[3])
    before = hinges.angle_before[h]
    per_angle = hinges.per_angle[h]
    ke = stiffness_in_step(hinges, h, wp.abs(before) * per_angle, wp.abs(theta) * per_angle)
    c = ke[0] * hinges.shape[h]
    viscous = hinges.damping_ratio[0] * (theta - before)
    moment = c * (theta - hinges.rest_angle[h] + viscous)
    d = angle_gradient(p[0], p[1], p[2], p[3])
    for a in range(4):
        wp.atomic_add(minus_force, hinges.nodes[h, a], d[a] * moment)


@wp.kernel
def bending_stiffness(x: wp.array(dtype=wp.vec3d), hinges: Hinges, entries: Entries):
    """Add each hinge's stiffness, without the curvature of theta, to the lower triangle."""
    h = wp.tid()
    p = corners_of(x, hinges, h)
    per_angle = hinges.per_angle[h]
    theta = dihedral_angle(p[0], p[1], p[2], p[3])
    before = hinges.angle_before[h]
    ke = stiffness_in_step(hinges, h, wp.abs(before) * per_angle, wp.abs(theta) * per_angle)
    viscous = ONE + hinges.damping_ratio[0]
    angle = theta - hinges.rest_angle[h] + hinges.damping_ratio[0] * (theta - before)
    tangent = ke[0] * viscous + ke[1] * per_angle * wp.sign(theta) * angle
    tangent = wp.max(tangent, wp.float64(0.1) * ke[0] * viscous)
    c = tangent * hinges.shape[h]
    d = angle_gradient(p[0], p[1], p[2], p[3])
    for a in range(4):
        for b in range(4):
            for q in range(3):
                for r in range(3):
                    k = (a * 3 + q) * 12 + b * 3 + r
                    add_entry(entries, h, k, c * d[a, q] * d[b, r])
