"""An effect is hidden in the data; it must be found, named and sized, or not named at all."""

import numpy as np
import pytest
from support.criticised import judged, measured
from support.hidden_effects.bench import make_case

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.verdict import analyse

# One plain effect a mechanism, in the protocols that can tell it from the others.
PLANTED = {
    "load_power": ({"load_power": -0.15}, ["incline"]),
    "adhesion": ({"adhesion": 3.0}, ["incline"]),
    "static_kinetic": ({"static_kinetic": 0.35}, ["drag"]),
    "ageing": ({"ageing": 0.12}, ["incline"]),
    "rate": ({"rate": -0.15}, ["drag"]),
    "anisotropy": ({"anisotropy": 0.2}, ["incline"]),
    "nap": ({"nap": 0.12}, ["drag"]),
    "wear": ({"wear": 0.4, "r0": 2.0}, ["incline"]),
    "humidity": ({"humidity": 0.13}, ["incline"]),
    "tilt": ({"tilt": 2.5, "azimuth": 30.0}, ["incline"]),
    "mass_error": ({"mass_error": 0.35}, ["incline", "drag"]),
    "bending_error": ({"bending_error": 0.9}, ["drag", "drop_drag"]),
    "backlash": ({"backlash": 0.8}, ["drag"]),
    "camera_scale": ({"camera_scale": 1.05}, ["drop_drag"]),
    "force_offset": ({"force_offset": 2.0}, ["drag"]),
    "force_gain": ({"force_gain": 0.1}, ["drag"]),
    "time_lag": ({"time_lag": 0.3}, ["drop_drag"]),
}
LABEL = {"r0": "wear_r0", "azimuth": "tilt_azimuth"}


def case_judged(folder, seed, kind, **options):
    truth = make_case(seed, kind, folder, **options)
    return truth, judged(folder, 200)


def test_every_mechanism_is_planted():
    assert set(PLANTED) == set(MECHANISMS)


@pytest.mark.default_cases(4)
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_effect_is_named_and_sized(name, tmp_path):
    values, protocols = PLANTED[name]
    _, analysis = case_judged(tmp_path, 19, "single", plant=({name: values}, protocols))
    assert (analysis.verdict, analysis.causes) == ("cause", (name,))
    found = analysis.intervals(analysis.chosen.fitted).of_sizes()
    for key, value in values.items():
        entry = found[LABEL.get(key, key)]
        low, high = entry["ci95"]
        # Wider than the 95 % interval, which has to miss one time in twenty.
        slack = 0.75 * (high - low)
        assert low - slack <= value <= high + slack


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("protocols", [["incline", "strip"], ["drag"], ["drop_drag"]])
def test_nothing_hidden_nothing_named(protocols, hidden_seed, tmp_path):
    seed = hidden_seed(31)
    _, analysis = case_judged(tmp_path, seed, "null", plant=({}, protocols))
    # At 5 % a false alarm must happen now and then; a confident wrong name must not.
    assert analysis.verdict in ("none", "unknown") or analysis.global_p > 1e-3, seed


@pytest.mark.slow
def test_a_patch_of_the_substrate_is_unknown_and_located(tmp_path):
    patch = {"patch": {"size": 0.4, "at": 100.0, "width": 18.0}}
    _, analysis = case_judged(tmp_path, 5, "outside", plant=(patch, ["incline", "strip"]))
    assert analysis.verdict == "unknown"
    strongest = analysis.null_outcome.tests[analysis.null_outcome.strongest("generic")]
    assert strongest.covariate == "pos_x_mm"


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("fixed", [37, 41])
def test_for_a_covariate_that_was_not_recorded_nothing_else_is_blamed(fixed, hidden_seed, tmp_path):
    seed = hidden_seed(fixed)
    truth, analysis = case_judged(tmp_path, seed, "unrecorded")
    assert analysis.verdict != "cause" or set(analysis.causes) == set(truth["effects"]), seed


@pytest.mark.slow
def test_nothing_is_blamed_for_a_threefold_direction_that_was_not_recorded(tmp_path):
    truth, analysis = case_judged(tmp_path, 40, "unrecorded")
    assert analysis.verdict != "cause" or set(analysis.causes) == set(truth["effects"])


def test_exact_aliases_are_confounded(tmp_path):
    # One area and two loads: a power law and adhesion can both pass through two points.
    options = {"plant": None}
    for seed in range(400, 440):
        truth = make_case(seed, "ambiguous", tmp_path / str(seed), **options)
        if {"load_power", "adhesion"} & set(truth["effects"]):
            break
    analysis = judged(tmp_path / str(seed), 200)
    assert analysis.verdict in ("confounded", "none")
    if analysis.verdict == "confounded":
        assert {("load_power",), ("adhesion",)} <= set(analysis.alternatives)


def test_the_same_data_and_seed_give_the_same_verdict(tmp_path):
    make_case(8, "null", tmp_path, plant=({}, ["incline"]))
    first, second = (analyse(measured(tmp_path), seed=3) for _ in range(2))
    assert first.global_p == second.global_p
    assert np.array_equal(first.null.values, second.null.values)
