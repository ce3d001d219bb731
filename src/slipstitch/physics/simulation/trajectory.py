"""A simulated run as a file: one row per frame, mesh and provenance in the metadata.

Positions are stored as small integers, which zstd packs. Cloth moves smoothly in time and is smooth
in space: of the positions, rounded to a micrometre, on a grid of rows and columns, the second
difference in time, then the first along the rows and along the columns, is small. What lies before
the first frame, row or column counts as 0. The sign is folded into the last bit, 0 -1 1 -2 2 ... ->
0 1 2 3 4 ..., so that the upper bytes are nearly all 0; Parquet stores the bytes in planes
(BYTE_STREAM_SPLIT). All arithmetic is modulo 2^32.
"""

import base64
import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import open_parquet, read_json, read_metadata, write_parquet

_SCALARS = {"frame": pa.int32()} | dict.fromkeys(("time_s", "stage_x_m", "stage_z_m"), pa.float64())
DIFFERENCES = "differences_um"  # column of the positions
UNIT_M = 1e-6
# Farther from the origin float32 tells no micrometres apart.
FARTHEST_M = 8.0
COMPRESSION_LEVEL = 19
FACES_A_VERTEX_MAX = 3  # of a triangle mesh; a file that claims more holds none


@dataclass(frozen=True)
class Trajectory:
    """The motion of V vertices in T frames, in world coordinates: floor z = 0, track along x."""

    rest_positions_m: np.ndarray  # (V, 3)
    uv: np.ndarray  # (V, 2) in [0, 1]: along the upper edge, and from there to the lower edge
    faces: np.ndarray  # (F, 3)
    pinned: np.ndarray  # vertices that the clamps hold
    frame: np.ndarray
    time_s: np.ndarray
    stage_x_m: np.ndarray  # place of the clamps along the track
    stage_z_m: np.ndarray  # above the floor
    positions_m: np.ndarray  # (T, V, 3), float32
    # What else the file's metadata hold: settings, material, friction, provenance ...
    metadata: dict = field(default_factory=dict)


def rounded(positions_m: np.ndarray) -> np.ndarray:
    """Positions as they are stored, float32: the multiple of a micrometre that is nearest."""
    return (np.round(positions_m.astype(np.float64) / UNIT_M) * UNIT_M).astype(np.float32)


def _grid(vertices: int) -> tuple[int, int]:
    """Rows and columns of a square mesh; one column of what is none."""
    side = math.isqrt(vertices)
    return (side, side) if side * side == vertices else (vertices, 1)


def encode(positions_m: np.ndarray) -> np.ndarray:
    """Differences, int32 of shape (T, 3 V), of positions (T, V, 3) in m."""
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
    for axis in (2, 1, 0, 0):
        np.add.accumulate(steps, axis=axis, out=steps)
    return (steps * UNIT_M).astype(np.float32).reshape(frames, vertices, 3)


def write_trajectory(
    path: str | os.PathLike,
    trajectory: Trajectory,
    record: dict | None = None,
    **columns: np.ndarray,
) -> None:
    """Write a trajectory as Parquet, atomically, to a micrometre, with record and columns (T,)."""
    arrays = {name: pa.array(getattr(trajectory, name), kind) for name, kind in _SCALARS.items()}
    arrays |= {name: pa.array(values) for name, values in columns.items()}
    differences = encode(trajectory.positions_m)
    arrays[DIFFERENCES] = pa.FixedSizeListArray.from_arrays(
        pa.array(differences.ravel()), differences.shape[1]
    )
    mesh = {"pinned": np.asarray(trajectory.pinned).tolist(), "mesh": _packed_mesh(trajectory)}
    layout = {"compression_level": COMPRESSION_LEVEL, "data_page_size": 2**28}
    layout |= {"use_dictionary": False, "write_statistics": False}
    planes, metadata = [f"{DIFFERENCES}.list.element"], {**trajectory.metadata, **mesh}
    table = pa.table(arrays)
    write_parquet(table, path, metadata, record, use_byte_stream_split=planes, **layout)


MESH = ("rest_positions_m", "uv", "faces")


def _mesh_layout(vertices: int, faces: int) -> np.dtype:
    shapes = ("f8", (vertices, 3)), ("f8", (vertices, 2)), ("i4", (faces, 3))
    return np.dtype([(name, *kind) for name, kind in zip(MESH, shapes, strict=True)])


def _packed_mesh(trajectory: Trajectory) -> dict:
    """Rest positions, texture coordinates and faces as text: some 15 kB for 41 x 41 vertices."""
    faces = len(trajectory.faces)
    mesh = np.zeros((), _mesh_layout(len(trajectory.uv), faces))
    for name in MESH:
        mesh[name] = getattr(trajectory, name)
    data = pa.Codec("zstd", 19).compress(mesh.tobytes(), asbytes=True)
    return {"faces": faces, "zstd_base64": base64.b64encode(data).decode()}


def _unpacked_mesh(packed: dict, vertices: int) -> dict:
    faces = int(packed["faces"])
    if not 0 < faces <= FACES_A_VERTEX_MAX * vertices:
        raise ValueError(f"{faces} faces of {vertices} vertices")
    layout = _mesh_layout(vertices, faces)
    data = base64.b64decode(packed["zstd_base64"], validate=True)
    data = pa.Codec("zstd").decompress(data, layout.itemsize, asbytes=True)
    mesh = np.frombuffer(data, layout)[0]
    return {name: mesh[name].copy() for name in MESH}


def read_trajectory(path: str | os.PathLike) -> Trajectory:
    """Read a trajectory; where its file holds no mesh, the mesh is in ``mesh.json`` beside."""
    return read_with_columns(path)[0]


def read_with_columns(path: str | os.PathLike) -> tuple[Trajectory, dict[str, np.ndarray]]:
    """A trajectory, and the further columns of its file; see `read_trajectory`."""
    with open_parquet(path) as file:
        table = file.read()
        metadata = read_metadata(table)
    for name in (*_SCALARS, DIFFERENCES):
        if name not in table.column_names:
            raise BadInput(f"{path}: not a trajectory: no column {name!r}")
    try:
        columns = {
            name: table[name].to_numpy() for name in table.column_names if name != DIFFERENCES
        }
        values = {name: columns.pop(name) for name in _SCALARS}
        flat = table[DIFFERENCES].combine_chunks().flatten().to_numpy()
        if flat.dtype != np.int32 or not len(flat):
            raise ValueError(f"{DIFFERENCES} must be integers of 32 bits")
        positions = decode(flat.reshape(table.num_rows, -1))
        vertices = positions.shape[1]
        mesh = _mesh_of(path, metadata, vertices)
        mesh["faces"] = mesh["faces"].astype(np.int64)
        mesh["pinned"] = np.array(metadata.pop("pinned", mesh.get("pinned")), dtype=np.int64)
    except (ValueError, TypeError, KeyError, AttributeError, OSError) as error:
        raise BadInput(f"{path}: not a trajectory: {first_line(error)}") from None
    _check(path, mesh, vertices, positions, values)
    return Trajectory(**mesh, **values, positions_m=positions, metadata=metadata), columns


def _mesh_of(path: str | os.PathLike, metadata: dict, vertices: int) -> dict:
    packed = metadata.pop("mesh", None)
    if packed is not None:
        return _unpacked_mesh(packed, vertices)
    beside = Path(path).with_name("mesh.json")
    if not beside.is_file():
        raise BadInput(f"{path}: not a trajectory: no 'mesh' in its metadata, no mesh.json beside")
    content = read_json(beside)
    if (count := len(content["rest_positions_m"])) != vertices:
        raise BadInput(
            f"{path}: {vertices} vertices, but {beside.name} beside has another mesh, of {count}"
        )
    layout = _mesh_layout(vertices, len(content["faces"]))
    mesh = {name: np.array(content[name], layout[name].base) for name in MESH}
    mesh = {name: array.reshape(layout[name].shape) for name, array in mesh.items()}
    return mesh | {"pinned": content["pinned"]}


def _check(path, mesh: dict, vertices: int, positions: np.ndarray, values: dict) -> None:
    faces = mesh["faces"]
    if not faces.size or faces.min() < 0 or faces.max() >= vertices:
        raise BadInput(f"{path}: faces refer to vertices outside 0 ... {vertices - 1}")
    if not len(positions):
        raise BadInput(f"{path}: contains no frames")
    for name, array in (*mesh.items(), ("positions_m", positions), *values.items()):
        if not math.isfinite(float(np.sum(array, dtype=np.float64))):
            raise BadInput(f"{path}: {name} contains non-finite numbers")
