"""Traces as instruments write them: glitches, clocks, units and faults of the force cell."""

import numpy as np
import pandas as pd
import pytest
from support.criticised import measured, write_runs

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import read_case
from slipstitch.criticise.causes import data_words
from slipstitch.criticise.expected_traces import _READINGS as READINGS
from slipstitch.criticise.expected_traces import ASSUMPTIONS
from slipstitch.criticise.force_cells import cell_faults
from slipstitch.criticise.plausibility import implausible
from slipstitch.criticise.protocols.stick_slip import Slider, steady_force
from slipstitch.criticise.traces import glitches, noise_of, off_neighbours

KINETIC, STATIC = 0.40, 0.45
RUNS, LOAD_KG, SPRING, SPEED = 6, 0.05, 60.0, 2.0
NOMINAL = {"rho_kg_m2": 1e-2, "k_tether_N_m": 60.0, "B_Nm": 1e-6, "cloth_length_m": 0.2}


def slider_case(folder, samples=40, spoil=lambda trace: trace, seconds=5.0):
    """Stick-slip sampled so many times a natural period, each run spoilt."""
    rng, level = np.random.default_rng(1), 1e3 * KINETIC * LOAD_KG * 9.80665
    slider = Slider(LOAD_KG, SPRING, 1e-3 * SPEED)
    half = np.hypot((STATIC - KINETIC) * LOAD_KG * 9.80665, slider.inertial_force)
    step = 2 * np.pi * np.sqrt(LOAD_KG / SPRING) / samples
    (folder / "spring_slider").mkdir(parents=True)
    for i in range(RUNS):
        time = np.arange(0.0, seconds, step)
        force = 1e3 * steady_force(slider, 1e-3 * level * (1 + 0.01 * (i % 3)), half, time)
        force = np.minimum(SPRING * SPEED * time, force) + rng.normal(0, 0.5, len(time))
        trace = spoil(pd.DataFrame({"t_s": time, "force_mN": force}))
        trace.to_csv(folder / "spring_slider" / f"r{i}.csv", index=False)
    bench = {"spring_N_m": SPRING, "speed_mm_s": SPEED, "u_force_mN": 0.5}
    write_runs(folder, "spring_slider", RUNS, NOMINAL, added_mass_g=1e3 * LOAD_KG, **bench)
    return folder


def planned_case(name, rated=lambda samples: {}, **columns):
    """A maker of a case as a plain bench would give it, what ``rated`` says assumed."""

    def make(folder, samples=200, spoil=lambda trace: trace):
        folder.mkdir(parents=True, exist_ok=True)
        own = {"added_mass_g": 1e3 * LOAD_KG} | columns
        runs = write_runs(folder, name, RUNS, NOMINAL, **own)
        assumed = {assumption.name: assumption.value for assumption in ASSUMPTIONS}
        assumed |= {"mu_face": KINETIC} | rated(samples)
        readings = READINGS[name](runs, NOMINAL, assumed, np.random.default_rng(3))
        parts = [spoil(trace).assign(run_id=f"r{i}") for i, trace in enumerate(readings)]
        pd.concat(parts).to_csv(folder / f"{name}.csv", index=False)
        return folder

    return make


def plain_drag(samples):
    """So many readings a stroke, on an even track."""
    return {"drag_stroke_mm": 40.0, "drag_step_mm": 40.0 / samples, "drag_texture_sd": 0.0}


of_push = dict.fromkeys(("push_azimuth_deg", "turned_deg", "support"), np.nan)
of_push |= {
    "moved_mm": 11.0,
    "quiet_s": 0.4,
    "added_mass_g": 1500.0,
    "speed_mm_s": 2.5,
    "u_force_mN": 5.0,
}
MAKERS = {
    "spring_slider": slider_case,
    "drag": planned_case("drag", plain_drag, speed_mm_s=10.0, u_force_mN=0.5),
    "push": planned_case("push", **of_push),
    "drop_drag": planned_case("drop_drag", height_mm=100.0, speed_mm_s=10.0, u_pos_mm=0.3),
}
LEVELS = ("slider_level_mN", "force_plateau_mN", "push_level_mN", "lag_mm")


def spikes(size, many):
    def spoil(trace):
        rng = np.random.default_rng(len(trace))
        places = rng.choice(np.arange(40, 0.5 * len(trace) - 8, 8, int), many, False)
        trace.loc[places, "force_mN"] += size * rng.choice([-1, 1], many)
        return trace

    return spoil


def restarts(back_s):
    def spoil(trace):
        half = len(trace) // 2
        late = trace.index >= half
        trace.loc[late, "t_s"] -= back_s or trace["t_s"][half]
        return trace

    return spoil


@pytest.mark.parametrize("name, rate", [("spring_slider", 20), ("spring_slider", 80),
                                        ("drag", 100), ("drag", 800)])  # fmt: skip
@pytest.mark.parametrize("size, many", [(15.0, 2), (5e3, 1)])
def test_glitches_are_set_aside_and_said(name, rate, size, many, tmp_path):
    clean = measured(MAKERS[name](tmp_path / "clean", rate))
    found = measured(MAKERS[name](tmp_path / "case", rate, spikes(size, many)))
    assert not clean.findings
    (finding,) = found.findings
    assert finding.kind == "glitches" and finding.size == RUNS * many
    assert "set aside as glitches" in data_words([finding.as_dict()])[0]
    assert found.rows["quantity"].tolist() == clean.rows["quantity"].tolist()
    assert np.abs(found.y - clean.y) == pytest.approx(0.0, abs=1.5)


@pytest.mark.parametrize("name", ["spring_slider", "drag", "push"])
@pytest.mark.parametrize("first, many", [(0, 1), (0, 3), (-1, 1), (60, 10)])
def test_large_glitches_at_the_ends_and_in_bursts_are_set_aside(name, first, many, tmp_path):
    def spoil(trace):
        column = "force_x_mN" if name == "push" else "force_mN"
        place = first % len(trace)
        trace.loc[place : place + many - 1, column] = 3e4
        return trace

    clean = measured(MAKERS[name](tmp_path / "clean"))
    found = measured(MAKERS[name](tmp_path / "case", spoil=spoil))
    assert [(f.kind, f.size) for f in found.findings] == [("glitches", RUNS * many)]
    assert found.rows["quantity"].tolist() == clean.rows["quantity"].tolist()
    levels = found.rows["quantity"].isin(LEVELS)
    assert found.y[levels] == pytest.approx(clean.y[levels], rel=0.02)


@pytest.mark.parametrize("samples", [5, 20, 100])
def test_a_coarsely_sampled_saw_tooth_has_no_glitch(samples):
    place = np.arange(40 * samples)
    saw = 100.0 * (place % samples) / samples
    assert not glitches(saw + np.random.default_rng(0).normal(0, 0.1, len(saw)), 0.1).any()


@pytest.mark.parametrize(
    "name, spoil, words",
    [
        ("spring_slider", restarts(0.0), "clock starts again"),
        ("spring_slider", restarts(0.5), "clock starts again"),
        ("drag", restarts(0.5), None),
        ("spring_slider", lambda t: t.assign(t_s=t["t_s"].round(1)), "spaced evenly"),
        ("drag", lambda t: t.assign(t_s=t["t_s"].round(1)), "spaced evenly"),
        ("spring_slider", lambda t: pd.concat([t[:50], t[49:]]), "averaged"),
        ("drag", lambda t: pd.concat([t[:50], t[49:]]), "averaged"),
        ("spring_slider", lambda t: t[::-1], "sorted"),
        ("push", restarts(0.5), "clock starts again"),
        ("push", lambda t: t.assign(t_s=t["t_s"].round(1)), "spaced evenly"),
        ("push", lambda t: pd.concat([t[:50], t[49:]]), "averaged"),
        ("push", lambda t: t[::-1], "sorted"),
        ("drop_drag", lambda t: t.assign(t_s=t["t_s"].round(0)), "spaced evenly"),
        ("drop_drag", lambda t: pd.concat([t[:50], t[49:]]), "averaged"),
        ("drop_drag", lambda t: t[::-1], "sorted"),
    ],
)
def test_clocks_that_step_back_or_stand_still_are_read_and_said(name, spoil, words, tmp_path):
    clean = measured(MAKERS[name](tmp_path / "clean"))
    found = measured(MAKERS[name](tmp_path / "case", spoil=spoil))
    assert [words in finding.quantity for finding in found.findings] == [True] * bool(words)
    levels, expected = (m.rows["quantity"].isin(LEVELS) for m in (found, clean))
    assert found.y[levels] == pytest.approx(clean.y[expected], rel=0.03)


@pytest.mark.parametrize("name", ["spring_slider", "drag", "push"])
def test_bursts_at_one_time_are_refused_in_one_line(name, tmp_path):
    burst = lambda t: t.assign(t_s=t["t_s"].where(t.index % 50 > 20, t["t_s"][0]).cummax())  # noqa: E731
    with pytest.raises(BadInput, match="share their time with another"):
        read_case(MAKERS[name](tmp_path / "case", spoil=burst))


def test_two_recordings_of_a_stroke_in_one_run_are_refused(tmp_path):
    twice = lambda t: pd.concat([t[t["stroke"] == 0], t])  # noqa: E731
    with pytest.raises(BadInput, match="clock and stage both start again"):
        read_case(MAKERS["drag"](tmp_path / "case", spoil=twice))


def scaled(**factors):
    return lambda t: t.assign(**{name: t[name] * factor for name, factor in factors.items()})


@pytest.mark.parametrize(
    "name, spoil, words",
    [
        ("spring_slider", scaled(force_mN=1e-3), "forces in N, not mN?"),
        ("spring_slider", scaled(force_mN=0.1), "forces in cN"),
        ("spring_slider", scaled(force_mN=1 / 9.80665), "forces in gf"),
        ("spring_slider", scaled(t_s=1e3), "times in ms?"),
        ("spring_slider", scaled(t_s=1 / 60), "times in minutes?"),
        ("drag", scaled(force_mN=0.1), "forces in cN"),
        ("drag", scaled(force_mN=1 / 9.80665), "forces in gf"),
        ("drag", scaled(t_s=1e3), "times in ms"),
        ("push", scaled(force_x_mN=0.1, force_y_mN=0.1), "forces in cN"),
        ("push", scaled(force_x_mN=1 / 9.80665, force_y_mN=1 / 9.80665), "forces in gf"),
        ("push", scaled(force_x_mN=1e-3, force_y_mN=1e-3), "forces in N"),
        ("push", scaled(t_s=1e3), "times in ms"),
        ("drop_drag", scaled(t_s=1e3), "times in ms"),
    ],
)
@pytest.mark.parametrize("rate", [1, 4])
def test_units_that_the_data_refute_are_named(name, spoil, words, rate, tmp_path):
    samples = (30 if name == "spring_slider" else 200) * rate
    (line,) = implausible(read_case(MAKERS[name](tmp_path / "case", samples, spoil)))
    assert words in line


@pytest.mark.parametrize(
    "name, spoil, words",
    [
        ("drag", lambda t: t.assign(force_mN=t["force_mN"].abs()), "magnitudes"),
        ("drag", lambda t: t.assign(force_mN=t["force_mN"].clip(upper=196.0)), "clipped"),
        ("spring_slider", lambda t: t.assign(force_mN=t["force_mN"].clip(upper=205.0)), "clipped"),
        ("drag", lambda t: t.assign(force_mN=t["force_mN"] - 150.0), "tared under load"),
        ("spring_slider", lambda t: t.assign(force_mN=t["force_mN"] - 150.0), "tared under load"),
        ("drag", lambda t: t.assign(force_mN=t["force_mN"] + 10 * t["t_s"]), "drift"),
        ("spring_slider", lambda t: t.assign(force_mN=t["force_mN"] + 10 * t["t_s"]), "drift"),
    ],
)
@pytest.mark.parametrize("rate", [1, 4])
def test_faults_of_the_force_cell_are_findings(name, spoil, words, rate, tmp_path):
    samples = (30 if name == "spring_slider" else 100) * rate
    assert cell_faults(read_case(MAKERS[name](tmp_path / "clean", samples)))[1:] == ((), [])
    _, findings, _ = cell_faults(read_case(MAKERS[name](tmp_path / "case", samples, spoil)))
    assert [words in finding.quantity for finding in findings] == [True]


@pytest.mark.parametrize("samples, hidden", [(2, True), (40, False)])
def test_a_loading_slope_that_hides_between_two_readings_is_a_finding(samples, hidden, tmp_path):
    # Recorded from the first slip on, so that no relaxed spring shows its slope either.
    late = lambda t: t[t["t_s"] > 2.0]  # noqa: E731
    found = measured(slider_case(tmp_path / "case", samples, late, 8.0)).findings
    assert [f.size for f in found if "slope of loading" in f.quantity] == [RUNS] * hidden


NOISE_SEEDS = 60


@pytest.mark.parametrize("true", [1.0, 2.5])
def test_noise_is_found_under_bends_drops_and_uneven_sampling(true):
    factors, covered = [], 0
    for seed in range(NOISE_SEEDS):
        rng = np.random.default_rng(seed)
        x = np.sort(rng.uniform(0, 100, 600))
        saw = 40 * (x / 25 - np.floor(x / 25)) + 0.002 * x**2
        found = noise_of("cell", "force", [off_neighbours(x, saw + true * rng.normal(size=600))])
        low, high = found.ci95
        assert high / low < 1.6
        assert found.allowance == max(found.factor / 1.25, 1.0)
        covered += low < true < high
        factors.append(found.factor)
    assert covered >= 0.9 * NOISE_SEEDS
    # The mean of 60 is known to 1 %.
    assert np.mean(factors) == pytest.approx(true, rel=0.03)


def test_too_few_readings_tell_nothing():
    found = noise_of("cell", "force", [np.full(10, 5.0)])
    assert found.allowance == 1.0
    assert found.ci95[0] == 0.0
