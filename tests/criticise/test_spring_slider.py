"""(e) A slider pulled by a spring: closed form, event solver and time steps agree; effects show."""

import json

import numpy as np
import pandas as pd
import pytest
from support import departures
from support.criticised import judged, measured
from support.departures import planted

from slipstitch.cli.main import main
from slipstitch.criticise.protocols import spring_slider
from slipstitch.criticise.protocols.stick_slip import Slider, steady_cycle, steady_force
from slipstitch.physics.friction_law import Contact, FrictionLaw

SLIDER = Slider(mass_kg=0.06, spring_N_m=200.0, speed_m_s=0.002)
LOAD_N = 0.6


@pytest.mark.parametrize("excess, ageing", [(0.2, 0.0), (0.1, 0.08), (0.0, 0.0)])
def test_the_steady_cycle_is_that_of_the_energy_balance(excess, ageing):
    """The bench integrates the motion as well, which agrees with its energy balance."""
    effects = {"static_kinetic": {"static_kinetic": excess}, "ageing": {"ageing": ageing}}
    contact = Contact(LOAD_N, dwell_s=30.0, speed_m_s=SLIDER.speed_m_s)
    cycle = steady_cycle(SLIDER, FrictionLaw(0.4, effects), contact, contact)
    of_bench = {"orientation_deg": 0.0, "area_m2": 1e-3, "rh_pct": 50.0, "place_mm": 0.0}
    of_bench |= {"mass_kg": SLIDER.mass_kg, "spring_N_m": SLIDER.spring_N_m, "speed_mm_s": 2.0}
    level, half = departures.spring_slider.levels(of_bench, 0.4, effects, (LOAD_N, 0.0))
    assert 1e3 * cycle.level_N == pytest.approx(level)
    assert 1e3 * cycle.swing_N == pytest.approx(half, rel=1e-6)
    inertial = SLIDER.speed_m_s * np.sqrt(SLIDER.spring_N_m * SLIDER.mass_kg)
    stick = 2 * np.sqrt(max((1e-3 * half) ** 2 - inertial**2, 0.0)) / 0.4
    assert cycle.stick_s == pytest.approx(stick, abs=1e-6)
    assert cycle.first_swing_N >= cycle.swing_N - 1e-12


def test_the_steady_trace_swings_as_far_as_it_says_and_loads_at_the_springs_rate():
    time = np.linspace(0, 3, 60_001)
    force = steady_force(SLIDER, 0.24, 0.05, time)
    assert force.max() == pytest.approx(0.29, abs=1e-5)
    assert force.min() == pytest.approx(0.19, abs=1e-5)
    assert np.diff(force)[0] / time[1] == pytest.approx(200.0 * 0.002)
    assert np.abs(np.diff(force)).max() < 0.002


def test_traces_integrated_in_time_steps_have_the_features_of_the_closed_form(tmp_path):
    none = {"noise": {"spring_slider": 1e-2}, "scatter": {"spring_slider": (0.0, 0.0)}}
    none |= {"outliers": 0.0, "damping": 0.0}
    plan = planted(1, tmp_path, {"static_kinetic": 0.2}, "spring_slider", **none)
    found = measured(tmp_path)
    values = {"mu_face": np.log(plan.mu_face), "static_kinetic": 0.2}
    expected = found.predict(values, ("static_kinetic",))
    assert set(found.rows["quantity"]) == {
        "slider_level_mN",
        "slider_swing_mN",
        "slider_first_swing_mN",
    }
    assert np.median(np.abs(found.y / expected - 1)) < 3e-3
    # A run with one or two slips does not tell what reading does to them.
    assert found.y == pytest.approx(expected, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9037, 9077])
def test_drops_of_an_uneven_track_are_no_static_friction(seed, tmp_path):
    truth = departures.make_case(seed, tmp_path)
    assert truth["uneven_track"] == ["spring_slider"] and not truth["effects"]
    analysis = judged(tmp_path)
    blamed = {cause for causes in analysis.alternatives for cause in causes}
    assert not blamed & {"static_kinetic", "ageing"}


def test_the_verbs_take_the_protocol(tmp_path):
    case = tmp_path / "case"
    planted(3, case, {"static_kinetic": 0.15}, "spring_slider")
    verdict, out = tmp_path / "verdict.json", tmp_path / "predictions.csv"
    assert not main(["criticise", str(case), "--out", str(verdict)])
    assert json.loads(verdict.read_text())["causes"] == ["static_kinetic"]
    assert not main(["predict", str(verdict), str(case), "--out", str(out)])
    found = pd.read_csv(out)
    assert set(found["quantity"]) == {"slider_level_mN", "slider_swing_mN"}
    assert np.isfinite(found[["null_mean", "null_sd", "ext_mean", "ext_sd"]]).all(axis=None)


@pytest.mark.parametrize("slid_s, first", [(0.0, True), (2.0, False)])
def test_only_a_drop_at_the_end_of_the_loading_is_a_first_slip(slid_s, first):
    """A slider that has followed the track falls where the track does: no static excess."""
    slider = Slider(0.3, 60.0, 1.5e-3)
    time = np.arange(0.0, 20.0, 0.005)
    loaded_s = 600.0 / (1e3 * slider.spring_N_m * slider.speed_m_s)
    falls = time > loaded_s + slid_s
    force = np.where(falls, 300.0, np.minimum(600.0, 600.0 * time / loaded_s))
    later = falls & (time > loaded_s + slid_s + 0.3)
    force[later] = 450.0
    noise = np.random.default_rng(1).normal(0, 1.0, len(time))
    trace = pd.DataFrame({"t_s": time, "force_mN": force + noise})
    reading = spring_slider._read(trace, slider, 1.0)
    assert (reading.first_half_mN is not None) == first
    assert reading.first_unseen == (not first)


def sticking(load_kg, gap_s=0.0):
    """A noisy trace of a slider that sticks and slips over 30 mm, from a relaxed spring on."""
    slider = Slider(load_kg, 60.0, 1.5e-3)
    kinetic, excess = 0.35 * 9.81 * load_kg, 0.08 * 9.81 * load_kg
    loading_s = (kinetic + excess) / slider.spring_N_m / slider.speed_m_s
    time = np.arange(0.0, loading_s + 21.0, 0.012)
    # After the first stick the cycle begins with its slip, half a stick before the level.
    swing_N = np.hypot(excess, slider.inertial_force)
    stick_s = 2 * excess / slider.spring_N_m / slider.speed_m_s
    later = steady_force(slider, kinetic, swing_N, np.maximum(time - loading_s, 0.0) + stick_s)
    force = 1e3 * np.where(time < loading_s, slider.spring_N_m * slider.speed_m_s * time, later)
    trace = pd.DataFrame({"t_s": time, "force_mN": force})
    trace["force_mN"] += np.random.default_rng(2).normal(0, 8.0, len(time))
    return slider, trace[(time < loading_s + 4.0) | (time > loading_s + 4.0 + gap_s)]


@pytest.mark.parametrize("gap_s", [0.0, 1.0])
def test_neither_long_sticks_nor_gaps_nor_noise_are_an_uneven_track(gap_s):
    """Of the heavier sliders the record holds one to three slips, of which it is the most."""
    sliders, traces = zip(*(sticking(kg, gap_s) for kg in (0.1, 0.15, 0.2, 0.3, 0.4)), strict=True)
    noise = np.full(len(sliders), 8.0)
    readings = [spring_slider._read(t, s, 8.0) for t, s in zip(traces, sliders, strict=True)]
    inertial = np.array([1e3 * slider.inertial_force for slider in sliders])
    lines, of_tracks = spring_slider._features(readings, noise, inertial)
    level = {i: value for i, quantity, value, *_ in lines if quantity == spring_slider.LEVEL}
    masses = np.array([slider.mass_kg for slider in sliders])
    np.testing.assert_allclose([level[i] for i in range(5)], 1e3 * 0.35 * 9.81 * masses, rtol=0.03)
    assert (of_tracks < 0.015 * np.array(list(level.values()))).all()
    assert not any(len(line) > 4 for line in lines)  # no drop is taken as unseen
