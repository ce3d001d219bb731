"""What is wrong with a sensor is a finding about the data, neither a cause nor `unknown`."""

import numpy as np
import pandas as pd
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.inference.analysis import analyse
from slipstitch.criticise.measurements import assemble


def judged(folder, spoil):
    make_case(81, "null", folder, plant=({}, ["drop_drag"]))
    frames = pd.read_csv(folder / "drop_drag.csv")
    spoil(frames)
    frames.to_csv(folder / "drop_drag.csv", index=False)
    return analyse(assemble(read_case(folder)), replicates=100)


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
