"""A simulated run as a file: one row per frame, mesh and provenance in the metadata."""

import math
import os
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import open_parquet, read_metadata, write_parquet

_SCALARS = {
    "frame": pa.int32(),
    "time_s": pa.float64(),
    "stage_x_m": pa.float64(),
    "stage_z_m": pa.float64(),
}
_MESH = ("rest_positions_m", "uv", "faces", "pinned")


@dataclass(frozen=True)
class Trajectory:
    """The cloth's motion, frame by frame.

    Attributes
    ----------
    rest_positions_m : ndarray (V, 3)
    uv : ndarray (V, 2)
        Texture coordinates in [0, 1]; u along the upper edge, v from there to the lower edge.
    faces : ndarray (F, 3) int
    pinned : ndarray (P,) int
        Vertices that the clamps hold.
    frame : ndarray (T,) int
    time_s, stage_x_m, stage_z_m : ndarray (T,)
        Time, and place of the clamps: along the track, and above the floor.
    positions_m : ndarray (T, V, 3) float32
        World coordinates: z up, floor z = 0, x along the track.
    metadata : dict
        Whatever else the file's metadata holds (settings, material, friction, provenance ...).
    """

    rest_positions_m: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    pinned: np.ndarray
    frame: np.ndarray
    time_s: np.ndarray
    stage_x_m: np.ndarray
    stage_z_m: np.ndarray
    positions_m: np.ndarray
    metadata: dict = field(default_factory=dict)


def write_trajectory(
    path: str | os.PathLike,
    trajectory: Trajectory,
    record: dict | None = None,
    **columns: np.ndarray,
) -> None:
    """Write a trajectory as Parquet, atomically.

    Parameters
    ----------
    path : path
    trajectory : Trajectory
    record : dict, optional
        Provenance, see `slipstitch.base.provenance.provenance_record`.
    **columns : ndarray (T,)
        Further columns, such as ``newton_iterations`` and ``residual``.
    """
    count = len(trajectory.frame)
    flat = np.ascontiguousarray(trajectory.positions_m, dtype=np.float32).reshape(count, -1)
    arrays = {name: pa.array(getattr(trajectory, name), kind) for name, kind in _SCALARS.items()}
    arrays["positions_m"] = pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])
    arrays |= {name: pa.array(values) for name, values in columns.items()}
    mesh = {name: np.asarray(getattr(trajectory, name)).tolist() for name in _MESH}
    write_parquet(pa.table(arrays), path, {**trajectory.metadata, **mesh}, record)


def read_trajectory(path: str | os.PathLike) -> Trajectory:
    """Read what `write_trajectory` wrote.

    Raises
    ------
    BadInput
        If the file is missing, damaged, or not a trajectory; or contains non-finite numbers.
    """
    with open_parquet(path) as file:
        table = file.read()
        metadata = read_metadata(table)
    for name in (*_SCALARS, "positions_m"):
        if name not in table.column_names:
            raise BadInput(f"{path}: not a trajectory: no column {name!r}")
    for name in _MESH:
        if name not in metadata:
            raise BadInput(f"{path}: not a trajectory: no {name!r} in its metadata")
    try:
        values = {name: table[name].to_numpy() for name in _SCALARS}
        mesh = {
            "rest_positions_m": np.array(metadata.pop("rest_positions_m"), dtype=np.float64),
            "uv": np.array(metadata.pop("uv"), dtype=np.float64),
            "faces": np.array(metadata.pop("faces"), dtype=np.int64),
            "pinned": np.array(metadata.pop("pinned"), dtype=np.int64),
        }
        vertices = len(mesh["rest_positions_m"])
        flat = table["positions_m"].combine_chunks().flatten().to_numpy()
        positions = flat.reshape(table.num_rows, vertices, 3).astype(np.float32)
    except (ValueError, TypeError, AttributeError, pa.ArrowException) as error:
        raise BadInput(f"{path}: not a trajectory: {str(error).splitlines()[0]}") from None
    _check(path, mesh, vertices, positions, values)
    return Trajectory(**mesh, **values, positions_m=positions, metadata=metadata)


def _check(path, mesh: dict, vertices: int, positions: np.ndarray, values: dict) -> None:
    shapes = {"rest_positions_m": (vertices, 3), "uv": (vertices, 2)}
    for name, shape in shapes.items():
        if mesh[name].shape != shape:
            raise BadInput(f"{path}: {name} has shape {mesh[name].shape}; must be {shape}")
    faces = mesh["faces"]
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise BadInput(f"{path}: faces has shape {faces.shape}; must be triangles (F, 3)")
    if faces.min() < 0 or faces.max() >= vertices:
        raise BadInput(f"{path}: faces refer to vertices outside 0 ... {vertices - 1}")
    if not len(positions):
        raise BadInput(f"{path}: contains no frames")
    for name, array in (*mesh.items(), ("positions_m", positions), *values.items()):
        if not math.isfinite(float(np.sum(array, dtype=np.float64))):
            raise BadInput(f"{path}: {name} contains non-finite numbers")
