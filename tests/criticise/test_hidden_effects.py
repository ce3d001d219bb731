"""An effect is hidden in the data; it must be found, named and sized, or not named at all."""

import numpy as np
import pytest
from support import departures
from support.criticised import judged, measured
from support.departures import laws, planted

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.verdict import analyse

# One plain effect a mechanism, in the protocols that can tell it from the others.
PLANTED = (
    ({"load_power": -0.15}, ["incline"]),
    ({"adhesion": 3.0}, ["incline"]),
    ({"static_kinetic": 0.35}, ["drag"]),
    ({"ageing": 0.12}, ["incline"]),
    ({"rate": -0.15}, ["drag"]),
    ({"anisotropy": 0.2}, ["incline"]),
    ({"nap": 0.12}, ["drag"]),
    ({"wear": 0.4, "wear_r0": 2.0}, ["incline"]),
    ({"humidity": 0.13}, ["incline"]),
    ({"tilt": 2.5, "tilt_azimuth": 30.0}, ["incline"]),
    ({"mass_error": 0.35}, ["incline", "drag"]),  # of a heavy cloth
    ({"bending_error": 0.9}, ["drag", "drop_drag"]),
    ({"backlash": 0.8}, ["drag"]),
    ({"camera_scale": 1.05}, ["drop_drag"]),
    ({"force_offset": 2.0}, ["drag"]),
    ({"force_gain": 0.1}, ["drag"]),
    ({"time_lag": 0.3}, ["drop_drag"]),
    ({"static_kinetic": 0.15}, ["spring_slider"]),
    ({"ageing": 0.06}, ["spring_slider"]),
)


def test_every_mechanism_is_planted():
    assert {next(iter(values)) for values, _ in PLANTED} == set(MECHANISMS)


@pytest.mark.default_cases(4)
@pytest.mark.parametrize("values, protocols", PLANTED, ids=str)
def test_a_planted_effect_is_named_and_sized(values, protocols, tmp_path):
    name = next(iter(values))
    heavy = {"rho_kg_m2": 1.0, "thickness_m": 1e-3} if name == "mass_error" else {}
    planted(19, tmp_path, {name: values}, *protocols, nominal=heavy)
    analysis = judged(tmp_path, 200)
    assert (analysis.verdict, analysis.causes) == ("cause", (name,))
    found = analysis.intervals(analysis.chosen.fitted).of_sizes()
    for key, value in values.items():
        low, high = found[key]["ci95"]
        # Wider than the 95 % interval, which has to miss one time in twenty.
        slack = 0.75 * (high - low)
        assert low - slack <= value <= high + slack


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    "protocols", [["incline", "strip"], ["drag"], ["drop_drag"], ["spring_slider"]]
)
def test_nothing_hidden_nothing_named(protocols, hidden_seed, tmp_path):
    seed = hidden_seed(31)
    planted(seed, tmp_path, {}, *protocols)
    analysis = judged(tmp_path, 200)
    # At 5 % a false alarm must happen now and then; a confident wrong name must not.
    assert analysis.verdict in ("none", "unknown") or analysis.null_outcome.global_p > 1e-3, seed


@pytest.mark.slow
def test_a_patch_of_the_substrate_is_unknown_and_located(tmp_path):
    patch = {"patch": {"patch": 0.4, "centre_mm": 100.0, "width_mm": 45.0}}
    planted(5, tmp_path, patch, "incline", "strip")
    analysis = judged(tmp_path, 200)
    assert analysis.verdict == "unknown"
    strongest = analysis.null_outcome.tests[analysis.null_outcome.strongest("generic")]
    assert strongest.covariate == "pos_x_mm"


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("name", ["ageing", "humidity", "threefold", "operator_habit"])
def test_for_a_covariate_that_was_not_recorded_nothing_else_is_blamed(name, hidden_seed, tmp_path):
    seed, column = hidden_seed(37), laws.EFFECTS[name].column or "orientation_deg"
    effects = {name: laws.scaled(name, 2.0)}
    planted(seed, tmp_path, effects, "incline", "strip", missing=[column])
    analysis = judged(tmp_path, 200)
    assert analysis.verdict != "cause" or analysis.causes == (name,), seed


def test_exact_aliases_are_confounded(tmp_path):
    # One area and two loads: a power law and adhesion can both pass through two points.
    plans = (departures.draw_plan(seed, "ambiguous", False) for seed in range(400, 440))
    plan = next(plan for plan in plans if plan.tie == ("load_power", "adhesion"))
    departures.campaign.write(plan, tmp_path)
    analysis = judged(tmp_path, 200)
    assert analysis.verdict == "confounded"
    assert {("load_power",), ("adhesion",)} <= set(analysis.alternatives)


def test_the_same_data_and_seed_give_the_same_verdict(tmp_path):
    planted(8, tmp_path, {}, "incline")
    first, second = (analyse(measured(tmp_path), seed=3) for _ in range(2))
    assert first.null_outcome.global_p == second.null_outcome.global_p
    assert np.array_equal(first.null.values, second.null.values)
