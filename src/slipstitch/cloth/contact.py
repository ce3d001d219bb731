"""Inertia, gravity, and contact with the ground under Coulomb friction (Warp kernels).

The ground is the floor z = 0, or a cylinder about a line along y whose crest is that floor's
line x = 0 (for the capstan): contact is worked out in coordinates along, across and above it.

Normal contact is a stiff penalty (micrometres of penetration under the cloth's weight).
Friction is exact Amontons-Coulomb by return mapping: a node in contact hangs on an anchor by a
stiff tangential spring; below the threshold |Q| < mu P the anchor does not move (no creep,
microslip of about a micrometre that is elastic and returns), at the threshold the force is
mu P against the motion and the anchor is dragged along. Simo and Hughes, Computational
Inelasticity (1998), ch. 1 (return mapping); Wriggers, Computational Contact Mechanics (2006).
"""

from __future__ import annotations

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))

OPEN = wp.constant(0)
STICK = wp.constant(1)
SLIP = wp.constant(2)


@wp.func
def friction_limit(friction: wp.float64, normal_force: wp.float64) -> wp.float64:
    """Largest tangential force that contact can bear: Coulomb's mu P."""
    return friction * normal_force


@wp.struct
class GroundPoint:
    """A point as the ground sees it."""

    place: wp.vec2d  # along and across the ground, in m
    gap: wp.float64  # height above it, in m
    along: wp.vec3d  # unit vectors; the one across is y
    normal: wp.vec3d


@wp.func
def ground_point(p: wp.vec3d, curvature: wp.float64) -> GroundPoint:
    """Coordinates of a point over ground of a given curvature (1/m; 0: the plane z = 0)."""
    point = GroundPoint()
    if curvature == ZERO:
        point.place = wp.vec2d(p[0], p[1])
        point.gap = p[2]
        point.along = wp.vec3d(ONE, ZERO, ZERO)
        point.normal = wp.vec3d(ZERO, ZERO, ONE)
    else:
        radius = ONE / curvature
        up = p[2] + radius
        distance = wp.sqrt(p[0] * p[0] + up * up)
        point.place = wp.vec2d(radius * wp.atan2(p[0], up), p[1])
        point.gap = distance - radius
        point.along = wp.vec3d(up / distance, ZERO, -p[0] / distance)
        point.normal = wp.vec3d(p[0] / distance, ZERO, up / distance)
    return point


def ground_coordinates(x: np.ndarray, curvature: float) -> tuple[np.ndarray, np.ndarray]:
    """Do what `ground_point` does for many points, in NumPy.

    Parameters
    ----------
    x : ndarray, shape (n, 3)
    curvature : float
        Of the ground, in 1/m.

    Returns
    -------
    coordinates : ndarray, shape (n, 3)
        Along, across, above (m).
    frames : ndarray, shape (n, 3, 3)
        Rows: unit vectors along, across, above.
    """
    frames = np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy()
    if curvature == 0:
        return x, frames
    up = x[:, 2] + 1 / curvature
    distance = np.hypot(x[:, 0], up)
    frames[:, 0, 0] = frames[:, 2, 2] = up / distance
    frames[:, 2, 0] = x[:, 0] / distance
    frames[:, 0, 2] = -frames[:, 2, 0]
    angle = np.arctan2(x[:, 0], up)
    coordinates = np.column_stack([angle / curvature, x[:, 1], distance - 1 / curvature])
    return coordinates, frames


@wp.kernel
def node_residual(
    x: wp.array(dtype=wp.vec3d),
    inertial_target: wp.array(dtype=wp.vec3d),
    mass: wp.array(dtype=wp.float64),
    inverse_step_squared: wp.array(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
    curvature: wp.float64,
    anchor: wp.array(dtype=wp.vec2d),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.array(dtype=wp.float64),
    minus_force: wp.array(dtype=wp.vec3d),
    free: wp.array(dtype=wp.vec3d),
    residual: wp.array(dtype=wp.vec3d),
    state: wp.array(dtype=wp.int32),
):
    """Out-of-balance force of each node; reads and clears ``minus_force``."""
    i = wp.tid()
    p = x[i]
    r = minus_force[i] + mass[i] * ((p - inertial_target[i]) * inverse_step_squared[0] - gravity[0])
    minus_force[i] = wp.vec3d()
    s = OPEN
    ground = ground_point(p, curvature)
    if ground.gap < ZERO:
        normal_force = -normal_stiffness * ground.gap
        q = (ground.place - anchor[i]) * tangential_stiffness
        size = wp.length(q)
        limit = friction_limit(friction[i], normal_force)
        s = STICK
        if size > limit:
            s = SLIP
            q = q * (limit / size)
        r += ground.along * q[0] - ground.normal * normal_force + wp.vec3d(ZERO, q[1], ZERO)
    state[i] = s
    residual[i] = wp.cw_mul(r, free[i])


@wp.kernel
def node_stiffness(
    x: wp.array(dtype=wp.vec3d),
    mass: wp.array(dtype=wp.float64),
    inverse_step_squared: wp.array(dtype=wp.float64),
    curvature: wp.float64,
    anchor: wp.array(dtype=wp.vec2d),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.array(dtype=wp.float64),
    entry: wp.array(dtype=wp.int32, ndim=2),
    values: wp.array(dtype=wp.float64),
):
    """Add inertia and the symmetric part of contact to the diagonal blocks.

    ``entry`` holds, per node, the places of (xx, yx, yy, zx, zy, zz) in the lower triangle.
    The turning of a curved ground's normal is left out: it is the penetration over the radius.
    """
    i = wp.tid()
    p = x[i]
    m = mass[i] * inverse_step_squared[0]
    block = wp.identity(n=3, dtype=wp.float64) * m
    ground = ground_point(p, curvature)
    if ground.gap < ZERO:
        along = ground.along
        across = wp.vec3d(ZERO, ONE, ZERO)
        block += wp.outer(ground.normal, ground.normal) * normal_stiffness
        d = ground.place - anchor[i]
        size = wp.length(d)
        limit = friction_limit(friction[i], -normal_stiffness * ground.gap)
        if size * tangential_stiffness <= limit:
            block += (wp.outer(along, along) + wp.outer(across, across)) * tangential_stiffness
        else:
            sideways = (across * d[0] - along * d[1]) / size
            block += wp.outer(sideways, sideways) * (limit / size)
    for row in range(3):
        for column in range(row + 1):
            e = entry[i, row * (row + 1) // 2 + column]
            if e >= 0:
                values[e] = values[e] + block[row, column]


@wp.kernel
def move_anchors(
    x: wp.array(dtype=wp.vec3d),
    curvature: wp.float64,
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.array(dtype=wp.float64),
    anchor: wp.array(dtype=wp.vec2d),
):
    """After an accepted step: anchors of slipping nodes follow, those of open nodes reset."""
    i = wp.tid()
    ground = ground_point(x[i], curvature)
    here = ground.place
    if ground.gap < ZERO:
        d = here - anchor[i]
        size = wp.length(d)
        limit = friction_limit(friction[i], -normal_stiffness * ground.gap)
        reach = limit / tangential_stiffness
        if size > reach:
            anchor[i] = here - d * (reach / size)
    else:
        anchor[i] = here
