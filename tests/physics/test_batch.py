"""Many sheets evaluated at once: each gets the bits that it gets alone."""

import threading
from functools import partial

import numpy as np
import pytest
import warp as wp

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.cloth import (
    ClothSolver,
    Sheets,
    SolverSettings,
    bending,
    contact,
    elasticity,
    near_pairs,
    rectangle,
    run_together,
    self_contact,
)
from slipstitch.physics.cloth.batch import Work
from slipstitch.physics.fabric import ElasticTables, load_fabric
from slipstitch.physics.friction_law import FrictionLaw
from slipstitch.physics.gravity import GRAVITY_M_S2
from slipstitch.physics.simulation.drop_and_drag import (
    DropAndDrag,
    simulate_batch,
    simulate_drop_and_drag,
)

# Lowered at once to a heap, so that soft cloth comes to lie on itself.
HEAP = SimulationSettings(vertices_per_side=9, frames=14, frame_rate_hz=4, settle_s=0.2)
HEAP_PATH = StagePath(drop_m=0.18, speed_m_s=0.05, acceleration_m_s2=0.05, strokes=0)
HEAPS = [DropAndDrag("gray-interlock", 0.5, 1), DropAndDrag("royal-target", 0.1, 2)]


@pytest.fixture(scope="module")
def heaps():
    return simulate_batch(HEAPS, HEAP, HEAP_PATH)


@pytest.mark.parametrize("member", range(len(HEAPS)))
def test_a_batch_gives_the_bits_of_its_runs_one_by_one(heaps, member):
    one = HEAPS[member]
    alone, columns = simulate_drop_and_drag(one.material, one.friction, one.seed, HEAP, HEAP_PATH)
    together, columns_together = heaps[member]
    assert alone.positions_m.tobytes() == together.positions_m.tobytes()
    assert alone.metadata == together.metadata
    for name, values in columns.items():
        assert np.array_equal(values, columns_together[name])


def test_among_those_runs_are_halved_steps_and_touching_layers(heaps):
    records = [trajectory.metadata["solver"] for trajectory, _ in heaps]
    assert len({record["steps"] for record in records}) > 1
    assert any(record["halvings"] for record in records)
    assert any(record["touching_pairs"] for record in records)


MESH = rectangle(5, 5, 0.04, 0.04)
FREE = np.zeros((MESH.vertex_count, 3), dtype=bool)
FLAT_M = np.column_stack([MESH.rest_uv_m, np.full(MESH.vertex_count, -3e-7)])
LAWS = [0.3, FrictionLaw(0.4, {"load_power": {"load_power": -0.1}}), FrictionLaw(0.2), 0.1]
FABRICS = ["gray-interlock", "royal-target", "camel-ponte-roma", "11oz-black-denim"]


def sliding(member: int, sheets: Sheets | None = None, law=None, **settings) -> ClothSolver:
    """A patch thrown over a floor that is tilted, each at another speed and slope."""
    solver = ClothSolver(
        MESH,
        ElasticTables.of_fabric(load_fabric(FABRICS[member])),
        FLAT_M,
        friction=law or LAWS[member],
        fixed=FREE,
        settings=SolverSettings(**settings),
        gravity_m_s2=(0.3 * member, 0.0, -GRAVITY_M_S2),
        sheets=sheets,
        member=member if sheets else 0,
    )
    solver.velocities_m_s[:, 0] = 0.1 * (1 + member)
    solver.start()
    return solver


def slide(solver: ClothSolver, member: int) -> np.ndarray:
    for _ in range(6 + 2 * member):
        solver.advance(0.004 * (1 + member))
    return solver.positions_m


def test_sheets_of_other_laws_gravity_steps_and_durations_do_not_disturb_one_another():
    sheets = Sheets(MESH, FREE, len(LAWS))
    solvers = [sliding(k, sheets) for k in range(len(LAWS))]
    together = run_together(sheets, [partial(slide, one, k) for k, one in enumerate(solvers)])
    for k, positions_m in enumerate(together):
        assert np.array_equal(positions_m, slide(sliding(k), k))


def test_one_launch_serves_all_that_have_asked(monkeypatch):
    sheets = Sheets(MESH, FREE, len(LAWS))
    solvers = [sliding(k, sheets, law=0.3) for k in range(len(LAWS))]
    served = []
    run = Sheets.run

    def noted(self, work, members):
        served.append((work, len(members)))
        run(self, work, members)

    monkeypatch.setattr(Sheets, "run", noted)
    run_together(sheets, [partial(slide, one, 0) for one in solvers])
    assert served[0] == (Work.FORCES, len(LAWS))
    assert np.mean([count for work, count in served if work is Work.FORCES]) > 2


def test_a_sheet_that_cannot_be_solved_does_not_take_the_others_with_it():
    sheets = Sheets(MESH, FREE, 3)
    hopeless = {"newton_iterations_max": 1, "halvings_max": 0, "friction_tolerance": 1e-12}
    solvers = [sliding(0, sheets), sliding(1, sheets, **hopeless), sliding(2, sheets)]
    outcomes = run_together(sheets, [partial(slide, one, k) for k, one in enumerate(solvers)])
    assert isinstance(outcomes[1], NotConverged)
    assert outcomes[1].state["positions_m"].shape == (MESH.vertex_count, 3)
    for k in (0, 2):
        assert np.array_equal(outcomes[k], slide(sliding(k), k))


def test_any_other_error_ends_all_and_leaves_no_thread():
    sheets = Sheets(MESH, FREE, 2)
    solvers = [sliding(0, sheets), sliding(1, sheets)]
    before = threading.active_count()

    def broken():
        solvers[1].advance(0.004)
        raise ZeroDivisionError("of the task")

    with pytest.raises(ZeroDivisionError, match="of the task"):
        run_together(sheets, [partial(slide, solvers[0], 0), broken])
    assert threading.active_count() == before
    assert sheets.meeting is None


def test_sheets_that_are_evaluated_together_share_their_mesh():
    sheets = Sheets(rectangle(5, 5, 0.04, 0.04), FREE, 2)
    with pytest.raises(ValueError, match="share mesh"):
        sliding(0, sheets)


def test_every_kernel_compiles_for_a_gpu(tmp_path):
    """Without one: to PTX for compute capability 8.0; sums into shared entries are atomic."""
    name = contact.__name__
    for extended in (False, True):
        contact.contact_kernels(extended)
    modules = [one.__name__ for one in (elasticity, bending, near_pairs, self_contact, contact)]
    sources = {}
    for module in (*modules, f"{name}_coulomb", f"{name}_extended"):
        # Not with strip_hash: it would stay on, and kernels of other versions be loaded.
        options = {"arch": 80, "module_dir": tmp_path, "use_ptx": True}
        (compiled,) = wp.compile_aot_module(wp.get_module(module), **options)
        sources[module] = compiled.read_text()
        assert ".target sm_80" in sources[module]
    for module in (elasticity, bending):
        source = sources[module.__name__]
        assert ".add.f64" in source and ("atom." in source or "red." in source)


@pytest.mark.skipif(wp.is_cuda_available(), reason="there is such a device")
def test_a_device_that_is_not_there_is_bad_input():
    with pytest.raises(
        BadInput, match="device cuda: not available on this machine; available: cpu"
    ):
        simulate_batch(HEAPS, HEAP, device="cuda")


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_gives_the_hanging_cloth_of_the_cpu_to_a_micrometre():
    settings = HEAP.model_copy(update={"frames": 4})
    for (here, _), (there, _) in zip(
        simulate_batch(HEAPS, settings), simulate_batch(HEAPS, settings, device="cuda"), strict=True
    ):
        assert np.abs(here.positions_m - there.positions_m).max() < 1e-6
