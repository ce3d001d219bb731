"""Positions of a trajectory as small integers: micrometres, differenced, so that zstd packs them.

Cloth moves smoothly in time and is smooth in space. Of the positions q, rounded to a micrometre, on
a grid of rows and columns, the second difference in time, then the first along the rows and along
the columns, is small: d[t, i, j]. What lies before the first frame, row or column counts as 0. The
sign is folded into the last bit, 0 -1 1 -2 2 ... -> 0 1 2 3 4 ..., so that the upper bytes are
nearly all 0; Parquet stores the bytes in planes (BYTE_STREAM_SPLIT). All arithmetic is modulo 2^32.
"""

import math

import numpy as np

UNIT_M = 1e-6
# Farther from the origin float32 tells no micrometres apart.
FARTHEST_M = 8.0


def rounded(positions_m: np.ndarray) -> np.ndarray:
    """Positions as they are stored, float32: the multiple of a micrometre that is nearest."""
    return (np.round(positions_m.astype(np.float64) / UNIT_M) * UNIT_M).astype(np.float32)


def _grid(vertices: int) -> tuple[int, int]:
    """Rows and columns of a square mesh; one column of what is none."""
    side = math.isqrt(vertices)
    return (side, side) if side * side == vertices else (vertices, 1)


def encode(positions_m: np.ndarray) -> np.ndarray:
    """Differences, int32 of shape (T, 3 V), of positions (T, V, 3) in m.

    Raises
    ------
    ValueError
        If a position is not finite or out of range.
    """
    if not np.abs(positions_m).max() <= FARTHEST_M:  # nor where it is not a number
        raise ValueError(f"positions_m: must be finite, within {FARTHEST_M:g} m of the origin")
    frames, vertices, _ = positions_m.shape
    steps = np.round(positions_m.astype(np.float64) / UNIT_M).astype(np.int32)
    steps = steps.reshape(frames, *_grid(vertices), 3)
    for axis in (0, 0, 1, 2):
        steps = np.diff(steps, axis=axis, prepend=np.int32(0))
    return ((steps << 1) ^ (steps >> 31)).reshape(frames, -1)


def decode(differences: np.ndarray) -> np.ndarray:
    """Positions (T, V, 3), float32, in m, of what `encode` gave."""
    folded = differences.view(np.uint32)
    steps = (folded >> 1).view(np.int32) ^ -(folded & 1).view(np.int32)
    frames, vertices = len(differences), differences.shape[1] // 3
    rows, columns = _grid(vertices)
    steps = steps.reshape(frames, rows, columns, 3)
    np.add.accumulate(steps, axis=2, out=steps)
    for i in range(1, rows):
        steps[:, i] += steps[:, i - 1]
    for _ in range(2):
        for t in range(1, frames):
            steps[t] += steps[t - 1]
    return (steps * UNIT_M).astype(np.float32).reshape(frames, vertices, 3)
