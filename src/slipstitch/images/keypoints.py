"""Keypoints: places of nine points of the cloth in every image, in metres.

They are labels beside the friction coefficient: a network that is told where the cloth lies in
every frame learns to see its shape, of which there are thousands, not only the coefficient, of
which every simulation has one.
"""

import numpy as np

#: Texture coordinates of the keypoints: three rows below the clamps, three points each.
KEYPOINTS_UV = np.array([(u, v) for v in (1 / 3, 2 / 3, 1.0) for u in (0.0, 0.5, 1.0)])


def keypoint_vertices_uv(vertices_per_side: int) -> np.ndarray:
    """Texture coordinates of the vertices of a square mesh that are the keypoints, shape (9, 2)."""
    v, u = np.meshgrid(*2 * [np.linspace(0, 1, vertices_per_side)], indexing="ij")
    uv = np.column_stack([u.ravel(), v.ravel()])
    return uv[_nearest(uv)]


def _nearest(uv: np.ndarray) -> np.ndarray:
    """Numbers of the vertices (V, 2) nearest to `KEYPOINTS_UV`, shape (9,)."""
    return np.linalg.norm(uv[None] - KEYPOINTS_UV[:, None], axis=2).argmin(axis=1)


def keypoints_m(positions_m: np.ndarray, uv: np.ndarray, stage_x_m: np.ndarray) -> np.ndarray:
    """Places (T, 9, 3) of the vertices nearest to `KEYPOINTS_UV`, of vertices (T, V, 3).

    Metres along the track relative to the clamps `stage_x_m` (T,), across it, above the floor.
    """
    places = positions_m[:, _nearest(uv)].astype(np.float64)
    places[..., 0] -= stage_x_m[:, None]
    return places
