"""Which vertices, edges and triangles of the cloth come near each other, and when they meet.

A pair is four nodes and a kind: a vertex and a triangle (nodes v; a, b, c), or two edges
(nodes a, b; c, d). Either has two parameters that say which material points face each other:
the triangle's barycentric coordinates of b and c, or the position along each edge. Closest
points after Ericson, Real-Time Collision Detection (2005), ch. 5; the bound on the motion that
keeps a pair apart is additive advancement (Li, Kaufman and Jiang, ACM TOG 40(4), 2021). Near pairs
are found with bounding-box trees.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from slipstitch.base.errors import NotConverged

wp.set_module_options({"enable_backward": False})

VERTEX_TRIANGLE = wp.constant(0)
EDGE_EDGE = wp.constant(1)

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
TINY = wp.constant(wp.float64(1e-30))
KEPT = wp.constant(wp.float64(0.1))  # part of the distance that advancement keeps
ADVANCES_MAX = wp.constant(200)
PAIRS_MAX = 1_000_000  # nearer than asked for: more, 3 GB in the tangent, is an error
Corners = wp.types.matrix(shape=(4, 3), dtype=wp.float64)  # rows: the four nodes of a pair


@wp.func
def corners_of(x: wp.array(dtype=wp.vec3d), nodes: wp.vec4i) -> Corners:
    return wp.matrix_from_rows(x[nodes[0]], x[nodes[1]], x[nodes[2]], x[nodes[3]])


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
        return closest_on_triangle(p[0], p[1], p[2], p[3])
    return closest_on_edges(p[0], p[1], p[2], p[3])


@wp.func
def weights(kind: int, at: wp.vec2d) -> wp.vec4d:
    """Of the nodes in the vector from the second side's point to the first side's."""
    if kind == VERTEX_TRIANGLE:
        return wp.vec4d(ONE, at[0] + at[1] - ONE, -at[0], -at[1])
    return wp.vec4d(ONE - at[0], at[0], at[1] - ONE, -at[1])


@wp.func
def between(p: Corners, w: wp.vec4d) -> wp.vec3d:
    return w[0] * p[0] + w[1] * p[1] + w[2] * p[2] + w[3] * p[3]


@wp.func
def slide(kind: int, p: Corners, change: wp.vec2d) -> wp.vec3d:
    """Derivative of the vector between the points with respect to their parameters."""
    if kind == VERTEX_TRIANGLE:
        return change[0] * (p[1] - p[2]) + change[1] * (p[1] - p[3])
    return change[0] * (p[1] - p[0]) - change[1] * (p[3] - p[2])


@wp.func
def distance(kind: int, p: Corners) -> wp.float64:
    return wp.length(between(p, weights(kind, closest(kind, p))))


@wp.func
def largest_approach(kind: int, move: Corners) -> wp.float64:
    """Bound on how much nearer the two sides come, the pair's common motion left out."""
    mean = (move[0] + move[1] + move[2] + move[3]) * wp.float64(0.25)
    a = wp.length(move[0] - mean)
    b = wp.length(move[1] - mean)
    c = wp.length(move[2] - mean)
    d = wp.length(move[3] - mean)
    if kind == VERTEX_TRIANGLE:
        return a + wp.max(b, wp.max(c, d))
    return wp.max(a, b) + wp.max(c, d)


@wp.func
def clear_part(kind: int, p: Corners, move: Corners) -> wp.float64:
    """Part of a straight motion before the distance falls to a tenth of what it was."""
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
        gap = distance(kind, p + move * part)
        if gap <= keep * wp.float64(1.05) + TINY:
            return part
    return part


@wp.kernel
def swept_boxes(
    x: wp.array(dtype=wp.vec3d),
    move: wp.array(dtype=wp.vec3d),
    elements: wp.array(dtype=wp.int32, ndim=2),
    inflation: wp.float64,
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    """Boxes around elements on their whole way."""
    i = wp.tid()
    low = x[elements[i, 0]]
    high = low
    for k in range(elements.shape[1]):
        p = x[elements[i, k]]
        q = p + move[elements[i, k]]
        low = wp.min(low, wp.min(p, q))
        high = wp.max(high, wp.max(p, q))
    out = wp.vec3d(inflation, inflation, inflation)
    lower[i] = wp.vec3(low - out)
    upper[i] = wp.vec3(high + out)


@wp.func
def shares_node(n: wp.vec4i, kind: int) -> bool:
    if kind == VERTEX_TRIANGLE:
        return n[0] == n[1] or n[0] == n[2] or n[0] == n[3]
    return n[0] == n[2] or n[0] == n[3] or n[1] == n[2] or n[1] == n[3]


@wp.kernel
def near_pairs(
    bvh: wp.uint64,
    kind: int,
    x: wp.array(dtype=wp.vec3d),
    move: wp.array(dtype=wp.vec3d),
    reach: wp.float64,
    first: wp.array(dtype=wp.int32, ndim=2),
    second: wp.array(dtype=wp.int32, ndim=2),
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
    pairs: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=wp.int32),
):
    """List pairs that come nearer than reach on their way; count also those without room."""
    i = wp.tid()
    query = wp.bvh_query_aabb(bvh, lower[i], upper[i])
    j = wp.int32(0)
    while wp.bvh_query_next(query, j):
        n = wp.vec4i()
        apart = True
        if kind == VERTEX_TRIANGLE:
            n = wp.vec4i(first[i, 0], second[j, 0], second[j, 1], second[j, 2])
        else:
            n = wp.vec4i(first[i, 0], first[i, 1], second[j, 0], second[j, 1])
            apart = j > i
        if apart and not shares_node(n, kind):
            bound = reach + largest_approach(kind, corners_of(move, n))
            if distance(kind, corners_of(x, n)) < bound:
                at = wp.atomic_add(count, 0, 1)
                if at < pairs.shape[0]:
                    pairs[at] = wp.vec2i(i, j)


class NearPairs:
    """Search among the parts of one mesh; a key is a pair's row in the table of all pairs."""

    def __init__(self, faces: np.ndarray, vertex_count: int, device: str):
        self.faces, self.edges = faces, edges_of(faces)
        self.device = device
        self._boundary = vertex_count * len(faces)

        def boxes(elements):
            table = np.ascontiguousarray(elements, dtype=np.int32)
            return _Boxes(wp.array(table, device=device), device)

        self._vertex_boxes = boxes(np.arange(vertex_count)[:, None])
        self._face_boxes = boxes(faces)
        self._edge_boxes, self._edge_ways = boxes(self.edges), boxes(self.edges)
        self._pairs = wp.zeros(4096, dtype=wp.vec2i, device=device)
        self._count = wp.zeros(1, dtype=wp.int32, device=device)

    def search(self, x: wp.array, move: wp.array, reach_m: float) -> np.ndarray:
        """Keys, increasing, of the pairs that come nearer than reach on a straight motion."""
        for box in (self._face_boxes, self._edge_boxes):
            box.enclose(x, move, 0.0)
        for box in (self._vertex_boxes, self._edge_ways):
            box.enclose(x, move, reach_m)
        among = [
            (VERTEX_TRIANGLE, self._vertex_boxes, self._face_boxes),
            (EDGE_EDGE, self._edge_ways, self._edge_boxes),
        ]
        vertices, edges = (self._search(*parts, x, move, reach_m) for parts in among)
        keys = np.concatenate([vertices, edges + self._boundary])
        keys.sort()
        return keys

    def _search(self, kind, first, second, x, move, reach_m: float) -> np.ndarray:
        while True:
            self._count.zero_()
            boxes = first.elements, second.elements, first.lower, first.upper
            inputs = [second.tree(), kind, x, move, reach_m, *boxes, self._pairs, self._count]
            wp.launch(near_pairs, len(first.elements), inputs=inputs, device=self.device)
            count = int(self._count.numpy()[0])
            if count > PAIRS_MAX:
                raise NotConverged(
                    f"self-contact: {count} pairs closer than {1e3 * reach_m:g} mm; at most "
                    f"{PAIRS_MAX}"
                )
            if count <= self._pairs.shape[0]:
                pairs = self._pairs.numpy()[:count].astype(np.int64)
                return pairs[:, 0] * second.elements.shape[0] + pairs[:, 1]
            self._pairs = wp.zeros(2 * count, dtype=wp.vec2i, device=self.device)

    def nodes_and_kinds(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes, shape (P, 4), and kinds of the pairs of given keys."""
        split = int(np.searchsorted(keys, self._boundary))
        vertex, face = np.divmod(keys[:split], len(self.faces))
        one, other = np.divmod(keys[split:] - self._boundary, len(self.edges))
        nodes = [
            np.column_stack([vertex, self.faces[face]]),
            np.column_stack([self.edges[one], self.edges[other]]),
        ]
        kinds = np.full(len(keys), EDGE_EDGE, dtype=np.int32)
        kinds[:split] = VERTEX_TRIANGLE
        return np.concatenate(nodes).astype(np.int32), kinds


@dataclass
class _Boxes:
    """Bounding boxes of elements, in single precision as Warp's trees have them."""

    elements: wp.array
    device: str

    def __post_init__(self):
        count = self.elements.shape[0]
        self.lower = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self.upper = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self._tree: wp.Bvh | None = None

    def enclose(self, x: wp.array, move: wp.array, inflation_m: float) -> None:
        rounding_m = 1e-6  # of single precision, at metres
        inflation_m += rounding_m
        inputs = [x, move, self.elements, inflation_m, self.lower, self.upper]
        wp.launch(swept_boxes, len(self.elements), inputs=inputs, device=self.device)

    def tree(self) -> wp.uint64:
        if self._tree is None:
            self._tree = wp.Bvh(self.lower, self.upper)
        else:
            self._tree.refit()
        return self._tree.id


def edges_of(faces: np.ndarray) -> np.ndarray:
    """Edges of a triangle mesh, each once, shape (E, 2)."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(ends, axis=0).astype(np.int32)
