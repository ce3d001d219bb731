"""In a time step: which curvature a fold follows; the decay of a damped mode in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from slipstitch.config.catalogue import fabric_names
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import ClothSolver, Conditions, SolverSettings, rectangle
from slipstitch.physics.cloth.bending import hinge_geometry
from slipstitch.physics.experiments.specimen import started
from slipstitch.physics.fabric import (
    CURVATURE_SPACING_PER_M,
    ElasticTables,
    isotropic_tables,
    load_fabric,
)

SPACING_M = 0.005
# Two rows are held, the third hangs on the fold between: one hinge along u.
MESH = rectangle(3, 2, 2 * SPACING_M, SPACING_M)
FLAT_M = np.column_stack([MESH.rest_uv_m, np.zeros(6)])
ABOVE = np.array([0.0, 0.0, 1.0])  # the floor is far below
HELD = np.repeat(np.arange(6)[:, None] < 4, 3, axis=1)
# Its own curvature follows from how far the third row is down.
PER_ANGLE = SPACING_M / (2 * SPACING_M**2)


def folded(angle_rad: float) -> np.ndarray:
    x = FLAT_M.copy()
    x[4:, 1] = SPACING_M * (1 + np.cos(angle_rad))
    x[4:, 2] = -SPACING_M * np.sin(angle_rad)
    return x


def fold(fabric: str, rule: str, start_m=FLAT_M, gravity_m_s2=0.0) -> ClothSolver:
    tables = ElasticTables.of_fabric(load_fabric(fabric))
    bending_N_m = tables.bending_N_m.copy()
    bending_N_m[1] = 1000 * bending_N_m[1].max()  # the third row's own diagonal stays flat
    tables = replace(tables, bending_N_m=bending_N_m)
    settings = SolverSettings(bending_stiffness_at=rule, damping_s=0.0)
    conditions = Conditions(gravity_m_s2=(0.0, 0.0, -gravity_m_s2))
    return started(settings, MESH, tables, start_m, HELD, conditions=conditions)


def curvatures_under_weight(fabric: str, rule: str, curvature_per_m: float, steps: int):
    """Curvature of the fold, step by step, under what holds a given one in balance."""
    table = load_fabric(fabric).bending_N_m[0]
    stiffness_N_m = np.interp(curvature_per_m, CURVATURE_SPACING_PER_M * np.arange(5), table)
    length_m, area_m2, _ = (one[along_u()] for one in hinge_geometry(MESH))
    angle = curvature_per_m / PER_ANGLE
    moment_Nm = stiffness_N_m * length_m**2 / (4 * area_m2) * angle
    mass_kg = fold(fabric, rule).mass_kg[4:].sum()
    gravity = moment_Nm / (mass_kg * SPACING_M * np.cos(angle))
    solver = fold(fabric, rule, folded(0.9 * angle) + ABOVE, gravity)
    found = []
    for _ in range(steps):
        solver.advance(1.0, lambda time_s: folded(0.0) + ABOVE)
        drop_m = 1.0 - solver.positions_m[4:, 2].mean()
        found.append(PER_ANGLE * np.arcsin(drop_m / SPACING_M))
    return np.array(found)


def along_u() -> int:
    (hinge,) = np.flatnonzero(hinge_geometry(MESH)[2] == 0)
    return hinge


def test_stiffness_of_the_start_jumps_to_and_fro_where_it_grows_fast():
    """Softly bent tango-red-jet-set: 8.9 to 30 uN m from 5 to 10 1/m."""
    found = curvatures_under_weight("tango-red-jet-set", "start", 7.5, 40)
    assert np.abs(np.diff(found[-10:])).min() > 3.0
    assert np.abs(found[-1] - found[-3]) < 0.1


@pytest.mark.parametrize("curvature_per_m", [3.0, 7.5, 12.0])
@pytest.mark.parametrize("fabric", ["tango-red-jet-set", "gray-interlock", "pink-ribbon-brown"])
def test_the_rising_rule_settles_at_the_law_of_the_fabric(fabric, curvature_per_m):
    found = curvatures_under_weight(fabric, "rising", curvature_per_m, 40)
    assert found[-1] == pytest.approx(curvature_per_m, rel=2e-3)


@pytest.mark.parametrize("fabric", fabric_names())
def test_within_a_step_the_moment_never_falls_as_the_fold_grows(fabric):
    """From any curvature, whatever the table does; at the beginning it is the fabric's own."""
    angles = np.linspace(-0.3, 0.3, 121)
    for start in (0.0, 0.03, 0.08, 0.13, 0.16, 0.19, 0.25):
        solver, fabrics_own = (
            fold(fabric, rule, folded(start) + ABOVE) for rule in ("rising", "end")
        )
        down = [solver._evaluate(folded(angle) + ABOVE)[4:] for angle in angles]
        tangents = [np.array([0.0, -np.sin(angle), -np.cos(angle)]) for angle in angles]
        moments = [SPACING_M * (f @ t).sum() for f, t in zip(down, tangents, strict=True)]
        assert np.diff(moments).min() > -1e-12 * np.ptp(moments)
        here = folded(start) + ABOVE
        assert solver._evaluate(here) == pytest.approx(fabrics_own._evaluate(here), abs=1e-15)


def test_a_fabric_that_the_cheap_rule_is_wrong_for_follows_the_end_of_a_step():
    settings = SimulationSettings()
    assert settings.bending_stiffness_at == "rising"
    assert settings.of_fabric("gray-interlock") == settings
    assert settings.of_fabric("tango-red-jet-set").bending_stiffness_at == "end"


# A mode of angular frequency w under damping time tau decays as exp(-tau w^2 t / 2). Implicit Euler
# damps by itself: its steps h of x'' = -w^2 (x + tau x') obey exactly
# (1 + w^2 h (tau + h)) u[n+1] = (2 + w^2 h tau) u[n] - u[n-1]: as a damping time h would.
COLUMNS = 13
AMPLITUDE_M = 1e-6  # linear, and far above the tolerance
MOVES = {"stretching": 0, "bending": 2}  # the axis that a mode moves along


def _sheet(motion, damping_s):
    """A narrow sheet along x with its ends held, free along one axis."""
    mesh = rectangle(3, COLUMNS, 2 * SPACING_M, (COLUMNS - 1) * SPACING_M)
    rest_m = np.column_stack([mesh.rest_uv_m, np.full(mesh.vertex_count, 1.0)])
    free = np.zeros(rest_m.shape, bool)
    inner = (rest_m[:, 0] > 1.5 * SPACING_M) & (rest_m[:, 0] < rest_m[:, 0].max() - 1.5 * SPACING_M)
    free[inner, MOVES[motion]] = True
    settings = SolverSettings(damping_s=damping_s, friction_tolerance=1e-8)
    weightless = Conditions(gravity_m_s2=(0.0, 0.0, 0.0))
    tables = isotropic_tables(0.2, 100.0, 5e-5)
    return started(settings, mesh, tables, rest_m, ~free, 1.0, weightless), rest_m, free


def _lowest_mode(motion):
    """Shape (on the free coordinates) and angular frequency, from differences of the forces."""
    solver, rest_m, free = _sheet(motion, 0.0)
    solver._nodes.inverse_step_squared.fill_(0.0)
    places = np.flatnonzero(free.ravel())
    stiffness = []
    for place in places:
        moved = np.zeros(free.size)
        moved[place] = AMPLITUDE_M
        moved = moved.reshape(free.shape)
        change = solver._evaluate(rest_m + moved) - solver._evaluate(rest_m - moved)
        stiffness.append(change.ravel()[places] / (2 * AMPLITUDE_M))
    mass = np.repeat(solver.mass_kg, 3)[places]
    squares, shapes = scipy.linalg.eigh(np.array(stiffness), np.diag(mass))
    return shapes[:, 0] / np.abs(shapes[:, 0]).max(), float(np.sqrt(squares[0]))


def _decay_per_s(motion, shape, step_s, damping_s, steps=60):
    """Decay rate of a mode let go at rest.

    A discrete oscillator obeys u[n+1] = p u[n] - q u[n-1] and shrinks by sqrt(q) a step: p and q
    by least squares.
    """
    solver, rest_m, free = _sheet(motion, damping_s)
    solver.positions_m[free] += AMPLITUDE_M * shape
    solver.start()
    mass = np.broadcast_to(solver.mass_kg[:, None], free.shape)[free]
    u = []
    for _ in range(steps):
        u.append((mass * shape) @ (solver.positions_m - rest_m)[free])
        solver.advance(step_s)
    u = np.array(u) / u[0]
    _, q = np.linalg.lstsq(np.column_stack([u[1:-1], -u[:-2]]), u[2:], rcond=None)[0]
    return -np.log(q) / (2 * step_s)


@pytest.fixture(scope="module", params=MOVES)
def mode(request):
    return request.param, *_lowest_mode(request.param)


def test_the_stretching_mode_has_the_frequency_of_a_bar():
    """Held at ends ten spacings apart: w = pi/L sqrt(E t / rho)."""
    _, w = _lowest_mode("stretching")
    assert w == pytest.approx(np.pi / (10 * SPACING_M) * np.sqrt(100.0 / 0.2), rel=0.02)


@pytest.mark.parametrize("damping_per_period", [0.0, 0.02, 0.1])
def test_a_mode_decays_as_the_discrete_oscillator(mode, damping_per_period):
    motion, shape, w = mode
    tau, h = damping_per_period / w, 0.05 / w
    expected = np.log1p(w**2 * h * (tau + h)) / (2 * h)
    assert _decay_per_s(motion, shape, h, tau) == pytest.approx(expected, rel=1e-4)


def test_without_the_method_s_own_share_the_decay_is_that_of_the_continuum(mode):
    """The second way: no formula of the method, but the rate of the undamped run taken off and
    the rest extrapolated from two steps to step zero."""
    motion, shape, w = mode
    tau = 0.1 / w

    def share(h):
        return _decay_per_s(motion, shape, h, tau) - _decay_per_s(motion, shape, h, 0.0)

    coarse, fine = share(0.05 / w), share(0.025 / w)
    assert 2 * fine - coarse == pytest.approx(tau * w**2 / 2, rel=0.005)
