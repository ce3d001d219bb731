"""Simulations that are handed out are taken instead of computed, or refused in one line."""

import hashlib
import json
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from support import synthetic_cloth
from support.refusal import refused, run

from slipstitch.base.provenance import read_provenance
from slipstitch.physics.simulation import simulation_files
from slipstitch.physics.simulation.trajectory import read_trajectory, write_trajectory

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


@pytest.fixture
def no_solver(monkeypatch):
    def simulate(*of_a_run, **options):
        raise AssertionError("simulated")

    monkeypatch.setattr(simulation_files, "simulate_drop_and_drag", simulate)


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
    folder, simulated, no_solver, capfd, arrange
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


def test_a_release_is_taken_from_and_a_run_by_hand_is_found(folder, simulated, no_solver):
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
def test_what_is_not_the_run_is_refused_in_one_line(folder, simulated, no_solver, capfd, change):
    change(folder)
    command, out = take(folder, simulated)
    said = refused(capfd, command)
    assert REFUSED[change] in said and str(folder) in said
    assert not out.exists()
