"""What is wrong with a sensor is a finding about the data, neither a cause nor `unknown`."""

import numpy as np
import pandas as pd
import pytest
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.statement import sentence
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of


def judged(folder, spoil):
    make_case(81, "null", folder, plant=({}, ["drop_drag"]))
    frames = pd.read_csv(folder / "drop_drag.csv")
    spoil(frames)
    frames.to_csv(folder / "drop_drag.csv", index=False)
    return analyse(assemble(read_case(folder)), replicates=100)


@pytest.mark.slow
def test_a_stage_that_starts_late_and_turns_early_is_said_and_nothing_blamed(tmp_path):
    def spoil(frames):
        frames["x_stage_mm"] += 1.2
        frames.loc[frames["phase"] == "rev", "te_x_mm"] -= 2.0

    analysis = judged(tmp_path, spoil)
    assert analysis.verdict == "none"
    found = {f.quantity: f for f in analysis.data_findings}
    assert {"start of the stage", "place of the turn"} <= set(found)
    low, high = found["start of the stage"].ci95
    assert low < 1.2 < high


def test_noise_of_one_quantity_is_a_finding(tmp_path):
    def spoil(frames):
        frames["contact_len_mm"] += 2.5 * np.random.default_rng(3).standard_normal(len(frames))

    analysis = judged(tmp_path, spoil)
    assert analysis.verdict == "none"
    assert [f.kind for f in analysis.data_findings] == ["noise"] * len(analysis.data_findings)
    assert any("contact" in f.quantity for f in analysis.data_findings)


def test_sound_sensors_are_not_blamed(tmp_path):
    assert judged(tmp_path, lambda frames: None).data_findings == []


def test_runs_that_scatter_more_than_usual_are_said_with_what_was_not_recorded(tmp_path):
    make_case(93, "null", tmp_path, plant=({}, ["incline"]))
    usual = verdict_of(*judged_as_it_is(tmp_path), 1, "test")
    assert usual["scatter_findings"] == []
    table = pd.read_csv(tmp_path / "incline.csv")
    noise = np.exp(0.2 * np.random.default_rng(5).standard_normal(len(table)))
    ratio = np.tan(np.radians(table["angle_deg"])) * noise
    table["angle_deg"] = np.degrees(np.arctan(ratio))
    table["rh_pct"] = np.nan
    table.to_csv(tmp_path / "incline.csv", index=False)
    verdict = verdict_of(*judged_as_it_is(tmp_path), 1, "test")
    (found,) = verdict["scatter_findings"]
    assert found["protocol"] == "incline"
    assert 0.15 < found["run_scatter"] < 0.25
    assert "rh_pct" in found["record_next"]
    if verdict["verdict"] == "none":
        assert "relative humidity" in sentence(verdict)


def judged_as_it_is(folder):
    case = read_case(folder)
    return case, analyse(assemble(case), replicates=100)
