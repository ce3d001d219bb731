"""Stiffness-proportional damping: a mode's decay against closed forms.

A mode of angular frequency w under damping time tau decays as exp(-tau w^2 t / 2). Implicit Euler
damps by itself: its steps h of x'' = -w^2 (x + tau x') obey exactly
(1 + w^2 h (tau + h)) u[n+1] = (2 + w^2 h tau) u[n] - u[n-1], so that u shrinks by
(1 + w^2 h (tau + h))^(-1/2) a step: the method's own damping is that of a damping time h.
"""

import numpy as np
import pytest
import scipy.linalg

from slipstitch.physics.cloth import Conditions, SolverSettings, rectangle
from slipstitch.physics.experiments.specimen import started
from slipstitch.physics.fabric import isotropic_tables

COLUMNS, SPACING_M = 13, 0.005
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
