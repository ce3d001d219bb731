"""The catalogue of fabrics, and the whole law in the solver against an independent reference.

The reference shares no code with the solver: it reads the data file itself, samples the law on the
original's nodes by way of ``numpy.linalg.eigh``, interpolates with SciPy, and knows geometry from
vectors and differences.
"""

import json
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize

from slipstitch.base.errors import BadInput
from slipstitch.config.catalogue import FABRICS_FILE, fabric_names
from slipstitch.physics.cloth import Conditions, SolverSettings, rectangle
from slipstitch.physics.experiments.specimen import started
from slipstitch.physics.fabric import (
    ElasticTables,
    load_fabric,
    read_fabric_file,
    stretching_stiffness,
)

FABRICS = json.loads(FABRICS_FILE.read_text())["fabrics"]
DIRECTIONS_DEG = (0.0, 22.5, 45.0, 67.5, 90.0)
STRAINS = (0.01, 0.02, 0.05, 0.10, 0.15, 0.20)
DEMAND = 0.005  # of the uniaxial stress
LENGTH_M, WIDTH_M = 0.02, 0.0075

# -- the reference ------------------------------------------------------------------------------


@cache
def _law(name):
    """k0...k3 in N/m over (G00, G11, abs(G01)), as ARCSim and ARGUS sample the data."""
    rows = np.array(FABRICS[name]["stretching_N_m"], float)
    normal, shear = -0.25 + np.arange(30) / 30, np.arange(30) / 30
    a, b, c = np.meshgrid(normal, normal, shear, indexing="ij")
    C = np.stack([np.stack([1 + 2 * a, 2 * c], -1), np.stack([2 * c, 1 + 2 * b], -1)], -2)
    values, vectors = np.linalg.eigh(C)
    angle_deg = np.degrees(np.arctan2(abs(vectors[..., 1, 1]), abs(vectors[..., 0, 1])))
    angle_deg = np.where(np.isclose(values[..., 0], values[..., 1]), 0.0, angle_deg)
    measured = [np.interp(angle_deg, DIRECTIONS_DEG, rows[1:, column]) for column in range(4)]
    weight = np.clip(6 * (np.sqrt(np.maximum(values[..., 1], 0)) - 1), 0, 1)[..., None]
    k = 2 * np.maximum((1 - weight) * rows[0] + weight * np.stack(measured, -1), 0)
    return scipy.interpolate.RegularGridInterpolator((normal, normal, shear), k)


def _stress(name, G):
    """Second Piola-Kirchhoff stress in N/m at Green strain G, both 2 x 2."""
    low, high = -0.25, -0.25 + 29 / 30
    at = np.clip([G[0, 0], G[1, 1], abs(G[0, 1])], [low, low, 0], [high, high, 29 / 30])
    k0, k1, k2, k3 = _law(name)(at)[0]
    shear = k3 * G[0, 1]
    return np.array([[k0 * G[0, 0] + k1 * G[1, 1], shear], [shear, k2 * G[1, 1] + k1 * G[0, 0]]])


def _turn(angle_deg):
    """Columns: the direction at an angle to u, and the one across it."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class Uniaxial:
    """Pulled along x with free sides: nominal stress, and the deformation gradient to it."""

    stress_N_m: float
    F: np.ndarray


@cache
def _uniaxial(name, angle_deg):
    """The state without stress on the sides, followed from rest in steps of half a per cent."""
    Q = _turn(angle_deg)
    states, lateral = {}, np.zeros(2)
    for strain in np.arange(1, 41) * 0.005:
        along = ((1 + strain) ** 2 - 1) / 2

        def stress(q, along=along):
            return Q.T @ _stress(name, Q @ [[along, q[1]], [q[1], q[0]]] @ Q.T) @ Q

        for start in (lateral, lateral * 1.05, *(lateral + np.eye(2) * 0.01)):
            # By least squares, because where the shear stiffness is zero any shear does.
            found = scipy.optimize.least_squares(
                lambda q: stress(q)[1], start, xtol=1e-14, ftol=1e-14, gtol=1e-14
            )
            if np.abs(found.fun).max() < 1e-9:
                break
        assert np.abs(found.fun).max() < 1e-9
        lateral = found.x
        skew = 2 * lateral[1] / (1 + strain)
        F = np.array([[1 + strain, skew], [0, np.sqrt(1 + 2 * lateral[0] - skew**2)]])
        states[round(float(strain), 3)] = Uniaxial((1 + strain) * stress(lateral)[0, 0], F)
    return states


def _dihedral(x, hinge):
    """Angle by which the second face is turned out of the plane of the first."""
    a, b, c, d = x[hinge]
    along = (b - a) / np.linalg.norm(b - a)
    first, second = (p - a - np.dot(p - a, along) * along for p in (c, d))
    return np.arctan2(np.dot(np.cross(second, first), along), -np.dot(first, second))


def _hinge_stiffness(name, fold_deg, curvature_per_m):
    """ke of the data file in N/m at a fold line's direction from u and a curvature parameter."""
    columns = np.array(FABRICS[name]["bending_N_m"], float)
    by_row = [np.interp(curvature_per_m, [0, 5, 10, 15, 20], row) for row in columns]
    folded = np.degrees(np.arccos(abs(np.cos(np.radians(fold_deg)))))
    return max(np.interp(folded, [0, 45, 90], by_row), 0.0)


# -- stretching ---------------------------------------------------------------------------------


def _at_1_m(xy):
    return np.column_stack([xy, np.full(len(xy), 1.0)])


def _solver(name, mesh, angle_deg, x, fixed=None, **settings):
    """A weightless mesh of a fabric, cut at an angle to u."""
    return started(
        SolverSettings(**settings),
        replace(mesh, rest_uv_m=mesh.rest_uv_m @ _turn(angle_deg).T),
        ElasticTables.of_fabric(load_fabric(name)),
        x,
        np.zeros(x.shape, bool) if fixed is None else fixed,
        friction=1.0,
        conditions=Conditions(gravity_m_s2=(0.0, 0.0, 0.0)),
    )


def _patch(name, angle_deg, **settings):
    """A strip cut at an angle to u, its ends (x = 0 and LENGTH_M) held, its sides free."""
    mesh = rectangle(4, 9, WIDTH_M, LENGTH_M)
    xy = mesh.rest_uv_m
    ends = (xy[:, 0] == 0) | (xy[:, 0] == xy[:, 0].max())
    fixed = np.zeros((len(xy), 3), bool)
    fixed[:, 2] = fixed[ends] = True
    return _solver(name, mesh, angle_deg, _at_1_m(xy), fixed, **settings), xy


def _pull(solver, xy):
    """Force along x that holds the far end, over the width at rest, in N/m."""
    return solver.reactions()[xy[:, 0] == xy[:, 0].max(), 0].sum() / WIDTH_M


@pytest.mark.parametrize("name", FABRICS)
def test_uniaxial_stress_is_that_of_the_reference(name):
    """Five directions, strains to 20 %: the reference's state is in equilibrium with its sides
    free, and the pull that holds it is the reference's."""
    for angle_deg in DIRECTIONS_DEG:
        for strain in STRAINS:
            state = _uniaxial(name, angle_deg)[strain]
            solver, xy = _patch(name, angle_deg)
            solver.positions_m[:, :2] = xy @ state.F.T
            assert _pull(solver, xy) == pytest.approx(state.stress_N_m, rel=DEMAND)
            solver._nodes.inverse_step_squared.fill_(0.0)
            side = solver._evaluate(solver.positions_m)[:, :2]
            assert np.abs(side).max() < 1e-3 * DEMAND * state.stress_N_m * WIDTH_M


# Pulled at 67.5 degrees by more than about a tenth, the law of gray-interlock is unstable: the
# uniform state has a negative tangent stiffness, and the cloth strains unevenly instead.
STABLE = [(n, a) for n in FABRICS for a in DIRECTIONS_DEG if (n, a) != ("gray-interlock", 67.5)]


@pytest.mark.parametrize("name, angle_deg", [case for case in STABLE if case[1] in (22.5, 45.0)])
def test_a_patch_pulled_in_steps_finds_the_uniaxial_state(name, angle_deg, strains=(0.1, 0.2)):
    """Only the ends are moved; contraction and shear of the rest are the solver's to find."""
    solver, xy = _patch(name, angle_deg, damping_s=0.1, newton_iterations_max=60)
    before = np.eye(2)
    for count, strain in enumerate(strains):
        state = _uniaxial(name, angle_deg)[strain]

        def held(time_s, began_s=6.0 * count, before=before, after=state.F):
            share = min(time_s - began_s, 1.0)
            moved = xy @ ((1 - share) * before + share * after).T
            return _at_1_m(moved)

        for _ in range(4):
            solver.advance(0.25, held)
        for _ in range(5):
            solver.velocities_m_s[:] = 0.0
            solver.advance(1.0, held)
        before = state.F
        assert _pull(solver, xy) == pytest.approx(state.stress_N_m, rel=DEMAND)
        np.testing.assert_allclose(
            solver.positions_m[:, :2], xy @ state.F.T, atol=DEMAND * strain * LENGTH_M
        )


def test_reference_and_tables_give_the_value_that_the_original_is_known_for():
    """gray-interlock at rest: k22 = 109.8 N/m, not 69.0: zero strain is no node of the table."""
    fabric = load_fabric("gray-interlock")
    # Zero lies half way between nodes 7 and 8 (-1/60 and 1/60) in G00 and G11.
    nodes = ElasticTables.of_fabric(fabric).stretching_N_m[7:9, 7:9, 0]
    for at_rest in (_law("gray-interlock")([0, 0, 0])[0], nodes.mean(axis=(0, 1))):
        assert at_rest[2] == pytest.approx(109.8, abs=0.05)
    assert 2 * fabric.stretching_N_m[0, 2] == pytest.approx(69.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name, angle_deg", STABLE)
def test_a_patch_pulled_in_steps_finds_every_uniaxial_state(name, angle_deg):
    test_a_patch_pulled_in_steps_finds_the_uniaxial_state(name, angle_deg, STRAINS)


# -- bending ------------------------------------------------------------------------------------


def _two_faces(name, fold_deg):
    """A square of two faces whose diagonal lies at an angle to u, flat at height 1 m."""
    mesh = rectangle(2, 2, 0.005, 0.005)
    xy = mesh.rest_uv_m
    start, end = xy[mesh.hinges[0, :2]]
    now_deg = np.degrees(np.arctan2(*(end - start)[::-1]))
    x = _at_1_m(xy)
    solver = _solver(name, mesh, fold_deg - now_deg, x)
    solver._nodes.inverse_step_squared.fill_(0.0)
    return solver, x, mesh.hinges[0]


def _folded(x, hinge, angle_rad):
    """The tip of the second face turned about the edge."""
    a, b, _, d = x[hinge]
    axis = (b - a) / np.linalg.norm(b - a)
    arm = d - a - np.dot(d - a, axis) * axis
    turned = np.cos(angle_rad) * arm + np.sin(angle_rad) * np.cross(axis, arm)
    bent = x.copy()
    bent[hinge[3]] = d - arm + turned
    return bent, np.cross(axis, turned) / np.linalg.norm(arm), np.linalg.norm(arm)


@pytest.mark.parametrize("name", FABRICS)
@pytest.mark.parametrize("fold_deg", [0.0, 45.0, 90.0, 22.5, -45.0, 112.5])
def test_the_moment_of_a_fold_is_that_of_the_data(name, fold_deg):
    """At the five curvatures of the data, between them and beyond; folds up and down."""
    solver, x, hinge = _two_faces(name, fold_deg)
    length_m, area_m2 = 0.005 * np.sqrt(2), 0.005**2  # of the edge; of both faces
    for curvature_per_m in (1e-3, 5.0, 10.0, 15.0, 20.0, 2.5, 12.5, 40.0):
        angle = curvature_per_m * 2 * area_m2 / length_m
        stiffness_N_m = _hinge_stiffness(name, fold_deg, curvature_per_m)
        expected_N_m = stiffness_N_m * length_m**2 / (4 * area_m2) * angle
        for sign in (1, -1):
            bent, normal, arm_m = _folded(x, hinge, sign * angle)
            force_N = -solver._evaluate(bent)[hinge[3]]
            assert -sign * np.dot(force_N, normal) * arm_m == pytest.approx(expected_N_m, rel=1e-6)


@pytest.mark.parametrize("name", FABRICS)
def test_forces_of_a_crumpled_patch_are_those_of_the_reference(name):
    """All faces and hinges of a mesh cut on the bias, strained and folded at random.

    The reference's force is minus stress times the change of strain, and minus moment times the
    change of angle, both taken by differences; stiffness is held, as in the original.
    """
    mesh = rectangle(4, 5, 0.02, 0.025)
    uv = mesh.rest_uv_m @ _turn(30.0).T
    x = _at_1_m(mesh.rest_uv_m * [1.08, 1.03])
    x += np.random.default_rng(5).normal(size=x.shape) * 3e-4
    solver = _solver(name, mesh, 30.0, x)
    solver._nodes.inverse_step_squared.fill_(0.0)
    stretching_N, bending_N = np.zeros_like(x), np.zeros_like(x)
    for face in mesh.faces:
        rest = (uv[face[1:]] - uv[face[0]]).T
        area_m2 = abs(np.linalg.det(rest)) / 2

        def strain(p, face=face, rest=rest):
            F = (p[face[1:]] - p[face[0]]).T @ np.linalg.inv(rest)
            return (F.T @ F - np.eye(2)) / 2

        stress_N_m = _stress(name, strain(x))
        for index in ((vertex, axis) for vertex in face for axis in range(3)):
            stretching_N[index] -= area_m2 * np.sum(stress_N_m * _change(strain, x, index))
    for hinge in mesh.hinges:
        a, b, c, d = uv[hinge]
        length_m = np.linalg.norm(b - a)
        area_m2 = sum(abs(np.linalg.det([b - a, tip - a])) / 2 for tip in (c, d))
        angle = _dihedral(x, hinge)
        fold_deg = np.degrees(np.arctan2(*(b - a)[::-1]))
        curvature_per_m = abs(angle) * length_m / (2 * area_m2)
        stiffness_N_m = _hinge_stiffness(name, fold_deg, curvature_per_m)
        moment_N_m = stiffness_N_m * length_m**2 / (4 * area_m2) * angle
        for index in ((vertex, axis) for vertex in hinge for axis in range(3)):
            change = _change(lambda p, hinge=hinge: _dihedral(p, hinge), x, index)
            bending_N[index] -= moment_N_m * change
    force_N = -solver._evaluate(x)
    np.testing.assert_allclose(
        force_N, stretching_N + bending_N, atol=1e-4 * np.abs(bending_N).max()
    )


def _change(function, x, index, step_m=1e-6):
    """Derivative with respect to one coordinate, by a central difference."""
    ahead, behind = x.copy(), x.copy()
    ahead[index] += step_m
    behind[index] -= step_m
    return (function(ahead) - function(behind)) / (2 * step_m)


# -- the catalogue ------------------------------------------------------------------------------


def test_the_catalogue_holds_the_ten_fabrics_in_a_fixed_order_and_no_other():
    assert len(fabric_names()) == 10
    assert fabric_names()[5] == "gray-interlock"
    assert load_fabric("gray-interlock").areal_density_kg_m2 == 0.187
    with pytest.raises(BadInput, match=r"unknown material 'silk'; allowed: ivory-rib-knit"):
        load_fabric("silk")


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", fabric_names())
def test_a_stretch_in_a_measured_direction_gives_the_measured_row(name, part):
    """From row zero at rest to past the 1 + 1/6 of the tables.

    Independent of the law's own strain algebra: the strain comes from a stretch tensor.
    """
    rows = load_fabric(name).stretching_N_m
    for row, angle in enumerate(np.radians([0.0, 22.5, 45.0, 67.5, 90.0]), 1):
        direction = np.array([np.cos(angle), np.sin(angle)])
        stretch = np.eye(2) + max(part / 6, 0.2 * (part == 1)) * np.outer(direction, direction)
        G = (stretch.T @ stretch - np.eye(2)) / 2
        expected = 2 * np.maximum((1 - part) * rows[0] + part * rows[row], 0)
        found = stretching_stiffness(rows, G[0, 0], G[1, 1], G[0, 1])
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda f: f.pop("bending_N_m"), "bending_N_m is missing"),
        (lambda f: f.update(areal_density_kg_m2=-0.1), "areal_density_kg_m2 must be positive"),
        (lambda f: f["bending_N_m"][1].__setitem__(2, -1e-5), "bending_N_m must be positive"),
        (lambda f: f["stretching_N_m"][0].__setitem__(0, -3.0), "stretching_N_m must be positive"),
        (lambda f: f["stretching_N_m"].pop(), r"must be finite numbers of shape \(6, 4\)"),
        (lambda f: f["bending_N_m"][0].__setitem__(0, "soft"), "must contain only numbers"),
        (lambda f: f["bending_N_m"][0].__setitem__(0, float("nan")), "must be finite numbers"),
    ],
)
def test_a_bad_fabric_file_is_refused_in_one_line_that_names_the_fabric(tmp_path, change, message):
    content = json.loads(FABRICS_FILE.read_text())
    change(content["fabrics"]["gray-interlock"])
    path = tmp_path / "fabrics.json"
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput, match=f"fabric 'gray-interlock': .*{message}") as caught:
        read_fabric_file(path)
    assert "\n" not in str(caught.value)
