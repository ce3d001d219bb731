"""What is wrong with data hides no effect and makes none: far runs, noisy sensors, their zeros."""

import numpy as np
import pandas as pd
import pytest
from support.criticised import change, judged, measured, verdict_on
from support.departures import campaign, planted

from slipstitch.criticise.inference.candidates import Judge
from slipstitch.criticise.inference.certificate import closest_rivals
from slipstitch.criticise.inference.faulty_data import robust_fit
from slipstitch.criticise.statement import sentence

# No run is far off by itself.
QUIET = {"outliers": 0.0, "scatter": dict.fromkeys(campaign.PROTOCOLS, (0.03, 0.02))}


def angle_of(factor):
    """Slip angles at so many times the friction."""
    return lambda t: np.degrees(np.arctan(np.tan(np.radians(t["angle_deg"])) * factor))


def test_runs_that_lie_far_off_against_a_strong_effect_are_told_from_it(tmp_path):
    planted(93, tmp_path, {"nap": 0.15}, "incline", **QUIET)
    table = pd.read_csv(tmp_path / "incline.csv")
    along = np.cos(np.radians(table["orientation_deg"])).to_numpy()
    # The wrong ones pull against the nap, where it is the strongest, one a specimen.
    strongest = np.argsort(-np.abs(along), kind="stable")
    wrong = strongest[~table["specimen_id"].iloc[strongest].duplicated().to_numpy()][:3]
    factor = np.ones(len(table))
    factor[wrong] = np.exp(-0.45 * np.sign(along[wrong]))
    change(tmp_path / "incline.csv", angle_deg=angle_of(factor))
    state = robust_fit(measured(tmp_path))
    far = {outlier.run_id for outlier in state.measurements.outliers}
    assert set(table["run_id"].iloc[wrong]) == far
    outcome = state.outcome(np.random.default_rng(1), 100)
    found = outcome.tests[outcome.strongest("mechanism")]
    assert found.mechanism in ("nap", "tilt")
    assert outcome.global_p < 0.02


def test_a_far_run_among_few_does_not_hide_in_the_scatter_that_it_makes(tmp_path):
    planted(81, tmp_path, {}, "drop_drag", **QUIET)
    m = measured(tmp_path)
    first = m.rows["run_id"].unique()[:8]
    folder = pd.read_csv(tmp_path / "drop_drag_runs.csv")
    folder[folder["run_id"].isin(first)].to_csv(tmp_path / "drop_drag_runs.csv", index=False)
    frames = pd.read_csv(tmp_path / "drop_drag.csv")
    frames[frames["run_id"].isin(first)].to_csv(tmp_path / "drop_drag.csv", index=False)
    few = measured(tmp_path)
    own = (few.rows["run_id"] == first[5]).to_numpy()
    values = {p.name: p.null for p in few.null_parameters}
    far = few.predict({"mu_face": values["mu_face"] + 0.35}, ()) - few.predict(values, ())
    few.y = few.y + np.where(own, far, 0.0)
    state = robust_fit(few)
    assert first[5] in {outlier.run_id for outlier in state.measurements.outliers}
    assert state.scatters["drop_drag"].run < 0.05


def test_a_change_for_good_within_a_session_is_told_from_the_scatter_of_specimens(tmp_path):
    changed = {"change": lambda contact, moving: np.where(contact["clock_min"] > 67, 0.75, 1.0)}
    planted(81, tmp_path, changed, "incline", outliers=0.0)
    state = robust_fit(measured(tmp_path))
    outcome = state.outcome(np.random.default_rng(1), 100)
    found = outcome.tests[outcome.strongest("generic")]
    assert found.covariate == "clock_min" and found.shape.startswith("a change for good at 6")
    assert outcome.global_p < 0.03


def test_the_scale_of_the_contact_camera_is_a_fault_and_no_stiffer_cloth(tmp_path):
    def spoil(frames):
        frames["contact_len_mm"] *= 1.05

    analysis = with_frames(tmp_path, spoil)
    assert analysis.verdict == "none"
    assert any("contact" in finding.quantity for finding in analysis.data_findings)


def test_the_noise_of_a_sensor_is_that_of_its_own_residuals(tmp_path):
    planted(81, tmp_path, {}, "drop_drag", **QUIET)
    m = measured(tmp_path)
    contact = (m.rows["quantity"] == "contact_len_mm").to_numpy()
    noise = 3 * m.u * np.random.default_rng(4).standard_normal(len(m.y))
    m.y = m.y + np.where(contact, noise, 0.0)
    state = robust_fit(m)
    louder = state.measurements.u / m.u
    assert 1.5 < np.median(louder[contact]) < 4.0
    assert np.median(louder[~contact]) < 1.3


def test_an_excess_at_rest_and_one_that_ages_are_one_where_every_rest_is_as_long(tmp_path):
    plan = campaign.draw_plan(410_026)
    assert plan.tie == ("static_kinetic", "ageing")
    campaign.write(plan, tmp_path)
    state = robust_fit(measured(tmp_path))
    null = state.fitted
    judge = Judge(state.measurements, null, state.scatters, {})
    static, ageing = (judge.candidate((name,)) for name in plan.tie)
    # Below what a trace shows there is no slope: the fit must not stay where it starts.
    assert static.credit == pytest.approx(ageing.credit, abs=1.0) and static.credit > 10
    assert closest_rivals(state)["ageing"] == (0.0, "static_kinetic")


def with_frames(folder, spoil):
    """The analysis of a drop-and-drag that holds nothing, its frames spoilt."""
    planted(82, folder, {}, "drop_drag", **QUIET)
    frames = pd.read_csv(folder / "drop_drag.csv")
    spoil(frames)
    frames.to_csv(folder / "drop_drag.csv", index=False)
    return judged(folder)


@pytest.mark.slow
def test_a_stage_that_starts_late_and_turns_early_is_said_and_nothing_blamed(tmp_path):
    def spoil(frames):
        frames["x_stage_mm"] += 2.4
        frames.loc[frames["phase"] == "rev", "te_x_mm"] -= 2.0

    analysis = with_frames(tmp_path, spoil)
    assert analysis.verdict == "none"
    found = {f.quantity: f for f in analysis.data_findings}
    assert {"start of the stage", "place of the turn"} <= set(found)
    low, high = found["start of the stage"].ci95
    assert low < 2.4 < high


def test_noise_of_one_quantity_is_a_finding(tmp_path):
    def spoil(frames):
        frames["contact_len_mm"] += 2.5 * np.random.default_rng(3).standard_normal(len(frames))

    analysis = with_frames(tmp_path, spoil)
    assert analysis.verdict == "none"
    assert {f.kind for f in analysis.data_findings} == {"noise"}
    assert any("contact" in f.quantity for f in analysis.data_findings)


def test_sound_sensors_are_not_blamed(tmp_path):
    assert with_frames(tmp_path, lambda frames: None).data_findings == []


def test_runs_that_scatter_more_than_usual_are_said_with_what_was_not_recorded(tmp_path):
    planted(93, tmp_path, {}, "incline", **QUIET)
    usual, analysis = verdict_on(tmp_path)
    assert usual["scatter_findings"] == []
    noise = np.exp(0.2 * np.random.default_rng(5).standard_normal(len(analysis.measurements.y)))
    change(tmp_path / "incline.csv", angle_deg=angle_of(noise), rh_pct=np.nan)
    verdict, _ = verdict_on(tmp_path)
    (found,) = verdict["scatter_findings"]
    assert found["protocol"] == "incline"
    assert 0.15 < found["run_scatter"] < 0.25
    assert "rh_pct" in found["record_next"]
    if verdict["verdict"] == "none":
        assert "relative humidity" in sentence(verdict)
