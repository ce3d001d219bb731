"""Steady drag of a strip held at a height: catenary, heavy elastica, balances and figures."""

import math

import numpy as np
import pytest

from slipstitch.physics.experiments.strip_drag import flexible_strip_drag, steady_strip_drag

LENGTH, HEIGHT = 0.20, 0.15


@pytest.mark.parametrize(
    ("friction", "pull_mm"), [(0.3, 11.64), (0.6, 19.2), (1.0, 26.0), (1.5, 31.8)]
)
def test_pull_is_the_published_one(friction, pull_mm):
    pull = steady_strip_drag(friction, LENGTH, HEIGHT, 0.02).pull_over_w_m
    assert 1e3 * pull == pytest.approx(pull_mm, abs=0.05)


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.6, 1.0, 1.5])
@pytest.mark.parametrize("holder_angle", [math.pi / 2, None])
def test_pull_hardly_depends_on_bending_while_a_tail_lies_flat(friction, holder_angle):
    flexible = flexible_strip_drag(friction, LENGTH, HEIGHT).pull_over_w_m
    for gravity_length in (0.002, 0.01, 0.02):
        drag = steady_strip_drag(
            friction, LENGTH, HEIGHT, gravity_length, holder_angle_rad=holder_angle
        )
        assert drag.regime == "flat tail"
        assert drag.pull_over_w_m == pytest.approx(flexible, rel=5e-3)


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


def test_without_friction_it_hangs_plumb_and_stands_on_the_rest_of_its_weight():
    drag = steady_strip_drag(0.0, LENGTH, HEIGHT, 0.005)
    assert drag.pull_over_w_m == 0.0
    assert drag.floor_load_over_w_m == pytest.approx(LENGTH - HEIGHT, rel=1e-4)


def test_a_stiff_strip_touches_with_its_end_alone_and_still_stands_on_the_floor():
    drag = steady_strip_drag(1.0, LENGTH, HEIGHT, 0.05)
    assert drag.regime == "end only"
    assert drag.flat_tail_m == 0.0
    assert drag.curve_m[:, 1].min() >= -1e-9
    assert drag.pull_over_w_m == pytest.approx(drag.floor_load_over_w_m)
    steps = np.diff(drag.curve_m, axis=0)
    assert np.hypot(*steps.T).sum() == pytest.approx(LENGTH, rel=1e-4)


def test_a_strip_shorter_than_the_height_hangs_clear_of_the_floor():
    drag = flexible_strip_drag(0.5, 0.10, HEIGHT)
    assert (drag.pull_over_w_m, drag.regime) == (0.0, "clear of the floor")


@pytest.mark.parametrize("hinge", [False, True])
@pytest.mark.parametrize("gravity_length", [0.02, 0.05])
@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_configurational_force_is_conserved_from_floor_to_holder(friction, gravity_length, hinge):
    """Tension + ½ B κ² − w y is the same all along a heavy elastica, from the shape alone."""
    holder_angle = None if hinge else math.pi / 2
    drag = steady_strip_drag(
        friction, LENGTH, HEIGHT, gravity_length, holder_angle_rad=holder_angle
    )
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
