"""Distances between vertices, edges and triangles, and when moving ones meet (Warp functions).

A pair is four nodes and a kind: a vertex and a triangle (nodes v; a, b, c), or two edges
(nodes a, b; c, d). Either has two parameters that say which material points face each other:
the triangle's barycentric coordinates of b and c, or the position along each edge. Closest
points after Ericson, Real-Time Collision Detection (2005), ch. 5; the bound on the motion that
keeps a pair apart is additive advancement (Li, Kaufman and Jiang, ACM TOG 40(4), 2021).
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

VERTEX_TRIANGLE = wp.constant(0)
EDGE_EDGE = wp.constant(1)

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
TINY = wp.constant(wp.float64(1e-30))
KEPT = wp.constant(wp.float64(0.1))  # part of the distance that advancement keeps
ADVANCES_MAX = wp.constant(200)


@wp.struct
class Corners:
    """Positions of the four nodes of a pair."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    d: wp.vec3d


@wp.func
def corners_of(x: wp.array(dtype=wp.vec3d), nodes: wp.vec4i) -> Corners:
    p = Corners()
    p.a = x[nodes[0]]
    p.b = x[nodes[1]]
    p.c = x[nodes[2]]
    p.d = x[nodes[3]]
    return p


@wp.func
def closest_on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec2d:
    """Barycentric coordinates (of b, of c) of the triangle's point nearest to p."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= ZERO and d2 <= ZERO:
        return wp.vec2d(ZERO, ZERO)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= ZERO and d4 <= d3:
        return wp.vec2d(ONE, ZERO)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= ZERO and d5 <= d6:
        return wp.vec2d(ZERO, ONE)
    vc = d1 * d4 - d3 * d2
    if vc <= ZERO and d1 >= ZERO and d3 <= ZERO:
        return wp.vec2d(d1 / (d1 - d3), ZERO)
    vb = d5 * d2 - d1 * d6
    if vb <= ZERO and d2 >= ZERO and d6 <= ZERO:
        return wp.vec2d(ZERO, d2 / (d2 - d6))
    va = d3 * d6 - d5 * d4
    if va <= ZERO and d4 - d3 >= ZERO and d5 - d6 >= ZERO:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec2d(ONE - w, w)
    total = va + vb + vc
    return wp.vec2d(vb / total, vc / total)


@wp.func
def closest_on_edges(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, d: wp.vec3d) -> wp.vec2d:
    """Positions along ab and along cd (0...1) of the two points nearest to each other."""
    u = b - a
    v = d - c
    r = a - c
    uu = wp.dot(u, u)
    vv = wp.dot(v, v)
    uv = wp.dot(u, v)
    ur = wp.dot(u, r)
    vr = wp.dot(v, r)
    determinant = uu * vv - uv * uv
    s = ZERO
    if determinant > wp.float64(1e-12) * uu * vv:
        s = wp.clamp((uv * vr - ur * vv) / determinant, ZERO, ONE)
    t = (uv * s + vr) / vv
    if t < ZERO:
        t = ZERO
        s = wp.clamp(-ur / uu, ZERO, ONE)
    elif t > ONE:
        t = ONE
        s = wp.clamp((uv - ur) / uu, ZERO, ONE)
    return wp.vec2d(s, t)


@wp.func
def closest(kind: int, p: Corners) -> wp.vec2d:
    if kind == VERTEX_TRIANGLE:
        return closest_on_triangle(p.a, p.b, p.c, p.d)
    return closest_on_edges(p.a, p.b, p.c, p.d)


@wp.func
def weights(kind: int, at: wp.vec2d) -> wp.vec4d:
    """Of the nodes in the vector from the second side's point to the first side's."""
    if kind == VERTEX_TRIANGLE:
        return wp.vec4d(ONE, at[0] + at[1] - ONE, -at[0], -at[1])
    return wp.vec4d(ONE - at[0], at[0], at[1] - ONE, -at[1])


@wp.func
def between(p: Corners, w: wp.vec4d) -> wp.vec3d:
    return w[0] * p.a + w[1] * p.b + w[2] * p.c + w[3] * p.d


@wp.func
def slide(kind: int, p: Corners, change: wp.vec2d) -> wp.vec3d:
    """Derivative of the vector between the points with respect to their parameters."""
    if kind == VERTEX_TRIANGLE:
        return change[0] * (p.b - p.c) + change[1] * (p.b - p.d)
    return change[0] * (p.b - p.a) - change[1] * (p.d - p.c)


@wp.func
def distance(kind: int, p: Corners) -> wp.float64:
    return wp.length(between(p, weights(kind, closest(kind, p))))


@wp.func
def largest_approach(kind: int, move: Corners) -> wp.float64:
    """Bound on how much nearer the two sides come, the pair's common motion left out."""
    mean = (move.a + move.b + move.c + move.d) * wp.float64(0.25)
    a = wp.length(move.a - mean)
    b = wp.length(move.b - mean)
    c = wp.length(move.c - mean)
    d = wp.length(move.d - mean)
    if kind == VERTEX_TRIANGLE:
        return a + wp.max(b, wp.max(c, d))
    return wp.max(a, b) + wp.max(c, d)


@wp.func
def advanced(p: Corners, move: Corners, part: wp.float64) -> Corners:
    q = Corners()
    q.a = p.a + part * move.a
    q.b = p.b + part * move.b
    q.c = p.c + part * move.c
    q.d = p.d + part * move.d
    return q


@wp.func
def clear_part(kind: int, p: Corners, move: Corners) -> wp.float64:
    """Part of a straight motion, at most 1, before the sides have come almost together.

    Up to it the distance never falls under a tenth of what it was.
    """
    approach = largest_approach(kind, move)
    gap = distance(kind, p)
    if approach <= (ONE - KEPT) * gap:
        return ONE
    keep = KEPT * gap
    part = wp.float64(0.0)
    for _ in range(ADVANCES_MAX):
        step = (gap - keep) / approach
        if part + step >= ONE:
            return ONE
        part += step
        gap = distance(kind, advanced(p, move, part))
        if gap <= keep * wp.float64(1.05) + TINY:
            return part
    return part
