"""Which triangles of a mesh cross each other: a check that shares no code with the solver.

Two triangles that share no node cross exactly where an edge of one goes through the other; two
that share one node, where the edge opposite to it does; two that share an edge never do, but
in a set of measure zero. Every edge is tested against every triangle near it with the signed
volumes of tetrahedra.
"""

import numpy as np
from scipy.spatial import cKDTree

# Trajectories are rounded to a micrometre: on which side of a triangle a point lies is known no
# better, and where the sheet lies flat, the sides of distant triangles are those of the rounding.
SURELY_BESIDE_M = 2e-6


def crossing_pairs(positions_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Edges that go through triangles, (N, 3): the edge's ends and the triangle's number."""
    x = np.asarray(positions_m, dtype=float)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    corners = x[faces]
    centres = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centres[:, None], axis=2).max()
    middles = x[edges].mean(axis=1)
    half = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1).max() / 2
    near = cKDTree(centres).query_ball_point(middles, radius + half)
    edge = np.repeat(np.arange(len(edges)), [len(one) for one in near])
    face = np.concatenate([np.asarray(one, dtype=int) for one in near])
    apart = ~(edges[edge][:, :, None] == faces[face][:, None, :]).any(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    p, q = x[edges[edge, 0]], x[edges[edge, 1]]
    a, b, c = (corners[face, k] for k in range(3))

    def volume(o, u, v, w):
        return np.einsum("ij,ij->i", np.cross(u - o, v - o), w - o)

    twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    above, below = (volume(a, b, c, end) / twice_area for end in (p, q))
    sides = (above * below < 0) & (np.minimum(abs(above), abs(below)) > SURELY_BESIDE_M)
    first, second, third = volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)
    through = (np.sign(first) == np.sign(second)) & (np.sign(second) == np.sign(third))
    hit = sides & through
    return np.column_stack([edges[edge[hit]], face[hit]])
