"""Regular triangle meshes of a flat sheet, and what the solver precomputes on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.base.errors import BadInput


@dataclass(frozen=True)
class ClothMesh:
    """A flat sheet at rest.

    Attributes
    ----------
    rest_uv_m : ndarray, shape (V, 2)
        Material coordinates: u along the upper edge, v down from it.
    faces : ndarray of int32, shape (F, 3)
    hinges : ndarray of int32, shape (H, 4)
        Edge ends, then the vertex opposite in the first and in the second face.
    elimination_order : ndarray of int32, shape (V,)
        Nested dissection of the vertices: keeps the Cholesky factor sparse.
    shape : tuple of int
        Rows and columns of vertices; vertex number is ``row * columns + column``.
    """

    rest_uv_m: np.ndarray
    faces: np.ndarray
    hinges: np.ndarray
    elimination_order: np.ndarray
    shape: tuple[int, int]

    @property
    def vertex_count(self) -> int:
        return len(self.rest_uv_m)

    def face_areas_m2(self) -> np.ndarray:
        """Areas at rest, shape (F,)."""
        a, b, c = (self.rest_uv_m[self.faces[:, k]] for k in range(3))
        return 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])

    def vertex_areas_m2(self) -> np.ndarray:
        """A third of each face's area to each of its vertices, shape (V,)."""
        return np.bincount(
            self.faces.ravel(), np.repeat(self.face_areas_m2() / 3, 3), self.vertex_count
        )


def rectangle(rows: int, columns: int, length_m: float, width_m: float) -> ClothMesh:
    """Mesh a rectangle with right triangles whose diagonals alternate.

    Parameters
    ----------
    rows, columns : int
        Vertices down (v) and across (u); at least 2 each.
    length_m, width_m : float
        Extent down and across.

    Raises
    ------
    BadInput
        Fewer than two rows or columns, or a size that is not positive.
    """
    if rows < 2 or columns < 2:
        raise BadInput(f"mesh of {rows} x {columns} vertices: must be at least 2 x 2")
    if not (length_m > 0 and width_m > 0):
        raise BadInput(f"cloth of {length_m} m x {width_m} m: both must be positive")
    v, u = np.meshgrid(
        np.linspace(0, length_m, rows), np.linspace(0, width_m, columns), indexing="ij"
    )
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    faces = []
    for i in range(rows - 1):
        for j in range(columns - 1):
            a, b = number[i, j], number[i, j + 1]
            c, d = number[i + 1, j], number[i + 1, j + 1]
            if (i + j) % 2 == 0:
                faces += [(a, b, d), (a, d, c)]
            else:
                faces += [(a, b, c), (b, d, c)]
    faces = np.array(faces, dtype=np.int32)
    order: list[int] = []
    _dissect(number, order)
    return ClothMesh(
        np.stack([u.ravel(), v.ravel()], axis=1),
        faces,
        _hinges(faces),
        np.array(order, dtype=np.int32),
        (rows, columns),
    )


def _hinges(faces: np.ndarray) -> np.ndarray:
    """Pair up faces over inner edges: (edge start, edge end, opposite, opposite)."""
    opposite_of: dict[tuple[int, int], int] = {}
    for a, b, c in faces.tolist():
        opposite_of[a, b], opposite_of[b, c], opposite_of[c, a] = c, a, b
    hinges = [
        (start, end, opposite, opposite_of[end, start])
        for (start, end), opposite in opposite_of.items()
        if start < end and (end, start) in opposite_of
    ]
    return np.array(hinges, dtype=np.int32).reshape(-1, 4)


def _dissect(block: np.ndarray, order: list[int]) -> None:
    """Order a block of the grid: both halves first, then the two lines that part them.

    Two lines, because a hinge couples vertices two lines apart.
    """
    if block.size <= 100 or max(block.shape) < 5:
        order.extend(block.ravel().tolist())
        return
    if block.shape[0] < block.shape[1]:
        block = block.T
    middle = block.shape[0] // 2
    _dissect(block[: middle - 1], order)
    _dissect(block[middle + 1 :], order)
    order.extend(block[middle - 1 : middle + 1].ravel().tolist())
