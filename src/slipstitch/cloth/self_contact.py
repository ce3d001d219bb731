"""Contact of the cloth with itself: which parts are near, their forces, their friction.

Every vertex-triangle and edge-edge pair nearer than the thickness is pushed apart along the
line between the closest points with k (d0 - d) d0/d, which grows without bound as the distance
d goes to zero; parallel edges, whose closest points are not unique, are faded out (their ends
are vertex-triangle pairs). Friction is exact Coulomb by return mapping, as on the floor: a pair
remembers which material points of its two sides met, and a stiff spring along the surface pulls
them together with at most mu times the normal force; at the limit the memory is dragged along.
Measured in material points, a pair that turns as a whole does not slip.

No passing through: a step is accepted only if the straight motion from its start to its end
keeps every pair apart (additive advancement), near pairs being searched for along the whole of
that motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from slipstitch.cloth.mesh import ClothMesh
from slipstitch.cloth.proximity import (
    EDGE_EDGE,
    VERTEX_TRIANGLE,
    Corners,
    between,
    clear_part,
    closest,
    corners_of,
    distance,
    largest_approach,
    slide,
    weights,
)
from slipstitch.errors import NotConverged

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
# Squared sine of the angle between edges under which their force fades (about 1.8 degrees).
PARALLEL = wp.constant(wp.float64(1e-3))

PAIRS_MAX = 2_000_000  # nearer than the thickness and a margin: more is an error


@wp.struct
class Meeting:
    """A pair's closest points and normal force."""

    at: wp.vec2d
    weight: wp.vec4d
    normal: wp.vec3d
    force: wp.float64  # 0 where the sides do not touch
    stiffness: wp.float64


@wp.func
def meet(kind: int, p: Corners, thickness: wp.float64, normal_stiffness: wp.float64) -> Meeting:
    pair = Meeting()
    pair.at = closest(kind, p)
    pair.weight = weights(kind, pair.at)
    apart = between(p, pair.weight)
    gap = wp.length(apart)
    pair.force = ZERO
    if gap < thickness:
        fade = ONE
        if kind == EDGE_EDGE:
            u = p.b - p.a
            v = p.d - p.c
            sine = wp.length_sq(wp.cross(u, v)) / (wp.length_sq(u) * wp.length_sq(v))
            if sine < PARALLEL:
                part = sine / PARALLEL
                fade = part * (wp.float64(2.0) - part)
        pair.normal = apart / gap
        pair.force = fade * normal_stiffness * (thickness - gap) * thickness / gap
        pair.stiffness = fade * normal_stiffness * thickness * thickness / (gap * gap)
    return pair


@wp.func
def stretched(kind: int, p: Corners, pair: Meeting, anchor: wp.vec2d) -> wp.vec3d:
    """Vector along the surface between the material points that met."""
    change = slide(kind, p, anchor - pair.at)
    return change - wp.dot(change, pair.normal) * pair.normal


@wp.kernel
def self_contact_force(
    x: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    anchors: wp.array(dtype=wp.vec2d),
    thicknesses: wp.array(dtype=wp.float64),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.float64,
    minus_force: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    n = nodes[i]
    p = corners_of(x, n)
    pair = meet(kinds[i], p, thicknesses[i], normal_stiffness)
    if pair.force == ZERO:
        return
    q = tangential_stiffness * stretched(kinds[i], p, pair, anchors[i])
    size = wp.length(q)
    limit = friction * pair.force
    if size > limit:
        q = q * (limit / size)
    push = q - pair.force * pair.normal
    for k in range(4):
        wp.atomic_add(minus_force, n[k], pair.weight[k] * push)


@wp.kernel
def self_contact_stiffness(
    x: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    anchors: wp.array(dtype=wp.vec2d),
    thicknesses: wp.array(dtype=wp.float64),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.float64,
    free: wp.array(dtype=wp.vec3d),
    place: wp.array(dtype=wp.int32, ndim=2),
    column_length: wp.array(dtype=wp.int32, ndim=2),
    values: wp.array(dtype=wp.float64),
):
    """Add the symmetric part of the contact's stiffness.

    ``place`` and ``column_length`` hold, for each of the ten blocks of the lower triangle of
    nodes (as :func:`slipstitch.cloth.tangent.Tangent.blocks` numbers them), where its first
    column's entries start and how long the first column of its nodes is.
    """
    i = wp.tid()
    n = nodes[i]
    p = corners_of(x, n)
    pair = meet(kinds[i], p, thicknesses[i], normal_stiffness)
    if pair.force == ZERO:
        return
    d = stretched(kinds[i], p, pair, anchors[i])
    size = wp.length(d)
    along = wp.identity(n=3, dtype=wp.float64) - wp.outer(pair.normal, pair.normal)
    limit = friction * pair.force
    if size * tangential_stiffness <= limit:
        along = along * tangential_stiffness
    else:
        along = (along - wp.outer(d, d) / (size * size)) * (limit / size)
    stiffness = along + pair.stiffness * wp.outer(pair.normal, pair.normal)
    for a in range(4):
        for b in range(a + 1):
            block = a * (a + 1) // 2 + b
            w = pair.weight[a] * pair.weight[b]
            start = place[i, block]
            length = column_length[i, block]
            free_a = free[n[a]]
            free_b = free[n[b]]
            for c in range(3):
                # Each column of a node is one entry shorter than the one before.
                column = start + c * length - c
                if c == 2:
                    column -= 1
                for r in range(3):
                    if a != b or r >= c:
                        mask = free_a[r] * free_b[c]
                        if n[a] < n[b]:
                            mask = free_a[c] * free_b[r]
                        wp.atomic_add(values, column + r, w * stiffness[r, c] * mask)


@wp.kernel
def move_self_anchors(
    x: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    anchors: wp.array(dtype=wp.vec2d),
    thicknesses: wp.array(dtype=wp.float64),
    normal_stiffness: wp.float64,
    tangential_stiffness: wp.float64,
    friction: wp.float64,
    touching: wp.array(dtype=wp.int32),
):
    """After an accepted step: slipping pairs drag their memory along, open ones forget."""
    i = wp.tid()
    p = corners_of(x, nodes[i])
    pair = meet(kinds[i], p, thicknesses[i], normal_stiffness)
    touching[i] = 0
    if pair.force == ZERO:
        anchors[i] = pair.at
        return
    touching[i] = 1
    size = wp.length(stretched(kinds[i], p, pair, anchors[i]))
    reach = friction * pair.force / tangential_stiffness
    if size > reach:
        anchors[i] = pair.at + (anchors[i] - pair.at) * (reach / size)


@wp.kernel
def closest_points(
    x: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    at: wp.array(dtype=wp.vec2d),
):
    i = wp.tid()
    at[i] = closest(kinds[i], corners_of(x, nodes[i]))


@wp.kernel
def pair_thickness(
    rest: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    thickness: wp.float64,
    thicknesses: wp.array(dtype=wp.float64),
):
    """The cloth's thickness; for neighbours in the sheet at most half their distance at rest."""
    i = wp.tid()
    apart = distance(kinds[i], corners_of(rest, nodes[i]))
    thicknesses[i] = wp.min(thickness, wp.float64(0.5) * apart)


@wp.kernel
def clear_parts(
    x: wp.array(dtype=wp.vec3d),
    move: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    kinds: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    part[i] = clear_part(kinds[i], corners_of(x, nodes[i]), corners_of(move, nodes[i]))


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
    first: wp.array(dtype=wp.int32, ndim=2),
    second: wp.array(dtype=wp.int32, ndim=2),
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
    reach: wp.float64,
    count: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.vec2i),
):
    """List the pairs that come nearer than reach anywhere on their way.

    Counts past the end of ``found`` without writing there.
    """
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
                if at < found.shape[0]:
                    found[at] = wp.vec2i(i, j)


class SelfContact:
    """Contact of one sheet with itself.

    Parameters
    ----------
    mesh : ClothMesh
    thickness_m : float
        Distance at which two layers begin to push each other; well under the mesh's spacing.
    stiffness_N_m : float
        Of one pair, normal and tangential.
    friction : float
        Friction coefficient between layers.
    device : str

    Raises
    ------
    NotConverged
        More than ``PAIRS_MAX`` pairs are near (from :meth:`cover`).
    """

    def __init__(
        self,
        mesh: ClothMesh,
        *,
        thickness_m: float,
        stiffness_N_m: float,
        friction: float,
        device: str,
    ):
        self.thickness_m = thickness_m
        self.margin_m = thickness_m
        self.stiffness_N_m = stiffness_N_m
        self.friction = friction
        self.device = device
        V = mesh.vertex_count

        def table(values):
            return wp.array(np.ascontiguousarray(values, dtype=np.int32), device=device)

        rest = np.column_stack([mesh.rest_uv_m, np.zeros(V)])
        self._rest = wp.array(rest, dtype=wp.vec3d, device=device)
        self._vertices = table(np.arange(V)[:, None])
        self._faces = table(mesh.faces)
        self._faces_host, self._edges_host = mesh.faces, edges_of(mesh.faces)
        self._edges = table(self._edges_host)
        self._move = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._x = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._boxes = {
            "vertices": _Boxes(self._vertices, device),
            "faces": _Boxes(self._faces, device),
            "edges": _Boxes(self._edges, device),
            "near edges": _Boxes(self._edges, device),
        }
        self._trees: dict[str, wp.Bvh] = {}
        self._found = wp.zeros(4096, dtype=wp.vec2i, device=device)
        self._count = wp.zeros(1, dtype=wp.int32, device=device)
        self._reference: tuple[np.ndarray, np.ndarray] | None = None
        self.generation = 0  # counts changes of the list
        self._keys = np.zeros(0, dtype=np.int64)
        self._set_pairs(self._keys, np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self._keys)

    # -- which pairs are near -------------------------------------------------------------

    def covers(self, x: np.ndarray) -> bool:
        """Whether pairs outside the list are farther apart than the thickness at x."""
        if self._reference is None:
            return False
        return any(
            float(np.square(moved - moved.mean(axis=0)).sum(axis=1).max())
            <= (self.margin_m / 2) ** 2
            for moved in (x - place for place in self._reference)
        )

    def cover(self, start: np.ndarray, end: np.ndarray) -> None:
        """List every pair that comes nearer than thickness + margin on a straight motion."""
        self._x.assign(start)
        self._move.assign(end - start)
        reach = self.thickness_m + self.margin_m
        for name, box in self._boxes.items():
            box.enclose(self._x, self._move, reach if name in ("vertices", "near edges") else 0.0)
        keys = np.concatenate(
            [
                self._search(VERTEX_TRIANGLE, self._vertices, "vertices", self._faces, "faces"),
                self._search(EDGE_EDGE, self._edges, "near edges", self._edges, "edges")
                + self._vertices.shape[0] * self._faces.shape[0],
            ]
        )
        keys.sort()
        self._reference = (start.copy(), end.copy())
        if np.array_equal(keys, self._keys):
            return
        anchors = np.full((len(keys), 2), np.nan)
        if len(self._keys) and len(keys):
            place = np.searchsorted(keys, self._keys).clip(max=len(keys) - 1)
            kept = keys[place] == self._keys
            anchors[place[kept]] = self.anchors.numpy()[kept]
        self._set_pairs(keys, anchors)

    def _search(self, kind, first, first_boxes, second, second_boxes) -> np.ndarray:
        boxes = self._boxes[second_boxes]
        if second_boxes not in self._trees:
            self._trees[second_boxes] = wp.Bvh(boxes.lower, boxes.upper)
        else:
            self._trees[second_boxes].refit()
        query = self._boxes[first_boxes]
        while True:
            self._count.zero_()
            wp.launch(
                near_pairs,
                dim=first.shape[0],
                inputs=[
                    self._trees[second_boxes].id,
                    kind,
                    self._x,
                    self._move,
                    first,
                    second,
                    query.lower,
                    query.upper,
                    self.thickness_m + self.margin_m,
                    self._count,
                    self._found,
                ],
                device=self.device,
            )
            count = int(self._count.numpy()[0])
            if count > PAIRS_MAX:
                raise NotConverged(
                    f"self-contact: {count} pairs nearer than "
                    f"{1e3 * (self.thickness_m + self.margin_m):g} mm, at most {PAIRS_MAX}"
                )
            if count <= self._found.shape[0]:
                pairs = self._found.numpy()[:count].astype(np.int64)
                return pairs[:, 0] * second.shape[0] + pairs[:, 1]
            self._found = wp.zeros(2 * count, dtype=wp.vec2i, device=self.device)

    def _set_pairs(self, keys: np.ndarray, anchors: np.ndarray) -> None:
        faces, edges = self._faces_host, self._edges_host
        boundary = self._vertices.shape[0] * len(faces)
        split = int(np.searchsorted(keys, boundary))
        vertex, face = np.divmod(keys[:split], len(faces))
        one, other = np.divmod(keys[split:] - boundary, len(edges))
        self.nodes = np.concatenate(
            [np.column_stack([vertex, faces[face]]), np.column_stack([edges[one], edges[other]])]
        ).astype(np.int32)
        kinds = np.full(len(keys), EDGE_EDGE, dtype=np.int32)
        kinds[:split] = VERTEX_TRIANGLE
        self._keys = keys
        self.generation += 1
        self._nodes = wp.array(self.nodes, dtype=wp.vec4i, device=self.device)
        self._kinds = wp.array(kinds, dtype=wp.int32, device=self.device)
        self.anchors = wp.array(anchors, dtype=wp.vec2d, device=self.device)
        self._touching = wp.zeros(len(keys), dtype=wp.int32, device=self.device)
        self._part = wp.zeros(len(keys), dtype=wp.float64, device=self.device)
        self._thicknesses = wp.zeros(len(keys), dtype=wp.float64, device=self.device)
        if not len(keys):
            return
        pairs = [self._nodes, self._kinds]
        self._launch(pair_thickness, [self._rest, *pairs, self.thickness_m, self._thicknesses])
        fresh = np.isnan(anchors[:, 0])
        if fresh.any():
            here = wp.zeros(len(keys), dtype=wp.vec2d, device=self.device)
            self._launch(closest_points, [self._x, *pairs, here])
            self.anchors.assign(np.where(fresh[:, None], here.numpy(), anchors))

    def _launch(self, kernel, inputs: list) -> None:
        """Launch a kernel over the listed pairs."""
        if len(self):
            wp.launch(kernel, dim=len(self), inputs=inputs, device=self.device)

    # -- whether a motion passes through --------------------------------------------------

    def clear_part(self, x: np.ndarray, move: np.ndarray) -> float:
        """Part of a straight motion, at most 1, on which no listed pair passes through."""
        if not len(self):
            return 1.0
        self._x.assign(x)
        self._move.assign(move)
        self._launch(clear_parts, [self._x, self._move, self._nodes, self._kinds, self._part])
        return float(self._part.numpy().min())

    # -- forces ---------------------------------------------------------------------------

    def _pairs_and_law(self) -> list:
        stiffness = [self.stiffness_N_m, self.stiffness_N_m]
        return [
            *[self._nodes, self._kinds, self.anchors],
            *[self._thicknesses, *stiffness, self.friction],
        ]

    def add_forces(self, x: wp.array, minus_force: wp.array) -> None:
        """Add minus the contact's forces at positions x, in N."""
        self._launch(self_contact_force, [x, *self._pairs_and_law(), minus_force])

    def add_stiffness(self, x, free, place, column_length, values) -> None:
        """Add the contact's stiffness to the entries of the tangent, in N/m."""
        self._launch(
            self_contact_stiffness,
            [x, *self._pairs_and_law(), free, place, column_length, values],
        )

    def move_anchors(self, x: wp.array) -> int:
        """Update the memory after an accepted step; number of pairs that touch."""
        self._launch(move_self_anchors, [x, *self._pairs_and_law(), self._touching])
        return int(self._touching.numpy().sum())


@dataclass
class _Boxes:
    """Bounding boxes of elements, in single precision as Warp's trees have them."""

    elements: wp.array
    device: str

    def __post_init__(self):
        count = self.elements.shape[0]
        self.lower = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self.upper = wp.zeros(count, dtype=wp.vec3, device=self.device)

    def enclose(self, x: wp.array, move: wp.array, inflation_m: float) -> None:
        rounding_m = 1e-6  # of single precision, at metres
        wp.launch(
            swept_boxes,
            dim=self.elements.shape[0],
            inputs=[
                x,
                move,
                self.elements,
                inflation_m + rounding_m,
                self.lower,
                self.upper,
            ],
            device=self.device,
        )


def edges_of(faces: np.ndarray) -> np.ndarray:
    """Edges of a triangle mesh, each once, shape (E, 2)."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(ends, axis=0).astype(np.int32)
