"""Regular triangle meshes of a flat sheet, and what the solver precomputes on them."""

from dataclasses import dataclass

import numpy as np

from slipstitch.base.errors import BadInput


@dataclass(frozen=True)
class ClothMesh:
    """A flat sheet at rest."""

    rest_uv_m: np.ndarray  # (V, 2): u along the upper edge, v down from it
    faces: np.ndarray  # (F, 3), int32
    hinges: np.ndarray  # (H, 4): edge ends, then the vertices opposite in first and second face
    elimination_order: np.ndarray  # nested dissection: keeps the Cholesky factor sparse
    shape: tuple[int, int]  # rows and columns; vertex number is ``row * columns + column``

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
    """Mesh a rectangle with alternating diagonals: rows and length down (v), columns across (u)."""
    if rows < 2 or columns < 2:
        raise BadInput(f"mesh of {rows} x {columns} vertices: must be at least 2 x 2")
    if not (length_m > 0 and width_m > 0):
        raise BadInput(f"cloth of {length_m} m x {width_m} m: both must be positive")
    down_m, across_m = np.linspace(0, length_m, rows), np.linspace(0, width_m, columns)
    v, u = np.meshgrid(down_m, across_m, indexing="ij")
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    even = np.add.outer(np.arange(rows - 1), np.arange(columns - 1))[..., None] % 2 == 0
    falling, rising = np.stack([a, b, d, a, d, c], -1), np.stack([a, b, c, b, d, c], -1)
    faces = np.where(even, falling, rising).reshape(-1, 3)
    order: list[int] = []
    _dissect(number, order)
    rest_uv_m, elimination = np.stack([u.ravel(), v.ravel()], 1), np.array(order, dtype=np.int32)
    return ClothMesh(rest_uv_m, faces, _hinges(faces), elimination, (rows, columns))


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
    """Order a block of the grid: both halves, then the two lines that hinges couple over."""
    if block.size <= 100 or max(block.shape) < 5:
        order.extend(block.ravel().tolist())
        return
    if block.shape[0] < block.shape[1]:
        block = block.T
    middle = block.shape[0] // 2
    _dissect(block[: middle - 1], order)
    _dissect(block[middle + 1 :], order)
    order.extend(block[middle - 1 : middle + 1].ravel().tolist())
