"""The drop-and-drag run: path, invariants, bits; its file, compact, exact to the micrometre."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support import synthetic_cloth

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.cloth import ClothSolver
from slipstitch.physics.simulation import drop_and_drag as module
from slipstitch.physics.simulation import trajectory as files
from slipstitch.physics.simulation.drop_and_drag import (
    DropAndDrag,
    Landing,
    draw_perturbation,
    simulate_drop_and_drag,
)
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory, write_trajectory

SMALL = SimulationSettings(vertices_per_side=21, frames=12)
FRICTION = 0.3


@pytest.fixture(scope="module")
def run():
    return simulate_drop_and_drag(DropAndDrag("11oz-black-denim", FRICTION, 3), SMALL)


def test_the_stage_follows_the_protocol_of_the_paper():
    path = StagePath()
    assert path.duration_s == pytest.approx(131.0)
    x, z = path.position_m(np.array([0.0, 7.0, 38.0, 69.0, 100.0, 131.0]))
    np.testing.assert_allclose(x, [0, 0, 0.3, 0, 0.3, 0], atol=1e-12)
    np.testing.assert_allclose(z, [0.21, 0.15, 0.15, 0.15, 0.15, 0.15])
    time_s = np.linspace(0, 131, 131 * 50 + 1)
    for along in path.position_m(time_s):
        speed = np.gradient(along, time_s)
        assert np.abs(speed).max() <= 0.010 * (1 + 1e-6)
        assert np.abs(np.gradient(speed, time_s)).max() <= 0.010 * (1 + 1e-3)
    short = StagePath(drop_m=0.0025)  # it never reaches full speed
    assert short.drop_duration_s == pytest.approx(1.0)
    assert short.position_m(0.5)[1] == pytest.approx(0.21 - 0.00125)


def test_steps_are_converged_tabs_follow_the_stage_and_the_cloth_hangs_hardly_stretched(run):
    trajectory, columns = run
    assert columns["residual"].max() <= SMALL.friction_tolerance
    assert (columns["newton_iterations"][1:] > 0).all()
    held_m = trajectory.positions_m[:, trajectory.pinned]
    for axis, stage_m in ((0, trajectory.stage_x_m), (2, trajectory.stage_z_m)):
        moved_m = held_m[..., axis] - held_m[0, :, axis]
        assert np.abs(moved_m - (stage_m - stage_m[0])[:, None]).max() < 1e-6
    u = trajectory.uv[trajectory.pinned, 0] * 0.2
    assert (trajectory.uv[trajectory.pinned, 1] == 0).all()
    np.testing.assert_allclose(np.sort(u), [0, 0.01, 0.19, 0.2], atol=1e-9)
    height_m = trajectory.positions_m[..., 2]
    assert 0.005 < height_m[0].min() < 0.012
    # 0.324 kg/m2 over 0.2 m against some 2000 N/m: a stretch well below a per mille.
    assert np.ptp(height_m[0]) == pytest.approx(0.2, rel=5e-3)
    assert height_m.min() > -1e-5 and height_m[-1].min() < 1e-4  # it did get to the floor


def test_a_seed_is_a_bench_the_same_bits_again_and_the_same_at_every_coefficient(run):
    """Before the cloth touches the floor, to a hundredth of a pixel, the same images."""
    trajectory, columns = run
    own = DropAndDrag("11oz-black-denim", FRICTION, 3)
    again, columns_again = simulate_drop_and_drag(own, SMALL)
    assert trajectory.positions_m.tobytes() == again.positions_m.tobytes()
    assert (columns["newton_iterations"] == columns_again["newton_iterations"]).all()
    hanging = SMALL.model_copy(update={"frames": 2})
    low, high, other = (
        simulate_drop_and_drag(replace(own, friction=friction, seed=seed), hanging)[0]
        for friction, seed in ((0.1, 3), (1.5, 3), (FRICTION, 4))
    )
    assert low.metadata["perturbation"] == high.metadata["perturbation"]
    assert low.positions_m[:, :, 2].min() > 5e-3
    assert np.abs(low.positions_m - high.positions_m).max() < 5e-5
    assert trajectory.metadata["perturbation"] != other.metadata["perturbation"]
    assert np.abs(trajectory.positions_m[0] - other.positions_m[0]).max() > 1e-5


def test_perturbations_have_the_stated_spread_but_of_ideal_benches():
    drawn = [draw_perturbation(SMALL, seed) for seed in range(2000)]
    assert np.std([p.yaw_deg for p in drawn]) == pytest.approx(SMALL.yaw_sd_deg, rel=0.1)
    assert np.std([p.height_m for p in drawn]) == pytest.approx(SMALL.height_sd_m, rel=0.1)
    assert np.std([p.bending_factor for p in drawn]) == pytest.approx(0.03, rel=0.1)
    leaning = np.mean([p.natural_curl_per_m > 0 for p in drawn])
    assert leaning == pytest.approx(0.5, abs=0.05)
    one_side = SMALL.model_copy(update={"curl_side": "same"})
    sides = {draw_perturbation(one_side, seed).natural_curl_per_m for seed in range(20)}
    assert sides == {SMALL.natural_curl_per_m}
    turned = SMALL.model_copy(update={"curl_side": "alternating"})
    curls = [draw_perturbation(turned, seed=7, replicate=r).natural_curl_per_m for r in range(4)]
    assert curls == [0.5, -0.5, 0.5, -0.5]
    ideal = SMALL.model_copy(update={"ideal_replicates": 2})
    for replicate in (0, 1):
        bench = draw_perturbation(ideal, 5, replicate)
        assert (bench.yaw_deg, bench.height_m) == (0.0, 0.0)
        assert bench.density_factor == bench.stretching_factor == bench.bending_factor == 1.0
    assert draw_perturbation(ideal, 5, 2) == draw_perturbation(SMALL, 5)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("replicate", [0, 1])
def test_the_natural_curl_decides_to_which_side_the_cloth_sags(replicate):
    """Without it the flat cloth is an unstable equilibrium that rounding would decide."""
    ideal = {"frames": 8, "ideal_replicates": 2, "curl_side": "alternating"}
    trajectory, _ = simulate_drop_and_drag(
        DropAndDrag("11oz-black-denim", FRICTION, 0, replicate), SMALL.model_copy(update=ideal)
    )
    bulge = trajectory.positions_m[-1, :, 0]
    assert np.sign(bulge[np.abs(bulge).argmax()]) == (1 if replicate else -1)


def test_a_step_to_the_other_side_is_refused_while_the_cloth_lands(monkeypatch):
    """The way that the cloth goes is confirmed; its mirror image is not."""
    confirm = Landing.confirms
    decided = []

    def both_ways(landing, x, step_s):
        way_m = x[:, 0] - landing._solver.positions_m[:, 0]
        other = x.copy()
        other[:, 0] -= 2 * way_m
        answers = confirm(landing, x, step_s), confirm(landing, other, step_s)
        if landing._finer is None:
            assert answers == (True, True)
        elif np.sqrt(np.mean(way_m**2)) > settings.step_error_m:
            decided.append(answers)
        return answers[0]

    monkeypatch.setattr(Landing, "confirms", both_ways)
    settings = SimulationSettings(
        vertices_per_side=11, frames=5, settle_s=0.5, step_error_m=3e-4, steady_step_s=0.08
    )  # so coarse that steps are accepted that could be halved
    simulate_drop_and_drag(DropAndDrag("gray-interlock", FRICTION, 0), settings)
    assert decided and set(decided) == {(True, False)}


def test_a_step_that_is_not_confirmed_is_halved(monkeypatch):
    settings = SimulationSettings(vertices_per_side=5, frames=4, settle_s=0.0)
    plain, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", FRICTION, 0), settings)
    monkeypatch.setattr(Landing, "confirms", lambda landing, x, step_s: step_s < 0.06)
    halved, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", FRICTION, 0), settings)
    for count in ("steps", "refinements"):
        assert halved.metadata["solver"][count] > plain.metadata["solver"][count]


def test_no_long_step_is_taken_while_the_cloth_lands(monkeypatch):
    confirm = Landing.confirms
    long_ones, taken = [], []

    def noted(landing, x, step_s):
        if x[:, 2].min() >= 0:
            return confirm(landing, x, step_s)
        # By which step the cloth first touches is decided by the last bits: a long one is offered.
        if not long_ones:
            long_ones.append(confirm(landing, x, settings.steady_step_s))
        lands = landing._solver.time_s <= landing._touched_s + module.LANDING_S
        answer = confirm(landing, x, step_s)
        if lands and answer:
            taken.append(step_s)
        return answer

    monkeypatch.setattr(Landing, "confirms", noted)
    monkeypatch.setattr(ClothSolver, "foreseen_step_s", lambda solver: 10.0)
    settings = SMALL.model_copy(update={"frames": 6, "step_error_m": np.inf, "steady_step_s": 0.42})
    simulate_drop_and_drag(DropAndDrag("gray-interlock", FRICTION, 0), settings)
    assert long_ones == [False]
    assert taken and max(taken) < 1.01 * settings.step_used_s


@pytest.mark.slow
def test_steady_drag_takes_long_steps_and_goes_the_same_way():
    """Implicit Euler is exact for steady translation: what is longer than that costs accuracy."""
    settings = SimulationSettings(vertices_per_side=11, frames=96)
    short = settings.model_copy(update={"steady_step_s": 0.08})
    ours, columns = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.1, 0), settings)
    theirs, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.1, 0), short)
    taken = ours.metadata["solver"]["steps"]
    any_error = settings.model_copy(update={"frames": 6, "step_error_m": np.inf})
    fixed, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.1, 0), any_error)
    assert fixed.metadata["solver"]["steps"] == 24 + 5 * 5
    assert taken < 0.6 * theirs.metadata["solver"]["steps"]
    apart_m = np.linalg.norm(ours.positions_m - theirs.positions_m, axis=2).mean(axis=1)
    assert apart_m.mean() < 5e-5 and apart_m.max() < 1e-3
    assert (columns["residual"] <= settings.friction_tolerance).all()
    assert (columns["residual"] > 0).all()


@pytest.mark.slow
def test_frames_within_a_long_step_lie_between_its_ends():
    coarse = SMALL.model_copy(update={"frames": 25, "frame_rate_hz": 2.4, "time_step_s": 0.084})
    fine = coarse.model_copy(update={"frames": 24 * 5 + 1, "frame_rate_hz": 12.0})
    few, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.0, 0), coarse)
    many, columns = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.0, 0), fine)
    assert few.positions_m == pytest.approx(many.positions_m[::5], abs=1.2e-6)  # rounded
    # A long step counts its iterations where it ends.
    iterations = columns["newton_iterations"][1:].reshape(-1, 5)
    long = np.flatnonzero((iterations[:, :4] == 0).all(axis=1) & (iterations[:, 4] > 0))
    assert len(long)
    for step in long:
        places = many.positions_m[5 * step : 5 * step + 6].astype(float)
        part = np.linspace(0, 1, 6)[:, None, None]
        assert places == pytest.approx(places[0] + part * (places[5] - places[0]), abs=1.2e-6)


MOTION = Trajectory(**synthetic_cloth.motion(40))


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 25, 3), (5, 6, 3), (3, 169, 3)])
def test_positions_come_back_to_the_micrometre(shape):
    positions_m = np.random.default_rng(1).uniform(-8, 8, shape).astype(np.float32)
    there = files.decode(files.encode(positions_m))
    assert there.dtype == np.float32 and there.shape == shape
    np.testing.assert_array_equal(there, files.rounded(positions_m))
    assert np.abs(there.astype(float) - positions_m).max() < 1.01e-6  # half of it by float32 at 8 m
    np.testing.assert_array_equal(files.encode(there), files.encode(positions_m))


def test_the_format_is_the_second_difference_in_time_then_along_rows_and_columns():
    micrometres = np.zeros((3, 2, 2, 3))
    micrometres[:, 0, 0, 0] = [5, 7, 4]
    found = files.encode((micrometres * 1e-6).reshape(3, 4, 3)).reshape(3, 2, 2, 3)
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
    np.testing.assert_array_equal(read.positions_m, files.rounded(MOTION.positions_m))
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
        np.testing.assert_array_equal(read.positions_m, files.rounded(MOTION.positions_m))


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
