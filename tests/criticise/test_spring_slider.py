"""(e) A slider pulled by a spring: closed form, event solver and time steps agree; effects show."""

import json

import numpy as np
import pandas as pd
import pytest
from support import departures
from support.criticised import judged, measured
from support.hidden_effects.bench import make_case
from support.stick_slip_events import run

from slipstitch.cli.main import main
from slipstitch.criticise.protocols import spring_slider
from slipstitch.criticise.protocols.stick_slip import Slider, steady_cycle, steady_force
from slipstitch.physics.friction_law import Contact, FrictionLaw

SLIDER = Slider(mass_kg=0.06, spring_N_m=200.0, speed_m_s=0.002)
LOAD_N = 0.6
LAWS = {
    "static excess": FrictionLaw(0.4, {"static_kinetic": {"static_kinetic": 0.2}}),
    "ageing": FrictionLaw(
        0.4, {"static_kinetic": {"static_kinetic": 0.1}, "ageing": {"ageing": 0.08}}
    ),
    "none": FrictionLaw(0.4),
}


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slider")
    make_case(
        3, "single", folder, plant=({"static_kinetic": {"static_kinetic": 0.15}}, ["spring_slider"])
    )
    return folder


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_steady_cycle_is_that_of_the_event_solver(law):
    contact = Contact(LOAD_N, dwell_s=30.0, speed_m_s=SLIDER.speed_m_s)
    cycle = steady_cycle(SLIDER, law, contact, contact)
    kinetic = float(law.force_limit(contact, static=False))
    events = run(
        SLIDER,
        lambda place, stick: float(law.force_limit(Contact(LOAD_N, dwell_s=stick), static=True)),
        lambda place: kinetic,
        0.0,
        0.02,
    )
    half = 0.5 * (events.peak_N[-1] - events.trough_N[-1])
    assert cycle.swing_N == pytest.approx(half, rel=1e-6)
    assert cycle.stick_s == pytest.approx(events.stick_s[-1], abs=1e-6)
    assert cycle.first_swing_N >= cycle.swing_N - 1e-12


def test_without_a_static_excess_inertia_alone_swings_the_force():
    contact = Contact(LOAD_N, dwell_s=30.0, speed_m_s=SLIDER.speed_m_s)
    cycle = steady_cycle(SLIDER, LAWS["none"], contact, contact)
    assert cycle.swing_N == pytest.approx(SLIDER.speed_m_s * np.sqrt(200.0 * 0.06))
    assert cycle.stick_s == 0.0


def test_the_steady_trace_swings_as_far_as_it_says_and_loads_at_the_springs_rate():
    time = np.linspace(0, 3, 60_001)
    force = steady_force(SLIDER, 0.24, 0.05, time)
    assert force.max() == pytest.approx(0.29, abs=1e-5)
    assert force.min() == pytest.approx(0.19, abs=1e-5)
    assert np.diff(force)[0] / time[1] == pytest.approx(200.0 * 0.002)
    assert np.abs(np.diff(force)).max() < 0.002


def test_traces_integrated_in_time_steps_have_the_features_of_the_closed_form(tmp_path):
    planted = {"static_kinetic": {"static_kinetic": 0.2}}
    truth = make_case(1, "single", tmp_path, noise_free=True, plant=(planted, ["spring_slider"]))
    found = measured(tmp_path)
    values = {"mu_face": np.log(truth["mu_face"]), "static_kinetic": 0.2}
    expected = found.predict(values, ("static_kinetic",))
    assert set(found.rows["quantity"]) == {
        "slider_level_mN",
        "slider_swing_mN",
        "slider_first_swing_mN",
    }
    assert found.y == pytest.approx(expected, rel=6e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed, name, size", [(3, "static_kinetic", 0.15), (4, "ageing", 0.06)], ids=lambda x: str(x)
)
def test_a_planted_effect_is_named_and_sized(seed, name, size, tmp_path):
    make_case(seed, "single", tmp_path, plant=({name: {name: size}}, ["spring_slider"]))
    analysis = judged(tmp_path, 200)
    assert (analysis.verdict, analysis.causes) == ("cause", (name,))
    low, high = analysis.intervals(analysis.chosen.fitted).of_sizes()[name]["ci95"]
    slack = 0.75 * (high - low)
    assert low - slack <= size <= high + slack


@pytest.mark.slow
def test_drops_that_inertia_makes_are_no_effect(tmp_path):
    make_case(2, "null", tmp_path, plant=({}, ["spring_slider"]))
    assert judged(tmp_path, 300).verdict == "none"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9037, 9077])
def test_drops_of_an_uneven_track_are_no_static_friction(seed, tmp_path):
    truth = departures.make_case(seed, tmp_path)
    assert truth["uneven_track"] == ["spring_slider"] and not truth["effects"]
    analysis = judged(tmp_path)
    blamed = {cause for causes in analysis.alternatives for cause in causes}
    assert not blamed & {"static_kinetic", "ageing"}


def test_the_verbs_take_the_protocol(case, tmp_path):
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
