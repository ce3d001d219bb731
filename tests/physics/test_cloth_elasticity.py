"""The cloth's forces against energies and closed forms apart from its kernels; what solves them."""

import numpy as np
import pytest
import warp as wp

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import (
    Conditions,
    SolverSettings,
    bending,
    contact,
    elasticity,
    proximity,
    rectangle,
    self_contact,
)
from slipstitch.physics.cloth.bending import hinge_geometry
from slipstitch.physics.cloth.tangent import flexible_gmres
from slipstitch.physics.experiments.specimen import started
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

HINGE_N_M = 5e-5


UNDAMPED = SolverSettings(damping_s=0.0)


def _solver(tables):
    mesh = rectangle(4, 4, 0.02, 0.02)
    rest_m = np.column_stack([mesh.rest_uv_m, np.full(mesh.vertex_count, 1.0)])
    solver = started(SolverSettings(), mesh, tables, rest_m, np.zeros(rest_m.shape, bool), 0.3)
    solver._nodes.inverse_step_squared.fill_(0.0)  # forces only, no inertia
    return solver, rest_m


def _angle(x, hinge):
    """Dihedral angle by vectors in the plane across the edge."""
    a, b, c, d = x[hinge]
    along = (b - a) / np.linalg.norm(b - a)
    first, second = (p - a - np.dot(p - a, along) * along for p in (c, d))
    return np.pi - np.arccos(
        np.clip(first @ second / np.linalg.norm(first) / np.linalg.norm(second), -1, 1)
    )


def _energy(solver, x, k):
    """Gravity, membrane and hinges, straight from the definitions."""
    mesh = solver.mesh
    energy = GRAVITY_M_S2 * (solver.mass_kg * x[:, 2]).sum()
    for face, area in zip(mesh.faces, mesh.face_areas_m2(), strict=True):
        rest = (mesh.rest_uv_m[face[1:]] - mesh.rest_uv_m[face[0]]).T
        F = (x[face[1:]] - x[face[0]]).T @ np.linalg.inv(rest)
        G = (F.T @ F - np.eye(2)) / 2
        energy += area * (
            0.5 * k[0] * G[0, 0] ** 2
            + k[1] * G[0, 0] * G[1, 1]
            + 0.5 * k[2] * G[1, 1] ** 2
            + k[3] * G[0, 1] ** 2
        )
    return energy + _bending_energy(mesh, x)


def _bending_energy(mesh, x):
    length, area, _ = hinge_geometry(mesh)
    angles = np.array([_angle(x, hinge) for hinge in mesh.hinges])
    return (HINGE_N_M * length**2 / (8 * area) * angles**2).sum()


def test_forces_are_minus_the_gradient_of_the_energy():
    solver, rest_m = _solver(isotropic_tables(0.2, 100.0, HINGE_N_M, 0.3))
    x = rest_m + np.random.default_rng(0).normal(size=rest_m.shape) * 3e-4
    k = isotropic_tables(0.2, 100.0, HINGE_N_M, 0.3).stretching_N_m[0, 0, 0]
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[index] = 1e-7
        gradient[index] = (_energy(solver, x + step, k) - _energy(solver, x - step, k)) / 2e-7
    np.testing.assert_allclose(solver._evaluate(x), gradient, atol=2e-6 * np.abs(gradient).max())


def test_a_cylinder_bends_with_a_quarter_of_the_hinge_stiffness():
    """Bending energy of a sheet rolled to radius R: (ke / 4) area / (2 R^2)."""
    mesh = rectangle(41, 41, 0.2, 0.2)
    radius_m = 0.5
    u, v = mesh.rest_uv_m.T / radius_m
    x = radius_m * np.column_stack([u, np.sin(v), np.cos(v)])
    per_area = _bending_energy(mesh, x) / 0.04
    assert per_area == pytest.approx(HINGE_N_M / 4 / 2 / radius_m**2, rel=0.03)


def test_the_tangent_is_the_derivative_of_the_force_where_stress_is_tensile():
    """Membrane alone, held at its border and stretched: there the tangent is exact."""
    mesh = rectangle(5, 5, 0.02, 0.02)
    rest_m = np.column_stack([1.05 * mesh.rest_uv_m, np.full(25, 1.0)])
    inner = np.isin(np.arange(25), [6, 7, 8, 11, 12, 13, 16, 17, 18])
    x = rest_m + np.random.default_rng(1).normal(size=rest_m.shape) * 2e-5
    tables, fixed = isotropic_tables(0.2, 100.0, 1e-12, 0.3), np.repeat(~inner[:, None], 3, axis=1)
    solver = started(UNDAMPED, mesh, tables, x, fixed, 0.3)
    solver._nodes.inverse_step_squared.fill_(0.0)
    direction = np.where(inner[:, None], np.random.default_rng(2).normal(size=x.shape), 0.0)
    step = 1e-8
    ahead, behind = (solver._evaluate(x + sign * step * direction) for sign in (1, -1))
    solver._evaluate(x)
    solver._factorise()
    recovered = solver._symmetric_solve((ahead - behind).ravel() / (2 * step)).reshape(x.shape)
    np.testing.assert_allclose(recovered, direction, atol=1e-5 * np.abs(direction).max())


def test_on_a_cylinder_too_the_tangent_of_contact_is_the_derivative_of_its_force():
    """Vertices that stick and vertices that slip, pressed into a cylinder by very soft cloth."""
    radius_m = 0.02
    mesh = rectangle(5, 5, 0.02, 0.02)
    angle = (mesh.rest_uv_m[:, 1] - 0.01) / radius_m
    depth_m = np.random.default_rng(3).uniform(1e-7, 1e-6, 25)
    along, up = (radius_m - depth_m) * [np.sin(angle), np.cos(angle)]
    x = np.column_stack([along, mesh.rest_uv_m[:, 0], up - radius_m])
    ground = Conditions(nodal_force_N=1e-5, ground_curvature_per_m=1 / radius_m)
    tables, free = isotropic_tables(0.2, 1e-12, 1e-14), np.zeros((25, 3), bool)
    solver = started(UNDAMPED, mesh, tables, x, free, 0.3, ground)
    stretch_N = np.random.default_rng(4).normal(size=(25, 2)) * 5e-6
    solver.start(preload_N=stretch_N)
    solver._nodes.inverse_step_squared.fill_(0.0)
    solver._evaluate(x)
    nodes, blocks = solver._contact_blocks()
    states = solver.sheet.evaluated()[1]
    assert set(states) == {1, 2}  # some stick, some slip
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-11
        slope = (solver._evaluate(x + step) - solver._evaluate(x - step)) / 2e-11
        np.testing.assert_allclose(
            slope[nodes], blocks[:, :, axis], atol=1e-3 * solver.contact_stiffness_N_m.min()
        )
    force_N = solver._evaluate(x) - GRAVITY_M_S2 * solver.mass_kg[:, None] * [0, 0, 1]
    solver.positions_m = x
    np.testing.assert_allclose(solver.floor_forces()[states == 1], -force_N[states == 1], atol=1e-9)


def test_the_mesh_is_its_own_mirror_image_and_has_two_rows_and_columns():
    """Else the mesh, not physics, would decide to which side a symmetric cloth turns."""
    mesh = rectangle(9, 9, 0.2, 0.2)
    number = np.arange(81).reshape(9, 9)[:, ::-1].ravel()
    faces = {frozenset(face) for face in mesh.faces.tolist()}
    assert {frozenset(number[list(face)].tolist()) for face in faces} == faces
    with pytest.raises(BadInput, match="1 x 5 vertices: must be at least 2 x 2"):
        rectangle(1, 5, 0.2, 0.2)


def system(size, seed=0):
    generator = np.random.default_rng(seed)
    near = np.diag(generator.uniform(1.0, 10.0, size))
    exact = near + 0.3 * generator.normal(size=(size, size)) / np.sqrt(size)
    return near, exact, generator.normal(size=size)


def solved(near, exact, right, accuracy, products_max):
    calls = []

    def solve(y):
        calls.append(1)
        return np.linalg.solve(near, y)

    return flexible_gmres(solve, lambda y, d: exact @ d, right, accuracy, products_max), len(calls)


def test_a_system_that_is_not_symmetric_is_solved_to_the_accuracy_with_one_solve_a_product():
    near, exact, right = system(40)
    x, _ = solved(near, exact, right, 1e-12, 40)
    assert x == pytest.approx(np.linalg.solve(exact, right), rel=1e-9, abs=1e-12)
    x, solves = solved(near, exact, right, 0.1, 40)
    assert np.linalg.norm(exact @ x - right) <= 0.1 * np.linalg.norm(right)
    fewer, _ = solved(near, exact, right, 0.1, solves - 1)
    assert np.linalg.norm(exact @ fewer - right) > 0.1 * np.linalg.norm(right)


def test_an_exact_preconditioner_needs_one_product_and_more_never_let_the_residual_grow():
    near, exact, right = system(30, seed=3)
    x, solves = solved(near, near, right, 1e-10, 5)
    assert solves == 1
    assert x == pytest.approx(np.linalg.solve(near, right))
    residuals = [
        np.linalg.norm(exact @ solved(near, exact, right, 0.0, count)[0] - right)
        for count in range(1, 12)
    ]
    assert np.all(np.diff(residuals) <= 1e-12)


RUN = DropAndDrag("gray-interlock", 0.5, 1)
SETTINGS = SimulationSettings(vertices_per_side=9, frames=4, frame_rate_hz=4, settle_s=0.2)


@pytest.mark.slow
def test_every_kernel_compiles_for_a_gpu(tmp_path):
    """Without one: to PTX for compute capability 8.0; sums into shared entries are atomic."""
    sources = {}
    for module in (elasticity, bending, proximity, self_contact, contact):
        # Not with strip_hash: it would stay on, and kernels of other versions be loaded.
        options = {"arch": 80, "module_dir": tmp_path, "use_ptx": True}
        (compiled,) = wp.compile_aot_module(wp.get_module(module.__name__), **options)
        sources[module] = compiled.read_text()
        assert ".target sm_80" in sources[module]
    for module in (elasticity, bending):
        source = sources[module]
        assert ".add.f64" in source and ("atom." in source or "red." in source)


@pytest.mark.skipif(wp.is_cuda_available(), reason="there is such a device")
def test_a_device_that_is_not_there_is_bad_input():
    message = "device cuda: not available on this machine; available: cpu"
    with pytest.raises(BadInput, match=message):
        simulate_drop_and_drag(RUN, SETTINGS, device="cuda")


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_gives_the_hanging_cloth_of_the_cpu_to_a_micrometre():
    (here, _), (there, _) = (
        simulate_drop_and_drag(RUN, SETTINGS, device=device) for device in ("cpu", "cuda")
    )
    assert np.abs(here.positions_m - there.positions_m).max() < 1e-6
