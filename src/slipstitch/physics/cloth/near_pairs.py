"""Pairs of the cloth's parts that approach each other, found with bounding-box trees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from slipstitch.base.errors import NotConverged
from slipstitch.physics.cloth.proximity import (
    EDGE_EDGE,
    VERTEX_TRIANGLE,
    corners_of,
    distance,
    largest_approach,
)

wp.set_module_options({"enable_backward": False})

PAIRS_MAX = 2_000_000  # nearer than asked for: more is an error


@wp.struct
class Motion:
    """Straight ways of the nodes, and how near to each other parts have to come to be listed."""

    x: wp.array(dtype=wp.vec3d)
    move: wp.array(dtype=wp.vec3d)
    reach: wp.float64


@wp.struct
class Found:
    """Pairs that were found, and how many there are, which may be more than have room."""

    pairs: wp.array(dtype=wp.vec2i)
    count: wp.array(dtype=wp.int32)


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
    motion: Motion,
    first: wp.array(dtype=wp.int32, ndim=2),
    second: wp.array(dtype=wp.int32, ndim=2),
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
    found: Found,
):
    """List the pairs that come nearer than reach anywhere on their way.

    Counts past the end of ``found.pairs`` without writing there.
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
            bound = motion.reach + largest_approach(kind, corners_of(motion.move, n))
            if distance(kind, corners_of(motion.x, n)) < bound:
                at = wp.atomic_add(found.count, 0, 1)
                if at < found.pairs.shape[0]:
                    found.pairs[at] = wp.vec2i(i, j)


class NearPairs:
    """Search among the vertices, triangles and edges of one mesh.

    A pair is named by a key, its row in the table of all possible pairs: first vertices with
    triangles, then edges with edges.

    Parameters
    ----------
    faces : ndarray of int, shape (F, 3)
    vertex_count : int
    device : str
    """

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
        self._found = Found()
        self._found.pairs = wp.zeros(4096, dtype=wp.vec2i, device=device)
        self._found.count = wp.zeros(1, dtype=wp.int32, device=device)

    def search(self, x: wp.array, move: wp.array, reach_m: float) -> np.ndarray:
        """Keys, increasing, of the pairs that come nearer than reach on a straight motion.

        Raises
        ------
        NotConverged
            There are more than ``PAIRS_MAX``.
        """
        for box in (self._face_boxes, self._edge_boxes):
            box.enclose(x, move, 0.0)
        for box in (self._vertex_boxes, self._edge_ways):
            box.enclose(x, move, reach_m)
        among = [
            (VERTEX_TRIANGLE, self._vertex_boxes, self._face_boxes),
            (EDGE_EDGE, self._edge_ways, self._edge_boxes),
        ]
        motion = Motion()
        motion.x, motion.move, motion.reach = x, move, reach_m
        vertices, edges = (self._search(*kind_and_parts, motion) for kind_and_parts in among)
        keys = np.concatenate([vertices, edges + self._boundary])
        keys.sort()
        return keys

    def _search(self, kind, first, second, motion: Motion) -> np.ndarray:
        while True:
            self._found.count.zero_()
            wp.launch(
                near_pairs,
                dim=first.elements.shape[0],
                inputs=[
                    second.tree(),
                    kind,
                    *[motion, first.elements, second.elements],
                    *[first.lower, first.upper, self._found],
                ],
                device=self.device,
            )
            count = int(self._found.count.numpy()[0])
            if count > PAIRS_MAX:
                raise NotConverged(
                    f"self-contact: {count} pairs closer than {1e3 * motion.reach:g} mm; at most "
                    f"{PAIRS_MAX}"
                )
            if count <= self._found.pairs.shape[0]:
                pairs = self._found.pairs.numpy()[:count].astype(np.int64)
                return pairs[:, 0] * second.elements.shape[0] + pairs[:, 1]
            self._found.pairs = wp.zeros(2 * count, dtype=wp.vec2i, device=self.device)

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
        wp.launch(
            swept_boxes,
            dim=self.elements.shape[0],
            inputs=[x, move, self.elements, inflation_m + rounding_m, self.lower, self.upper],
            device=self.device,
        )

    def tree(self) -> wp.uint64:
        """Tree of the boxes as they are now."""
        if self._tree is None:
            self._tree = wp.Bvh(self.lower, self.upper)
        else:
            self._tree.refit()
        return self._tree.id


def edges_of(faces: np.ndarray) -> np.ndarray:
    """Edges of a triangle mesh, each once, shape (E, 2)."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(ends, axis=0).astype(np.int32)
