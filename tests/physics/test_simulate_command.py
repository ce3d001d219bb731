"""slipstitch simulate at the command line."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.refusal import refused, run

from slipstitch.base.errors import NotConverged
from slipstitch.base.provenance import read_metadata, read_provenance
from slipstitch.physics.simulation.trajectory import read_trajectory

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


REFUSED = {
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


@pytest.mark.parametrize("words", REFUSED)
def test_bad_input_is_one_line_and_leaves_nothing(words, tmp_path, capfd):
    assert REFUSED[words] in refused(capfd, f"simulate {words} --out {tmp_path}/x.parquet")
    assert list(tmp_path.iterdir()) == []


IDS = ["m05_f0200_r00", "m09_f0700_r01"]


@pytest.fixture
def grid(tmp_path):
    """The beginning of a command that simulates of a grid of two fabrics and coefficients."""
    config = tmp_path / "grid.yaml"
    config.write_text(
        "grid: {materials: [gray-interlock, royal-target], frictions: [0.2, 0.7]}\n"
        "simulation: {vertices_per_side: 7, frames: 3, settle_s: 0.2}\nsample: {frames: 2}\n"
    )
    return f"simulate --config {config} --simulation"


def test_several_simulations_of_the_grid_at_once_are_those_one_by_one(grid, tmp_path, capfd):
    both, alone = " ".join(IDS), tmp_path / "alone.parquet"
    said = refused(capfd, f"{grid} {both} --out {alone}")
    assert "1 files in --out for 2 simulations: must be one each" in said
    together = [tmp_path / f"{one}.parquet" for one in IDS]
    assert run(f"{grid} {both} --out {together[0]} {together[1]}") == 0
    assert len(capfd.readouterr().out.splitlines()) == 2
    for one, file in zip(IDS, together, strict=True):
        assert run(f"{grid} {one} --out {alone}") == 0
        here, there = read_trajectory(file), read_trajectory(alone)
        assert np.array_equal(here.positions_m, there.positions_m)
        assert here.metadata["simulation"] == there.metadata["simulation"] == one


def test_what_could_be_solved_is_written_although_another_failed(
    grid, tmp_path, capfd, monkeypatch
):
    import slipstitch.physics.simulation.drop_and_drag as module

    record = module._Bench.record

    def failing(self, frame_done):
        if self.run.material == "royal-target":
            raise NotConverged("at 1 s it did not", {"positions_m": np.zeros((49, 3))})
        return record(self, frame_done)

    monkeypatch.setattr(module._Bench, "record", failing)
    out = f"--out {tmp_path}/good.parquet {tmp_path}/bad.parquet"
    assert run(f"{grid} {' '.join(IDS)} {out}") == 1
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"grid.yaml", "good.parquet", "bad.failed.npz"}
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
