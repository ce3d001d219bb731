"""A drift in a sorted session is not blamed on what the session was sorted by."""

import numpy as np
import pandas as pd
import pytest
from support import departures
from support.criticised import change, judged, measured, verdict_on

from slipstitch.criticise.inference.rivals import rivals_of
from slipstitch.criticise.statement import sentence


@pytest.mark.slow
def test_a_drift_in_a_session_sorted_by_humidity_is_not_blamed_on_it(tmp_path):
    departures.planted(93, tmp_path, {}, "incline")
    table = pd.read_csv(tmp_path / "incline.csv")
    clock = np.sort(table["clock_min"].to_numpy())
    table = table.sort_values("rh_pct", kind="stable").reset_index(drop=True)
    drift = 1 + 0.3 * (clock - clock[0]) / np.ptp(clock)
    ratio = np.tan(np.radians(table["angle_deg"])) * drift
    table = table.assign(clock_min=clock, angle_deg=np.degrees(np.arctan(ratio)))
    table.to_csv(tmp_path / "incline.csv", index=False)
    analysis = judged(tmp_path)
    assert analysis.verdict in ("confounded", "unknown"), analysis.causes


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9027, 9029])
def test_faulty_sensors_do_not_tell_what_the_design_cannot(seed, tmp_path):
    # Noise 2 and 2.7 times what is stated, far readings: one rival is ahead by chance.
    truth = departures.make_case(seed, tmp_path)
    analysis = judged(tmp_path)
    assert analysis.verdict == "confounded"
    assert {(name,) for name in truth["tie"]} <= set(analysis.alternatives)


# Neither two mechanisms along one covariate stand for another law, nor one beside what it leaves.
@pytest.mark.slow
@pytest.mark.parametrize("seed, law", [(9031, "load_step"), (9312, "stribeck")])
def test_no_mechanism_stands_for_a_law_outside_the_library(seed, law, tmp_path):
    truth = departures.make_case(seed, tmp_path)
    assert set(truth["effects"]) == {law}
    analysis = judged(tmp_path)
    assert analysis.verdict == "unknown", analysis.causes


@pytest.mark.slow
def test_memory_of_the_load_before_is_not_blamed_on_the_load(tmp_path):
    departures.planted(9705, tmp_path, {"memory": 0.2}, "incline", "strip")
    analysis = judged(tmp_path)
    assert analysis.verdict in ("confounded", "unknown"), analysis.causes


def test_rivals_are_finite_where_single_rests_and_loads_are_unknown(tmp_path):
    departures.planted(93, tmp_path, {}, "incline")
    change(tmp_path / "incline.csv", dwell_s=lambda t: t["dwell_s"].where(t.index % 3 != 0))
    rivals = rivals_of(measured(tmp_path))
    assert {rival.name for rival in rivals} == {"time_in_session", "place", "run_before"}
    assert all(np.isfinite(rival.factors).all() for rival in rivals)


@pytest.mark.slow
def test_a_cause_is_named_beside_the_uneven_track_that_it_leaves(tmp_path):
    truth = departures.make_case(9533, tmp_path)
    assert set(truth["effects"]) == {"ageing"}
    assert truth["uneven_track"] == ["incline", "strip"]
    verdict, analysis = verdict_on(tmp_path, 300)
    assert analysis.causes == ("ageing",)
    said = sentence(verdict)
    assert "structure is left" in said and "position on the substrate" in said
