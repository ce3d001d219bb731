"""Contact of the cloth with itself: which parts are near, their forces, their friction.

Every vertex-triangle and edge-edge pair nearer than the thickness is pushed apart along the line
between the closest points with k (d0 - d) d0/d, which grows without bound as the distance d goes to
zero; parallel edges, whose closest points are not unique, are faded out (their ends are
vertex-triangle pairs). Friction is exact Coulomb by return mapping, as on the floor, between the
material points of the two sides that met: a pair that turns as a whole does not slip.

No passing through: a step is accepted only if the straight motion from its start to its end keeps
every pair apart (additive advancement), near pairs being searched for along all of that motion.
"""

import numpy as np
import warp as wp

from slipstitch.physics.cloth import proximity
from slipstitch.physics.cloth.friction import kept_pull, returned_force, returned_stiffness
from slipstitch.physics.cloth.mesh import ClothMesh
from slipstitch.physics.cloth.proximity import Corners, NearPairs, corners_of
from slipstitch.physics.cloth.tangent import Entries, add_entry

wp.set_module_options({"enable_backward": False})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
# Squared sine of the angle between edges under which their force fades (about 1.8 degrees).
PARALLEL = wp.constant(wp.float64(1e-3))


@wp.struct
class Pairs:
    """The pairs that are near, what they remember, and the law between them."""

    nodes: wp.array(dtype=wp.vec4i)
    kinds: wp.array(dtype=wp.int32)
    anchors: wp.array(dtype=wp.vec2d)  # the material points that met
    thicknesses: wp.array(dtype=wp.float64)
    stiffness: wp.float64  # normal and tangential
    friction: wp.float64


@wp.struct
class Touch:
    """A pair's closest points and normal force."""

    at: wp.vec2d
    weight: wp.vec4d
    normal: wp.vec3d
    force: wp.float64  # 0 where the sides do not touch
    stiffness: wp.float64


@wp.func
def touch(pairs: Pairs, i: int, p: Corners) -> Touch:
    pair = Touch()
    kind, thickness = pairs.kinds[i], pairs.thicknesses[i]
    pair.at = proximity.closest(kind, p)
    pair.weight = proximity.weights(kind, pair.at)
    apart = proximity.between(p, pair.weight)
    gap = wp.length(apart)
    pair.force = ZERO
    if gap < thickness:
        fade = ONE
        if kind == proximity.EDGE_EDGE:
            u = p[1] - p[0]
            v = p[3] - p[2]
            sine = wp.length_sq(wp.cross(u, v)) / (wp.length_sq(u) * wp.length_sq(v))
            if sine < PARALLEL:
                part = sine / PARALLEL
                fade = part * (wp.float64(2.0) - part)
        pair.normal = apart / gap
        pair.force = fade * pairs.stiffness * (thickness - gap) * thickness / gap
        pair.stiffness = fade * pairs.stiffness * thickness * thickness / (gap * gap)
    return pair


@wp.func
def stretched(pairs: Pairs, i: int, p: Corners, pair: Touch) -> wp.vec3d:
    """Vector along the surface between the material points that met."""
    change = proximity.slide(pairs.kinds[i], p, pairs.anchors[i] - pair.at)
    return change - wp.dot(change, pair.normal) * pair.normal


@wp.kernel
def self_contact_force(
    x: wp.array(dtype=wp.vec3d), pairs: Pairs, minus_force: wp.array(dtype=wp.vec3d)
):
    i = wp.tid()
    n = pairs.nodes[i]
    p = corners_of(x, n)
    pair = touch(pairs, i, p)
    if pair.force == ZERO:
        return
    q = pairs.stiffness * stretched(pairs, i, p, pair)
    push = returned_force(q, pairs.friction * pair.force) - pair.force * pair.normal
    for k in range(4):
        wp.atomic_add(minus_force, n[k], pair.weight[k] * push)


@wp.kernel
def self_contact_stiffness(x: wp.array(dtype=wp.vec3d), pairs: Pairs, entries: Entries):
    """Add the symmetric part of the contact's stiffness, where `Tangent.couple` made room."""
    i = wp.tid()
    n = pairs.nodes[i]
    p = corners_of(x, n)
    pair = touch(pairs, i, p)
    if pair.force == ZERO:
        return
    d = stretched(pairs, i, p, pair)
    size = wp.length(d)
    across = wp.outer(pair.normal, pair.normal)
    surface = wp.identity(n=3, dtype=wp.float64) - across
    sideways = surface - wp.outer(d, d) / (size * size)
    limit = pairs.friction * pair.force
    stiffness = (
        returned_stiffness(size, surface, sideways, pairs.stiffness, limit)
        + pair.stiffness * across
    )
    for a in range(4):
        for b in range(4):
            w = pair.weight[a] * pair.weight[b]
            for r in range(3):
                for c in range(3):
                    add_entry(entries, i, (a * 3 + r) * 12 + b * 3 + c, w * stiffness[r, c])


@wp.kernel
def move_self_anchors(
    x: wp.array(dtype=wp.vec3d), pairs: Pairs, touching: wp.array(dtype=wp.int32)
):
    """After an accepted step: slipping pairs drag their memory along, open ones forget."""
    i = wp.tid()
    p = corners_of(x, pairs.nodes[i])
    pair = touch(pairs, i, p)
    touching[i] = 0
    if pair.force == ZERO:
        pairs.anchors[i] = pair.at
        return
    touching[i] = 1
    pull = stretched(pairs, i, p, pair)
    kept = kept_pull(wp.length(pull), pairs.stiffness, pairs.friction * pair.force)
    if kept < ONE:
        pairs.anchors[i] = pair.at + (pairs.anchors[i] - pair.at) * kept


@wp.kernel
def begin_pairs(
    x: wp.array(dtype=wp.vec3d), rest: wp.array(dtype=wp.vec3d), pairs: Pairs, thickness: wp.float64
):
    """Give pairs their thickness, and new ones, whose memory is NaN, the points that meet now.

    It is the cloth's; for neighbours in the sheet at most half their distance at rest.
    """
    i = wp.tid()
    kind, n = pairs.kinds[i], pairs.nodes[i]
    apart = proximity.distance(kind, corners_of(rest, n))
    pairs.thicknesses[i] = wp.min(thickness, wp.float64(0.5) * apart)
    if wp.isnan(pairs.anchors[i][0]):
        pairs.anchors[i] = proximity.closest(kind, corners_of(x, n))


@wp.kernel
def clear_parts(
    x: wp.array(dtype=wp.vec3d),
    move: wp.array(dtype=wp.vec3d),
    pairs: Pairs,
    part: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    n = pairs.nodes[i]
    part[i] = proximity.clear_part(pairs.kinds[i], corners_of(x, n), corners_of(move, n))


class SelfContact:
    """Contact of one sheet with itself; the stiffness is a pair's, normal and tangential."""

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
        rest = np.column_stack([mesh.rest_uv_m, np.zeros(V)])
        self._rest = wp.array(rest, dtype=wp.vec3d, device=device)
        self._move = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._x = wp.zeros(V, dtype=wp.vec3d, device=device)
        self._near = NearPairs(mesh.faces, V, device)
        self._reference: tuple[np.ndarray, np.ndarray] | None = None
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
        keys = self._near.search(self._x, self._move, self.thickness_m + self.margin_m)
        self._reference = (start.copy(), end.copy())
        if np.array_equal(keys, self._keys):
            return
        anchors = np.full((len(keys), 2), np.nan)
        _, place, earlier = np.intersect1d(
            keys, self._keys, assume_unique=True, return_indices=True
        )
        anchors[place] = self.pairs.anchors.numpy()[earlier]
        self._set_pairs(keys, anchors)

    def _set_pairs(self, keys: np.ndarray, anchors: np.ndarray) -> None:
        self._keys = keys
        self.room: Entries | None = None  # of the list in the tangent
        self.nodes, kinds = self._near.nodes_and_kinds(keys)
        pairs = self.pairs = Pairs()
        pairs.stiffness, pairs.friction = self.stiffness_N_m, self.friction
        pairs.nodes = wp.array(self.nodes, dtype=wp.vec4i, device=self.device)
        pairs.kinds = wp.array(kinds, dtype=wp.int32, device=self.device)
        pairs.anchors = wp.array(anchors, dtype=wp.vec2d, device=self.device)
        pairs.thicknesses = wp.zeros(len(keys), dtype=wp.float64, device=self.device)
        self._touching = wp.zeros(len(keys), dtype=wp.int32, device=self.device)
        self._part = wp.zeros(len(keys), dtype=wp.float64, device=self.device)
        self._launch(begin_pairs, [self._x, self._rest, pairs, self.thickness_m])

    def _launch(self, kernel, inputs: list) -> None:
        if len(self):
            wp.launch(kernel, dim=len(self), inputs=inputs, device=self.device)

    # -- whether a motion passes through --------------------------------------------------

    def clear_part(self, x: np.ndarray, move: np.ndarray) -> float:
        """Part of a straight motion, at most 1, on which no listed pair passes through."""
        if not len(self):
            return 1.0
        self._x.assign(x)
        self._move.assign(move)
        self._launch(clear_parts, [self._x, self._move, self.pairs, self._part])
        return float(self._part.numpy().min())

    # -- forces ---------------------------------------------------------------------------

    def add_forces(self, x: wp.array, minus_force: wp.array) -> None:
        """Add minus the contact's forces at positions x, in N."""
        self._launch(self_contact_force, [x, self.pairs, minus_force])

    def add_stiffness(self, x: wp.array) -> None:
        """Add the contact's stiffness to its room in the tangent, in N/m."""
        self._launch(self_contact_stiffness, [x, self.pairs, self.room])

    def move_anchors(self, x: wp.array) -> int:
        """Update the memory after an accepted step; number of pairs that touch."""
        self._launch(move_self_anchors, [x, self.pairs, self._touching])
        return int(self._touching.numpy().sum())
