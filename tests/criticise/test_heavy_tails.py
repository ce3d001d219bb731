"""Runs that lie far off and sensors noisier than stated hide no effect and make none."""

import numpy as np
import pandas as pd
import pytest
from support.departures import campaign
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.inference.candidates import Judge
from slipstitch.criticise.inference.certificate import closest_rivals
from slipstitch.criticise.inference.faulty_data import robust_fit
from slipstitch.criticise.measurements import assemble


def test_runs_that_lie_far_off_against_a_strong_effect_are_told_from_it(tmp_path):
    make_case(93, "single", tmp_path, plant=({"nap": {"nap": 0.15}}, ["incline"]))
    table = pd.read_csv(tmp_path / "incline.csv")
    along = np.cos(np.radians(table["orientation_deg"]))
    # The wrong ones pull against the nap, where it is the strongest, one a specimen.
    strongest = np.argsort(-np.abs(along.to_numpy()), kind="stable")
    wrong = strongest[~table["specimen_id"].iloc[strongest].duplicated().to_numpy()][:3]
    ratio = np.tan(np.radians(table["angle_deg"].to_numpy()))
    ratio[wrong] *= np.exp(-0.45 * np.sign(along.to_numpy()[wrong]))
    table["angle_deg"] = np.degrees(np.arctan(ratio))
    table.to_csv(tmp_path / "incline.csv", index=False)
    _, state = robust_fit(assemble(read_case(tmp_path)))
    far = {outlier.run_id for outlier in state.measurements.outliers}
    assert set(table["run_id"].iloc[wrong]) == far
    outcome = state.outcome(np.random.default_rng(1), 100)
    found = outcome.tests[outcome.strongest("mechanism")]
    assert found.mechanism in ("nap", "tilt")
    assert outcome.global_p < 0.02


def test_the_noise_of_a_sensor_is_that_of_its_own_residuals(tmp_path):
    make_case(81, "null", tmp_path, plant=({}, ["drop_drag"]))
    m = assemble(read_case(tmp_path))
    contact = (m.rows["quantity"] == "contact_len_mm").to_numpy()
    noise = 3 * m.u * np.random.default_rng(4).standard_normal(len(m.y))
    m.y = m.y + np.where(contact, noise, 0.0)
    _, state = robust_fit(m)
    louder = state.measurements.u / m.u
    assert 1.5 < np.median(louder[contact]) < 4.0
    assert np.median(louder[~contact]) < 1.3


def test_an_excess_at_rest_and_one_that_ages_are_one_where_every_rest_is_as_long(tmp_path):
    plan = campaign.draw_plan(410_026)
    assert plan.tie == ("static_kinetic", "ageing")
    campaign.write(plan, tmp_path)
    null, state = robust_fit(assemble(read_case(tmp_path)))
    judge = Judge(state.measurements, null, state.scatters, state.sensitivity, {})
    static, ageing = (judge.candidate((name,)) for name in plan.tie)
    # Below what a trace shows there is no slope: the fit must not stay where it starts.
    assert static.credit == pytest.approx(ageing.credit, abs=1.0) and static.credit > 10
    columns = null.jacobian, state.measurements.zero_columns
    rivals = closest_rivals(state.tests, *columns, state.groups, state.scatters)
    assert rivals["ageing"] == (0.0, "static_kinetic")
