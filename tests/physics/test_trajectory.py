"""Trajectories as files: compact, exact to the micrometre, whole or refused."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support import synthetic_cloth

from slipstitch.base.errors import BadInput
from slipstitch.physics.simulation import trajectory as module
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory, write_trajectory

MOTION = Trajectory(**synthetic_cloth.motion(40))


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 25, 3), (5, 6, 3), (3, 169, 3)])
def test_positions_come_back_to_the_micrometre(shape):
    positions_m = np.random.default_rng(1).uniform(-8, 8, shape).astype(np.float32)
    there = module.decode(module.encode(positions_m))
    assert there.dtype == np.float32 and there.shape == shape
    np.testing.assert_array_equal(there, module.rounded(positions_m))
    assert np.abs(there.astype(float) - positions_m).max() < 1.01e-6  # half of it by float32 at 8 m
    np.testing.assert_array_equal(module.encode(there), module.encode(positions_m))


def test_the_format_is_the_second_difference_in_time_then_along_rows_and_columns():
    micrometres = np.zeros((3, 2, 2, 3))
    micrometres[:, 0, 0, 0] = [5, 7, 4]
    found = module.encode((micrometres * 1e-6).reshape(3, 4, 3)).reshape(3, 2, 2, 3)
    # 5, 2 - 5, -3 - 2 of that vertex; less where it is the one before; 0 -1 1 -2 -> 0 1 2 3.
    np.testing.assert_array_equal(found[:, 0, 0, 0], [10, 5, 9])
    np.testing.assert_array_equal(found[:, 0, 1, 0], [9, 6, 10])
    np.testing.assert_array_equal(found[:, 1, 0, 0], [9, 6, 10])
    np.testing.assert_array_equal(found[:, 1, 1, 0], [10, 5, 9])
    assert not found[..., 1:].any()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -9.0])
def test_what_has_no_place_is_not_written(wrong, tmp_path):
    positions_m = MOTION.positions_m.copy()
    positions_m[3, 4, 1] = wrong
    with pytest.raises(ValueError, match="positions_m: must be finite, within 8 m of the origin"):
        write_trajectory(tmp_path / "x.parquet", replace(MOTION, positions_m=positions_m))
    assert not list(tmp_path.iterdir())


def test_a_file_holds_everything_and_is_small(tmp_path):
    path = tmp_path / "x.parquet"
    write_trajectory(path, replace(MOTION, metadata={"seed": 3}), residual=np.arange(40.0))
    read = read_trajectory(path)
    np.testing.assert_array_equal(read.positions_m, module.rounded(MOTION.positions_m))
    for name in ("rest_positions_m", "uv", "faces", "pinned", "frame", "time_s", "stage_x_m"):
        np.testing.assert_array_equal(getattr(read, name), getattr(MOTION, name))
    assert read.metadata == {"seed": 3}
    assert path.stat().st_size < MOTION.positions_m.nbytes / 3  # here much of it is the mesh


def written_with(metadata, path):
    write_trajectory(path, MOTION)
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({"slipstitch": json.dumps(metadata)}), path)


def test_a_mesh_may_stand_beside_in_a_file_of_its_own(tmp_path):
    path, mesh = tmp_path / "x.parquet", tmp_path / "mesh.json"
    written_with({}, path)
    with pytest.raises(BadInput, match=r"no 'mesh' in its metadata, no mesh\.json beside"):
        read_trajectory(path)
    mesh.write_text(synthetic_cloth.mesh_text(MOTION))
    np.testing.assert_array_equal(read_trajectory(path).pinned, MOTION.pinned)
    mesh.write_text(synthetic_cloth.mesh_text(Trajectory(**synthetic_cloth.motion(2, n=5))))
    with pytest.raises(
        BadInput, match=r"441 vertices, but mesh\.json beside has another mesh, of 25"
    ):
        read_trajectory(path)


@pytest.mark.parametrize("place", np.linspace(0.02, 0.98, 9))
def test_a_changed_byte_is_noticed_or_changes_nothing(place, tmp_path):
    path = tmp_path / "x.parquet"
    write_trajectory(path, MOTION)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 0x55
    path.write_bytes(data)
    try:
        read = read_trajectory(path)
    except BadInput as error:
        assert str(path) in str(error) and "\n" not in str(error)
    else:
        np.testing.assert_array_equal(read.positions_m, module.rounded(MOTION.positions_m))


@pytest.mark.parametrize(
    "change",
    [{"faces": 10**9, "zstd_base64": ""}, {"faces": 800, "zstd_base64": "no base64"},
     {"faces": 800, "zstd_base64": "AAAA"}, {"zstd_base64": ""}, []],
)  # fmt: skip
def test_a_mesh_that_is_none_is_one_line(change, tmp_path):
    path = tmp_path / "x.parquet"
    written_with({"mesh": change}, path)
    with pytest.raises(BadInput, match="not a trajectory"):
        read_trajectory(path)


def test_other_numbers_than_whole_ones_are_no_positions(tmp_path):
    path = tmp_path / "x.parquet"
    write_trajectory(path, MOTION)
    table = pq.read_table(path)
    place = table.column_names.index("differences_um")
    other = table["differences_um"].cast(pa.list_(pa.float32(), 3 * 441))
    pq.write_table(table.set_column(place, "differences_um", other), path)
    with pytest.raises(BadInput, match="differences_um must be integers of 32 bits"):
        read_trajectory(path)
