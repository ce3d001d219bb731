"""slipstitch simulate: a run, several of a grid, and those that are handed out instead."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from support import synthetic_cloth
from support.refusal import refused, run

from slipstitch.base.errors import NotConverged
from slipstitch.base.provenance import read_metadata, read_provenance
from slipstitch.physics.simulation.trajectory import read_trajectory, write_trajectory

RUN = "--material gray-interlock --friction 0.3"
TINY = "--set vertices_per_side=9 --set frames=3 --set settle_s=0.2"


def test_one_row_a_frame_with_the_documented_columns_and_metadata(tmp_path):
    trajectory_file = tmp_path / "x.parquet"
    assert run(f"simulate {RUN} {TINY} --out {trajectory_file}") == 0
    table = pq.read_table(trajectory_file)
    assert table.num_rows == 3
    assert table.schema.field("differences_um").type == pa.list_(pa.int32(), 3 * 81)
    columns = {"frame", "time_s", "stage_x_m", "stage_z_m", "newton_iterations", "residual"}
    assert columns <= set(table.column_names)
    np.testing.assert_allclose(table["time_s"].to_numpy(), np.arange(3) / 2.4)
    metadata = read_metadata(trajectory_file)
    assert metadata["mesh"]["faces"] == 128 and metadata["pinned"] == [0, 8]
    assert metadata["settings"]["vertices_per_side"] == 9
    assert metadata["material"] == "gray-interlock"
    assert metadata["solver"]["largest_residual"] <= metadata["settings"]["friction_tolerance"]
    assert read_provenance(trajectory_file)["stage"] == "simulate"
    other = trajectory_file.with_name("other.parquet")
    assert run(f"simulate {RUN} --seed 1 {TINY} --out {other}") == 0
    assert read_metadata(other)["perturbation"] != metadata["perturbation"]


@pytest.mark.slow
def test_the_environment_s_threads_do_not_change_a_bit(tmp_path):
    # With 25 vertices a side BLAS splits its sums over two threads, if it is let.
    size = "--set vertices_per_side=25 --set frames=6 --set settle_s=0.2"
    places = []
    for threads in ("1", "2"):
        out = tmp_path / f"{threads}.parquet"
        command = f"{sys.executable} -m slipstitch simulate {RUN} {size} --out {out}"
        several = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        subprocess.run(command.split(), env=os.environ | several, check=True, capture_output=True)
        places.append(read_trajectory(out).positions_m)
    np.testing.assert_array_equal(*places)


BAD_INPUT = {
    "--material silk --friction 0.3": "unknown material 'silk'",
    "--material gray-interlock --friction nan": "--friction nan: must lie",
    "--material gray-interlock": "either --material and --friction, or --simulation",
    "--simulation m00_f0100_r00": "--simulation requires --config",
    f"{RUN} --set time_step_s=0": "simulation.time_step_s: must be greater than 0",
    f"{RUN} --set timestep=1": "simulation.timestep: unknown key",
    f"{RUN} --set frames": "--set frames: must be KEY=VALUE",
    f"{RUN} --seed -4": "'--seed': -4 is not in the range x>=0",
    f"{RUN} --device abacus": "device abacus: not available on this machine; available: cpu",
}


@pytest.mark.parametrize("words", BAD_INPUT)
def test_bad_input_is_one_line_and_leaves_nothing(words, tmp_path, capfd):
    assert BAD_INPUT[words] in refused(capfd, f"simulate {words} --out {tmp_path}/x.parquet")
    assert list(tmp_path.iterdir()) == []


def test_several_simulations_of_the_grid_at_once_are_those_one_by_one(simulated, tmp_path, capfd):
    alone = tmp_path / "alone.parquet"
    command = f"simulate --config {simulated}/grid.yaml --out {alone} --simulation"
    said = refused(capfd, f"{command} {FIRST} {SECOND}")
    assert "1 files in --out for 2 simulations: must be one each" in said
    for one in (FIRST, SECOND):
        assert run(f"{command} {one}") == 0
        here, there = read_trajectory(simulated / f"{one}.parquet"), read_trajectory(alone)
        assert np.array_equal(here.positions_m, there.positions_m)
        assert here.metadata["simulation"] == there.metadata["simulation"] == one


def test_what_could_be_solved_is_written_although_another_failed(
    simulated, tmp_path, capfd, monkeypatch
):
    import slipstitch.physics.simulation.drop_and_drag as module

    record = module._Bench.record

    def failing(self, frame_done):
        if self.run.friction == 0.7:
            raise NotConverged("at 1 s it did not", {"positions_m": np.zeros((49, 3))})
        return record(self, frame_done)

    monkeypatch.setattr(module._Bench, "record", failing)
    assert run(both_of(simulated / "grid.yaml", tmp_path)) == 1
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {f"{FIRST}.parquet", f"{SECOND}.failed.npz"}
    assert "at 1 s it did not" in capfd.readouterr().err


def test_a_damaged_calibration_is_named_with_the_command_that_makes_it(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    broken = Path("results/calibration.json")
    broken.parent.mkdir()
    broken.write_text("{")
    said = refused(capfd, f"simulate {RUN} --calibration {broken} --out {tmp_path}/x.parquet")
    assert f"snakemake --cores 2 all --forcerun {broken}" in said


def test_a_calibration_of_settings_leaves_the_configured_law_alone(tmp_path):
    """Also one that states no law, as they used to."""
    law = {"coefficient": 0.3, "mechanisms": {"anisotropy": {"anisotropy": 0.25}}}
    model, config, calibration = (tmp_path / f"{name}.json" for name in "mcs")
    model.write_text(json.dumps({"friction_law": {"face": law}}))
    small = {"vertices_per_side": 5, "frames": 2, "model": str(model)}
    config.write_text(json.dumps({"simulation": small, "sample": {"frames": 2}}))
    calibration.write_text(json.dumps({"settings": {"time_step_s": 0.05, "model": None}}))
    of_run = f"{RUN} --config {config} --calibration {calibration}"
    assert run(f"simulate {of_run} --out {tmp_path}/x.parquet") == 0
    told = read_trajectory(tmp_path / "x.parquet").metadata
    assert told["settings"]["time_step_s"] == 0.05
    assert told["extended_model"]["law"]["mechanisms"] == law["mechanisms"]


def test_a_run_that_cannot_be_solved_fails_and_keeps_its_state_to_look_into(
    tmp_path, capfd, monkeypatch
):
    monkeypatch.setattr("slipstitch.physics.cloth.solver.HALVINGS_MAX", 0)
    words = "--set vertices_per_side=5 --set frames=2 --set newton_iterations_max=1"
    assert run(f"simulate {RUN} {words} --out {tmp_path}/x.parquet") == 1
    assert not (tmp_path / "x.parquet").exists()
    state = np.load(tmp_path / "x.failed.npz")
    assert state["positions_m"].shape == state["last_residual_N"].shape == (25, 3)
    error = capfd.readouterr().err
    assert f"did not converge to 0.0005 in 1 iterations; its state was saved to {tmp_path}" in error


FIRST, SECOND = "m05_f0300_r00", "m05_f0700_r00"
GRID = {
    "grid": {"materials": ["gray-interlock"], "frictions": [0.3, 0.7]},
    "simulation": {"vertices_per_side": 7, "frames": 3, "settle_s": 0.2},
    "sample": {"frames": 2},
}


def both_of(config, out):
    """The command that simulates both."""
    files = f"{out}/{FIRST}.parquet {out}/{SECOND}.parquet"
    return f"simulate --config {config} --simulation {FIRST} {SECOND} --out {files}"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Two simulations of a small grid, and its configuration."""
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "grid.yaml").write_text(yaml.safe_dump(GRID))
    assert run(both_of(folder / "grid.yaml", folder)) == 0
    return folder


@pytest.fixture
def folder(simulated, tmp_path):
    """A copy of the simulations, to be handed out."""
    there = tmp_path / "handed_out"
    there.mkdir()
    for name in (FIRST, SECOND):
        shutil.copy2(simulated / f"{name}.parquet", there)
    return there


def take(folder, simulated, words=""):
    """The command that takes the first simulation, or one told by words, and where to."""
    out = folder.parent / "out" / "x.parquet"
    words = words or f"--config {simulated}/grid.yaml --simulation {FIRST}"
    return f"simulate {words} --handed-out {folder} --out {out}", out


def apart(folder):
    """Make the files those of a hand-out of another kind: the mesh and the checksums beside."""
    first = read_trajectory(folder / f"{FIRST}.parquet")
    (folder / "mesh.json").write_text(synthetic_cloth.mesh_text(first))
    lines = []
    for path in sorted(folder.glob("*.parquet")):
        table = pq.read_table(path)
        metadata = json.loads(table.schema.metadata[b"slipstitch"])
        metadata = {key: metadata[key] for key in metadata if key not in ("mesh", "pinned")}
        table = table.replace_schema_metadata({"slipstitch": json.dumps(metadata)})
        pq.write_table(table, path, compression="zstd")
        lines.append(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  ./{path.name}\n")
    (folder / "SHA256SUMS").write_text("".join(lines))


@pytest.mark.parametrize("arrange", [lambda folder: None, apart], ids=["own", "mesh beside"])
def test_a_simulation_that_is_there_is_taken_and_the_record_says_so(
    folder, simulated, capfd, arrange
):
    arrange(folder)
    command, out = take(folder, simulated)
    assert run(command) == 0
    assert f"handed out as {FIRST}.parquet" in capfd.readouterr().out
    own, taken = (read_trajectory(path) for path in (simulated / f"{FIRST}.parquet", out))
    np.testing.assert_array_equal(own.positions_m, taken.positions_m)
    np.testing.assert_array_equal(own.faces, taken.faces)
    names = ("newton_iterations", "residual")
    one, other = pq.read_table(simulated / f"{FIRST}.parquet"), pq.read_table(out)
    assert all(one[name].equals(other[name]) for name in names)
    record, origin = (read_provenance(path) for path in (out, simulated / f"{FIRST}.parquet"))
    assert record["handed_out"]["file"] == f"{FIRST}.parquet"
    assert record["handed_out"]["provenance"] == origin
    assert len(record["handed_out"]["sha256"]) == 64 and record["config"] == origin["config"]
    for each in (own, taken):
        each.metadata.pop("provenance")
    assert own.metadata == taken.metadata


def test_a_release_is_taken_from_and_a_run_by_hand_is_found(folder, simulated):
    (folder / "simulations").mkdir()
    for path in folder.glob("*.parquet"):
        path.rename(folder / "simulations" / path.name)
    assert run(take(folder, simulated)[0]) == 0
    seed = read_trajectory(simulated / f"{FIRST}.parquet").metadata["seed"]
    words = [f"--set {key}={value}" for key, value in GRID["simulation"].items()]
    by_hand = f"--material gray-interlock --friction 0.3 --seed {seed} {' '.join(words)}"
    command, out = take(folder, simulated, by_hand)
    assert run(command) == 0 and "handed_out" in read_provenance(out)


def test_the_configuration_names_the_folder_and_what_is_missing_is_simulated(
    folder, simulated, capfd
):
    (folder / f"{SECOND}.parquet").unlink()
    config = folder.parent / "grid.yaml"
    config.write_text(yaml.safe_dump(GRID | {"compute": {"handed_out": str(folder)}}))
    assert run(both_of(config, folder.parent)) == 0
    first, second = capfd.readouterr().out.splitlines()
    assert "handed out" in first and "CPU s" in second
    assert "handed_out" not in read_provenance(folder.parent / f"{SECOND}.parquet")
    for name in (f"{FIRST}.parquet", f"{SECOND}.parquet"):
        made, expected = (read_trajectory(one / name) for one in (folder.parent, simulated))
        np.testing.assert_array_equal(made.positions_m, expected.positions_m)


def _one_byte(folder):
    """Of the positions: the footer has copies of what is read, which nothing reads."""
    path = folder / f"{FIRST}.parquet"
    data = bytearray(path.read_bytes())
    group = pq.ParquetFile(path).metadata.row_group(0)
    largest = max(
        map(group.column, range(group.num_columns)), key=lambda c: c.total_compressed_size
    )
    data[largest.data_page_offset + largest.total_compressed_size // 2] ^= 1
    path.write_bytes(data)


def _apart_and(then):
    def change(folder):
        apart(folder)
        then(folder)

    return change


def _another_mesh(folder):
    mesh = folder / "mesh.json"
    mesh.write_text(mesh.read_text().replace("0.1]", "0.11]"))


def _states(**changes):
    def change(folder):
        path = folder / f"{FIRST}.parquet"
        trajectory = read_trajectory(path)
        known = trajectory.metadata
        record = known.pop("provenance")
        for key, value in changes.items():
            known[key] = known[key] | value if isinstance(known.get(key), dict) else value
        if "catalogue" in changes:
            record["config"]["catalogue"] = known.pop("catalogue")
        write_trajectory(path, trajectory, record)

    return change


REFUSED = {
    _one_byte: "damaged",
    _apart_and(_one_byte): "damaged",
    _apart_and(lambda folder: (folder / "SHA256SUMS").unlink()): "no SHA256SUMS beside lists it",
    _apart_and(_another_mesh): "another mesh",
    lambda folder: shutil.copy2(folder / f"{FIRST}.parquet", folder / "n.parquet"): (
        f"claims to be {FIRST}, and so does n.parquet"
    ),
    _states(friction=0.4): "friction 0.4, not 0.3",
    _states(settings={"damping_s": 0.1}): "damping_s 0.1, not 0.002",
    _states(settings={"new": 1}): "new 1, not stated",
    _states(perturbation={"yaw_deg": 9.0}): "another perturbation of the bench",
    _states(extended_model={"law": 1}): "another extended model",
    _states(catalogue="other"): "another fabric data",
    lambda folder: [path.unlink() for path in folder.iterdir()]: "has no simulations",
    shutil.rmtree: "no such folder",
}


@pytest.mark.parametrize("change", REFUSED, ids=REFUSED.values())
def test_what_is_not_the_run_is_refused_in_one_line(folder, simulated, capfd, change):
    change(folder)
    command, out = take(folder, simulated)
    said = refused(capfd, command)
    assert REFUSED[change] in said and str(folder) in said
    assert not out.exists()
