"""Known answers of theory: incline, capstan, cantilever, strips pushed, landed and dragged."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp, trapezoid
from scipy.linalg import eig
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc
from support.departures.strip import chebyshev

from slipstitch.base.errors import BadInput
from slipstitch.physics.experiments import landed_strip
from slipstitch.physics.experiments.cantilever import heavy_cantilever
from slipstitch.physics.experiments.capstan import capstan_theory
from slipstitch.physics.experiments.lateral_buckling import lateral_buckling_theory
from slipstitch.physics.experiments.plane import incline_theory
from slipstitch.physics.experiments.strip import (
    strip_buckling_load,
    strip_slip_strain,
    strip_state,
    strip_state_at_foot_angle,
)
from slipstitch.physics.experiments.strip_drag import flexible_strip_drag, steady_strip_drag


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.3, 0.5, 1.2])
def test_incline_sticks_up_to_the_angle_of_friction_then_loses_in_heat_what_friction_takes(
    friction,
):
    """Energy over 1 s from rest: m g h = ½ m v² + μ m g cos θ · distance."""
    assert incline_theory(friction, math.atan(0.999 * friction)) == 0.0
    assert 0.0 < incline_theory(friction, math.atan(1.001 * friction) + 1e-9) < 0.02
    slope = math.atan(friction) + 0.3
    acceleration = incline_theory(friction, slope)
    distance, speed = 0.5 * acceleration, acceleration
    heat = friction * 9.81 * math.cos(slope) * distance
    assert 9.81 * distance * math.sin(slope) == pytest.approx(0.5 * speed**2 + heat)


def test_capstan_is_the_limit_of_many_small_turns():
    friction, wrap, pieces = 0.4, math.radians(200), 200_000
    ratio = (1.0 + friction * wrap / pieces) ** pieces
    assert capstan_theory(friction, wrap) == pytest.approx(ratio, rel=1e-5)


def test_narrow_strip_buckles_where_the_torsion_equation_has_its_first_eigenvalue():
    """φ'' = −(k²/4)(1 − s)⁴ φ, φ(0) = 0, φ'(1) = 0: the smallest k, by Chebyshev collocation."""
    station, first, _ = chebyshev(40)
    left = first @ first
    right = -np.diag((1 - station) ** 4) / 4
    left[0], right[0] = np.eye(41)[0], 0.0
    left[-1], right[-1] = first[-1], 0.0
    values = eig(left, right, right=False)
    values = values[np.isfinite(values) & (np.abs(values) < 1e6)].real
    k = math.sqrt(values[values > 1].min())
    assert k == pytest.approx(12.854, abs=1e-3)
    # EI and GJ of a thin rectangle, over the plate's rigidity times width.
    for ratio in (0.0, 0.3, 0.5):
        bending, torsion = 1 - ratio**2, 2 * (1 - ratio)
        expected = k * math.sqrt(2) * (1 - ratio) * math.sqrt(1 + ratio)
        assert lateral_buckling_theory(bending, torsion) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("theory", "arguments", "said"),
    [
        (incline_theory, (-1.0, 0.1), "friction must be at least 0, not -1"),
        (incline_theory, (0.3, 2.0), "slope_rad"),
        (
            landed_strip.landed_strip_theory,
            (1e5,),
            "gamma must be at least 0 and at most 3000, not 100000",
        ),
        (strip_slip_strain, ("rough",), "friction must be a number, not 'rough'"),
        (strip_slip_strain, (math.nan,), "friction"),
        (strip_state, (0.34,), r"strain must be .* at most 0\.330"),
        (steady_strip_drag, (0.3, 0.2, math.inf, 0.01), "height_m"),
        (steady_strip_drag, (0.3, 0.1, 0.15, 0.01), "height_m must be below length_m"),
    ],
)
def test_impossible_arguments_are_refused_by_name(theory, arguments, said):
    with pytest.raises(BadInput, match=said):
        theory(*arguments)


def test_height_over_width_is_the_published_one_a_beam_s_and_the_textile_rule_s():
    """A beam's tip sinks by w L⁴ / 8 B; at 41.5° B = ρ g (L/2)³ (Peirce 1930, ASTM D1388)."""
    known = {0.01: 0.01 / 8, 1.0: 0.12456, 8.0: math.tan(math.radians(41.5)), 10.0: 1.0668}
    known |= {100.0: 5.888}
    ratios = {gamma: heavy_cantilever(gamma).height_over_width for gamma in (*known, 1e3, 1e4)}
    assert list(ratios.values()) == sorted(ratios.values())
    for gamma, ratio in known.items():
        assert ratios[gamma] == pytest.approx(ratio, rel=7e-4 if gamma == 8 else 1e-4)


@pytest.mark.parametrize("gamma", [5.0, 300.0])
def test_collocation_finds_the_same_tip_angle(gamma):
    def slope(s, state):
        return np.vstack((state[1], -gamma * (1.0 - s) * np.cos(state[0])))

    station = np.linspace(0.0, 1.0, 400)
    guess = np.vstack((1.5 * (1 - np.exp(-math.sqrt(gamma) * station)), np.zeros(400)))
    solution = solve_bvp(
        slope, lambda a, b: np.array([a[0], b[1]]), station, guess, tol=1e-9, max_nodes=20000
    )
    assert solution.success
    assert solution.y[0, -1] == pytest.approx(heavy_cantilever(gamma).tip_angle_rad, abs=1e-6)


PUBLISHED = (0.01238, 0.04687, 0.09690, 0.15487, 0.21446, 0.27156, 0.32399)


def test_slip_strains_and_the_flat_foot_are_the_published_ones():
    found = [strip_slip_strain(friction / 20) for friction in range(1, 8)]
    assert found == pytest.approx(PUBLISHED, abs=1e-5)
    assert strip_state(strip_slip_strain(0.2)).load_ratio == pytest.approx(0.2, abs=1e-7)
    flat = strip_state_at_foot_angle(math.pi / 2)
    assert flat.strain == pytest.approx(0.3303, abs=5e-5)
    assert flat.load_ratio == pytest.approx(0.3564, abs=5e-5)
    assert strip_slip_strain(0.3563) is not None
    assert strip_slip_strain(0.3565) is strip_slip_strain(1.5) is None
    # Without friction it slips as soon as it buckles: at the clamped-hinged load.
    assert strip_slip_strain(0.0) == 0.0 < strip_slip_strain(1e-3) < 1e-5
    buckling = strip_buckling_load()
    assert buckling == pytest.approx(20.19, abs=5e-3)
    assert strip_state_at_foot_angle(0.01).vertical_load == pytest.approx(buckling, rel=1e-4)


@pytest.mark.parametrize("foot_angle", [0.1, 0.5, 1.0, 1.4, math.pi / 2])
def test_state_satisfies_the_elliptic_integrals_of_the_elastica(foot_angle):
    """ψ = θ + atan(Q/P) swings like a pendulum: ψ'' = −R sin ψ, which Jacobi solved."""
    state = strip_state_at_foot_angle(foot_angle)
    total = math.hypot(state.vertical_load, state.horizontal_load)
    lean = math.atan2(state.horizontal_load, state.vertical_load)
    # Friction pushes the foot back under the clamp: ψ = lean at the clamp, lean − α at the foot,
    # where the pendulum is at rest, having passed the other turning point on its way.
    modulus = math.sin(0.5 * (foot_angle - lean))
    amplitude = math.asin(math.sin(0.5 * lean) / modulus)
    quarter = ellipk(modulus**2)
    offset = ellipkinc(amplitude, modulus**2)
    arcs = {sign * offset + turns * quarter: (sign, turns) for sign in (1, -1) for turns in (1, 3)}
    arc = min(arcs, key=lambda value: abs(value - math.sqrt(total)))
    assert arc == pytest.approx(math.sqrt(total), rel=1e-8)
    sign, turns = arcs[arc]
    # ∫ cos ψ ds = (2 E − arc)/√R with E the integral of dn² over that arc.
    second_kind = sign * ellipeinc(amplitude, modulus**2) + turns * ellipe(modulus**2)
    along = (2.0 * second_kind - arc) / math.sqrt(total)
    # With the foot under the clamp the whole chord is vertical: ∫ cos ψ = (1 − ε) cos lean.
    assert along == pytest.approx((1.0 - state.strain) * math.cos(lean), abs=1e-8)


def test_shape_has_the_strips_length_and_its_foot_under_the_clamp():
    state = strip_state(0.2)
    pieces = np.linalg.norm(np.diff(state.curve, axis=0), axis=1)
    assert pieces.sum() == pytest.approx(1.0, abs=1e-4)
    assert state.curve[-1] == pytest.approx((0.0, 0.8), abs=1e-8)


@pytest.mark.parametrize("friction", [0.05, 0.2, 0.3])
def test_without_weight_it_is_the_pushed_strip(friction):
    expected = strip_slip_strain(friction)
    assert landed_strip.landed_strip_slip_strain(friction, 0.0) == pytest.approx(expected, abs=1e-5)
    flat = strip_state_at_foot_angle(np.pi / 2)
    assert landed_strip.landed_strip_theory(0.0).load_ratio == pytest.approx(
        flat.load_ratio, abs=1e-5
    )


@pytest.mark.parametrize("gamma, threshold", [(10.0, 0.3802), (100.0, 0.4272), (1000.0, 0.3960)])
def test_thresholds_of_the_physics_page(gamma, threshold):
    assert landed_strip.landed_strip_theory(gamma).load_ratio == pytest.approx(threshold, abs=2e-4)
    assert landed_strip.landed_strip_slip_strain(threshold + 1e-3, gamma) is None
    assert landed_strip.landed_strip_slip_strain(threshold - 1e-3, gamma) > 0


def test_forces_and_moments_on_the_whole_strip_balance():
    """Moment at the clamp: Q at the foot's depth less the weight at its lever."""
    gamma = 300.0
    station, states, (_, horizontal) = landed_strip._flat_foot(gamma)
    _, curvature, across, down = states
    moment = horizontal * down[-1] - gamma * trapezoid(across, station)
    assert curvature[0] == pytest.approx(moment, abs=1e-3 * abs(curvature).max())
    assert curvature[-1] == pytest.approx(0.0, abs=1e-6)


LENGTH, HEIGHT = 0.20, 0.15


PULLS_MM = {0.1: None, 0.3: 11.64, 0.6: 19.2, 1.0: 26.0, 1.5: 31.8}


@pytest.mark.parametrize("friction", PULLS_MM)
@pytest.mark.parametrize("angle", [math.pi / 2, None])
def test_pull_is_the_published_one_whatever_the_bending_while_a_tail_lies_flat(friction, angle):
    flexible = flexible_strip_drag(friction, LENGTH, HEIGHT).pull_over_w_m
    for gravity_length in (0.002, 0.01, 0.02):
        drag = steady_strip_drag(friction, LENGTH, HEIGHT, gravity_length, holder_angle_rad=angle)
        assert drag.regime == "flat tail"
        assert drag.pull_over_w_m == pytest.approx(flexible, rel=5e-3)
    if angle and PULLS_MM[friction]:
        assert 1e3 * drag.pull_over_w_m == pytest.approx(PULLS_MM[friction], abs=0.05)


def test_flexible_strip_is_a_catenary_of_the_right_length_that_runs_into_the_floor():
    drag = flexible_strip_drag(0.5, LENGTH, HEIGHT)
    steps = np.diff(drag.curve_m, axis=0)
    assert np.hypot(*steps.T).sum() == pytest.approx(LENGTH, rel=1e-4)
    assert drag.curve_m[-1, 1] == pytest.approx(HEIGHT, rel=1e-9)
    scale = drag.pull_over_w_m
    ahead = drag.curve_m[1:, 0] - drag.flat_tail_m
    assert drag.curve_m[1:, 1] == pytest.approx(scale * (np.cosh(ahead / scale) - 1), abs=1e-12)


@pytest.mark.parametrize("friction", [0.05, 0.5, 1.5])
def test_elastica_tends_to_the_catenary_as_the_bending_rigidity_vanishes(friction):
    flexible = flexible_strip_drag(friction, LENGTH, HEIGHT)
    errors = []
    for gravity_length in (0.004, 0.002, 0.001):
        drag = steady_strip_drag(friction, LENGTH, HEIGHT, gravity_length)
        errors.append(abs(drag.holder_ahead_of_tail_m - flexible.holder_ahead_of_tail_m))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 2e-4
    limit = steady_strip_drag(friction, LENGTH, HEIGHT, 0.0)
    assert limit.holder_ahead_of_tail_m == flexible.holder_ahead_of_tail_m


def test_a_strip_may_stand_plumb_touch_with_its_end_alone_or_hang_clear_of_the_floor():
    plumb = steady_strip_drag(0.0, LENGTH, HEIGHT, 0.005)
    assert plumb.pull_over_w_m == 0.0
    assert plumb.floor_load_over_w_m == pytest.approx(LENGTH - HEIGHT, rel=1e-4)
    stiff = steady_strip_drag(1.0, LENGTH, HEIGHT, 0.05)
    assert (stiff.regime, stiff.flat_tail_m) == ("end only", 0.0)
    assert stiff.curve_m[:, 1].min() >= -1e-9
    assert stiff.pull_over_w_m == pytest.approx(stiff.floor_load_over_w_m)
    steps = np.diff(stiff.curve_m, axis=0)
    assert np.hypot(*steps.T).sum() == pytest.approx(LENGTH, rel=1e-4)
    clear = flexible_strip_drag(0.5, 0.10, HEIGHT)
    assert (clear.pull_over_w_m, clear.regime) == (0.0, "clear of the floor")


@pytest.mark.parametrize("hinge", [False, True])
@pytest.mark.parametrize("gravity_length", [0.02, 0.05])
@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_configurational_force_is_conserved_from_floor_to_holder(friction, gravity_length, hinge):
    """Tension + ½ B κ² − w y is the same all along a heavy elastica, from the shape alone."""
    angle = None if hinge else math.pi / 2
    drag = steady_strip_drag(friction, LENGTH, HEIGHT, gravity_length, holder_angle_rad=angle)
    curve = drag.curve_m[1:] if drag.flat_tail_m else drag.curve_m
    step = np.diff(curve, axis=0)
    link_angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    link = (LENGTH - drag.flat_tail_m) / len(step)
    curvature = np.diff(link_angle) / link
    angle = 0.5 * (link_angle[1:] + link_angle[:-1])
    point_load = drag.floor_load_over_w_m - drag.flat_tail_m
    upward = link * np.arange(1, len(step)) - point_load
    tension = drag.pull_over_w_m * np.cos(angle) + upward * np.sin(angle)
    force = tension + 0.5 * gravity_length**3 * curvature**2 - curve[1:-1, 1]
    toe = 1.5 * link_angle[0] - 0.5 * link_angle[1] if not drag.flat_tail_m else 0.0
    expected = drag.pull_over_w_m * math.cos(toe) - point_load * math.sin(toe) * (toe > 0.0)
    assert force == pytest.approx(expected, abs=5e-6)
    assert curve[-1, 1] == pytest.approx(HEIGHT, abs=1e-8)
