"""Inertia, gravity, and contact with the floor z = 0 under Coulomb friction (Warp kernels).

Normal contact is a stiff penalty (micrometres of penetration under the cloth's weight).
Friction is exact Amontons-Coulomb by return mapping: a node in contact hangs on an anchor by a
stiff tangential spring; below the threshold |Q| < mu P the anchor does not move (no creep,
microslip of about a micrometre that is elastic and returns), at the threshold the force is
mu P against the motion and the anchor is dragged along. Simo and Hughes, Computational
Inelasticity (1998), ch. 1 (return mapping); Wriggers, Computational Contact Mechanics (2006).
"""

from __future__ import annotations

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


@wp.kernel
def node_residual(
    x: wp.array(dtype=wp.vec3d),
    inertial_target: wp.array(dtype=wp.vec3d),
    mass: wp.array(dtype=wp.float64),
    inverse_step_squared: wp.array(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
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
    if p[2] < ZERO:
        normal_force = -normal_stiffness * p[2]
        q = (wp.vec2d(p[0], p[1]) - anchor[i]) * tangential_stiffness
        size = wp.length(q)
        limit = friction_limit(friction[i], normal_force)
        s = STICK
        if size > limit:
            s = SLIP
            q = q * (limit / size)
        r += wp.vec3d(q[0], q[1], -normal_force)
    state[i] = s
    residual[i] = wp.cw_mul(r, free[i])


@wp.kernel
def node_stiffness(
    x: wp.array(dtype=wp.vec3d),
    mass: wp.array(dtype=wp.float64),
    inverse_step_squared: wp.array(dtype=wp.float64),
    anchor: wp.array(dtype=wp.vec2d),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.array(dtype=wp.float64),
    entry: wp.array(dtype=wp.int32, ndim=2),
    values: wp.array(dtype=wp.float64),
):
    """Add inertia and the symmetric part of contact to the diagonal blocks.

    ``entry`` holds, per node, the places of (xx, yx, yy, zz) in the lower triangle.
    """
    i = wp.tid()
    p = x[i]
    m = mass[i] * inverse_step_squared[0]
    xx = m
    yx = ZERO
    yy = m
    zz = m
    if p[2] < ZERO:
        zz += normal_stiffness
        d = wp.vec2d(p[0], p[1]) - anchor[i]
        size = wp.length(d)
        limit = friction_limit(friction[i], -normal_stiffness * p[2])
        if size * tangential_stiffness <= limit:
            xx += tangential_stiffness
            yy += tangential_stiffness
        else:
            d = d / size
            k = limit / size
            xx += k * (ONE - d[0] * d[0])
            yx -= k * d[0] * d[1]
            yy += k * (ONE - d[1] * d[1])
    for c in range(4):
        e = entry[i, c]
        if e >= 0:
            v = xx
            if c == 1:
                v = yx
            if c == 2:
                v = yy
            if c == 3:
                v = zz
            values[e] = values[e] + v


@wp.kernel
def move_anchors(
    x: wp.array(dtype=wp.vec3d),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.array(dtype=wp.float64),
    anchor: wp.array(dtype=wp.vec2d),
):
    """After an accepted step: anchors of slipping nodes follow, those of open nodes reset."""
    i = wp.tid()
    p = x[i]
    here = wp.vec2d(p[0], p[1])
    if p[2] < ZERO:
        d = here - anchor[i]
        size = wp.length(d)
        reach = friction_limit(friction[i], -normal_stiffness * p[2]) / tangential_stiffness
        if size > reach:
            anchor[i] = here - d * (reach / size)
    else:
        anchor[i] = here
