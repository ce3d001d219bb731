"""Cloth on cloth: distances, forces, friction between layers, and no passing through."""

import math

import numpy as np
import pytest
import warp as wp
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from support.mesh_intersections import crossing_pairs

from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.cloth import ClothMesh, ClothSolver, SolverSettings, proximity, rectangle
from slipstitch.physics.cloth.self_contact import SelfContact
from slipstitch.physics.fabric import isotropic_tables
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

THICKNESS_M = 1e-3
TURN = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])


def _pile(lower: ClothMesh, upper: ClothMesh) -> ClothMesh:
    """Two sheets as one mesh; the upper one's rest coordinates lie far from the lower one's."""
    n = lower.vertex_count
    return ClothMesh(
        np.concatenate([lower.rest_uv_m, upper.rest_uv_m + 1.0]),
        np.concatenate([lower.faces, upper.faces + n]).astype(np.int32),
        np.concatenate([lower.hinges, upper.hinges + n]).astype(np.int32),
        np.concatenate([lower.elimination_order, upper.elimination_order + n]),
        lower.shape,
    )


@wp.kernel
def _closest(
    kind: int,
    x: wp.array(dtype=wp.vec3d),
    nodes: wp.array(dtype=wp.vec4i),
    at: wp.array(dtype=wp.vec2d),
    gap: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    p = proximity.corners_of(x, nodes[i])
    at[i] = proximity.closest(kind, p)
    gap[i] = proximity.distance(kind, p)


@pytest.mark.parametrize("kind", [0, 1], ids=["vertex-triangle", "edge-edge"])
def test_distances_are_the_least_that_a_general_minimiser_finds(kind):
    random = np.random.default_rng(3)
    count = 60
    x = random.standard_normal((4 * count, 3))
    nodes = np.arange(4 * count).reshape(count, 4)
    at = wp.zeros(count, dtype=wp.vec2d)
    gap = wp.zeros(count, dtype=wp.float64)
    arrays = [wp.array(x, dtype=wp.vec3d), wp.array(nodes.astype(np.int32), dtype=wp.vec4i)]
    wp.launch(_closest, dim=count, inputs=[kind, *arrays, at, gap])
    for (a, b, c, d), found in zip(x[nodes], gap.numpy(), strict=True):
        # Between the points a + p0 u and c + p1 v: of a vertex and a triangle (u, v from b).
        start, u, v = (a - b, b - c, b - d) if kind == 0 else (a - c, b - a, c - d)
        in_triangle = {"type": "ineq", "fun": lambda p: 1 - p[0] - p[1]}
        best = min(
            minimize(
                lambda p, start=start, u=u, v=v: np.sum((start + p[0] * u + p[1] * v) ** 2),
                guess,
                method="SLSQP",
                bounds=[(0, 1)] * 2,
                constraints=() if kind else in_triangle,
                tol=1e-14,
            ).fun
            for guess in [(0.2, 0.2), (0.8, 0.1), (0.1, 0.8)]
        )
        assert found == pytest.approx(math.sqrt(best), abs=1e-5)


def _two_sheets(lower: ClothMesh, upper: ClothMesh, place_m: np.ndarray, gap_m: float, z_m=0.0):
    """Both as one mesh, and its positions: the upper one over places on the lower one."""
    mesh, n = _pile(lower, upper), lower.vertex_count
    x = np.full((mesh.vertex_count, 3), z_m)
    x[:n, :2], x[n:, :2] = lower.rest_uv_m, place_m
    x[n:, 2] += gap_m
    return mesh, x


def _crossed_strips(gap_m: float, friction: float = 0.0):
    """Two small sheets, the upper one turned, a gap apart; a contact that covers them."""
    lower, upper = rectangle(4, 4, 0.015, 0.015), rectangle(3, 3, 0.010, 0.010)
    place_m = (upper.rest_uv_m - 0.005) @ TURN.T + 0.0074
    mesh, x = _two_sheets(lower, upper, place_m, gap_m)
    layers = SelfContact(
        mesh, thickness_m=THICKNESS_M, stiffness_N_m=5.0, friction=friction, device="cpu"
    )
    layers.cover(x, x)
    return layers, x


def _solver(mesh, x, held, friction, **settings):
    """Of a soft cloth, some of whose vertices are held."""
    fixed = np.zeros((mesh.vertex_count, 3), bool)
    fixed[held] = True
    solver = ClothSolver(
        mesh,
        isotropic_tables(0.2, 200.0, 5e-5),
        x,
        friction=friction,
        fixed=fixed,
        settings=SolverSettings(self_contact=True, **settings),
    )
    solver.start()
    return solver


def _forces(layers, x):
    minus_force = wp.zeros(len(x), dtype=wp.vec3d)
    layers.add_forces(wp.array(x, dtype=wp.vec3d), minus_force)
    return -minus_force.numpy()


def _potential(layers, x):
    """Of k (d0 - d) d0 / d, from distances by the test's own geometry of crossing layers."""
    total, (at, gap) = 0.0, (wp.zeros(1, dtype=kind) for kind in (wp.vec2d, wp.float64))
    pairs = layers.pairs
    for nodes, kind, d0 in zip(
        layers.nodes, pairs.kinds.numpy(), pairs.thicknesses.numpy(), strict=True
    ):
        arrays = [wp.array(x, dtype=wp.vec3d), wp.array(nodes[None], dtype=wp.vec4i)]
        wp.launch(_closest, dim=1, inputs=[int(kind), *arrays, at, gap])
        if (d := gap.numpy()[0]) < d0:
            total += layers.stiffness_N_m * d0 * (d0 * math.log(d0 / d) - (d0 - d))
    return total


def test_normal_forces_are_minus_the_gradient_of_the_potential():
    layers, x = _crossed_strips(0.6e-3)
    x[16:, 2] += 1e-4 * np.sin(np.arange(9))
    layers.cover(x, x)
    force = _forces(layers, x)
    assert np.abs(force).max() > 1e-3
    step = 1e-8
    for node, axis in [(5, 2), (17, 2), (20, 0), (20, 1), (20, 2), (10, 2)]:
        moved = x.copy()
        moved[node, axis] += step
        ahead = _potential(layers, moved)
        moved[node, axis] -= 2 * step
        behind = _potential(layers, moved)
        assert force[node, axis] == pytest.approx((behind - ahead) / (2 * step), abs=1e-6)


def test_forces_between_layers_sum_to_nothing_and_turn_with_a_pair_that_turns_as_a_whole():
    layers, x = _crossed_strips(0.6e-3, friction=1.0)
    layers.move_anchors(wp.array(x, dtype=wp.vec3d))
    force = _forces(layers, x)
    assert np.abs(force.sum(axis=0)).max() < 1e-12
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12
    turn = Rotation.from_rotvec([0, 0.4, 0]).as_matrix()
    assert _forces(layers, x @ turn.T) == pytest.approx(force @ turn.T, abs=1e-9)


def _layer_on_incline(friction, multiple, step_s):
    """Slide of a sheet on a held sheet, both tilted: distance and mean acceleration in 0.5 s."""
    lower, upper = rectangle(9, 9, 0.04, 0.04), rectangle(4, 4, 0.015, 0.015)
    place_m = (upper.rest_uv_m - 0.0075) @ TURN.T + 0.0112
    mesh, x = _two_sheets(lower, upper, place_m, THICKNESS_M, 0.1)
    slope = math.atan(multiple * friction)
    solver = _solver(mesh, x, np.arange(81), friction, friction_tolerance=1e-6, damping_s=0.0)
    held = x.copy()
    for _ in range(200):  # come to rest on the lower sheet
        solver.advance(step_s, lambda _: held)
        solver.velocities_m_s *= 0.7
    for tilt in [*np.linspace(0, min(slope, math.atan(0.9 * friction)), 20), slope]:
        solver.set_gravity((GRAVITY_M_S2 * math.sin(tilt), 0, -GRAVITY_M_S2 * math.cos(tilt)))
        if tilt < slope:
            solver.advance(step_s, lambda _: held)
    solver.velocities_m_s[:] = 0
    before = solver.positions_m[81:].mean(axis=0)
    steps = round(0.1 / step_s)
    for _ in range(steps):
        solver.advance(step_s, lambda _: held)
    moved = solver.positions_m[81:].mean(axis=0) - before
    speed = solver.velocities_m_s[81:].mean(axis=0)
    expected = GRAVITY_M_S2 * (math.sin(slope) - friction * math.cos(slope))
    return moved, speed[0] / (steps * step_s), expected


@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_a_layer_on_a_layer_sticks_below_the_threshold_and_slides_above_as_theory_says(friction):
    moved, _, _ = _layer_on_incline(friction, 0.99, 0.01)
    assert np.abs(moved[:2]).max() < 1e-5
    _, acceleration, expected = _layer_on_incline(friction, 1.5, 0.002)
    assert acceleration == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("through", [False, True], ids=["beside", "through"])
def test_the_check_for_crossings_finds_an_edge_through_a_triangle(through):
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [5, 5, 0.5]])
    x[3:, 0] += 0.0 if through else 2.0
    assert bool(len(crossing_pairs(x, triangles))) == through


@pytest.mark.parametrize("speed_m_s", [0.1, 1.0, 5.0])
def test_layers_thrown_at_each_other_do_not_pass_through(speed_m_s):
    lower, upper = rectangle(9, 9, 0.04, 0.04), rectangle(6, 6, 0.02, 0.02)
    mesh, x = _two_sheets(lower, upper, upper.rest_uv_m + 0.0105, 0.02, 0.3)
    solver = _solver(mesh, x, [0, 8, 72, 80], 0.3, friction_tolerance=1e-3)
    solver.velocities_m_s[81:, 2] = -speed_m_s
    for _ in range(12):
        solver.advance(0.02, lambda _: x)
        assert not len(crossing_pairs(solver.positions_m, mesh.faces))
        assert solver.positions_m[81:, 2].mean() > solver.positions_m[:81, 2].min() - 0.01
    assert solver.record.touching_pairs > 0


def _frames_with_crossings(trajectory) -> int:
    return sum(len(crossing_pairs(x_m, trajectory.faces)) > 0 for x_m in trajectory.positions_m)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("self_contact", [True, False])
def test_cloth_lowered_into_a_heap_lies_on_itself(self_contact):
    lowered = {"drop_m": 0.18, "speed_m_s": 0.04, "acceleration_m_s2": 0.04, "strokes": 0}
    settings = SimulationSettings(
        vertices_per_side=13, frames=22, frame_rate_hz=4, self_contact=self_contact, stage=lowered
    )
    trajectory, _ = simulate_drop_and_drag(DropAndDrag("gray-interlock", 0.5, 1), settings)
    # Without it the layers do cross: the heap is a test.
    assert (_frames_with_crossings(trajectory) == 0) == self_contact


@pytest.mark.slow
@pytest.mark.parametrize(
    ("material", "friction"),
    [
        ("gray-interlock", 0.0),
        ("gray-interlock", 1.0),
        ("camel-ponte-roma", 0.5),
        ("camel-ponte-roma", 1.5),
        ("navy-sparkle-sweat", 0.0),
        ("navy-sparkle-sweat", 1.0),
    ],
)
def test_no_triangles_of_the_softest_fabrics_cross_in_the_whole_protocol(material, friction):
    settings = SimulationSettings(frames=315)  # 131 s
    trajectory, _ = simulate_drop_and_drag(DropAndDrag(material, friction, 1), settings)
    assert _frames_with_crossings(trajectory) == 0
