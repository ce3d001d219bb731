"""The stated gain is that of the models that are written down."""

import numpy as np
import pytest
from support.hidden_effects.bench import make_case

from slipstitch.criticise.case import read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.prediction import predict_model
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import verdict_of


@pytest.mark.slow
def test_scores_of_left_out_specimens_are_near_those_of_the_models_written_down(tmp_path):
    # An effect far beyond the scatter: the null needs a scatter of its own to predict with.
    truth = make_case(61040, "pair", tmp_path)
    assert set(truth["effects"]) == {"humidity", "time_lag"}
    case = read_case(tmp_path)
    measured = assemble(case)
    verdict = verdict_of(case, analyse(measured, replicates=100), 1, "test")
    assert "time_lag" in verdict["causes"]
    scores = []
    for name in ("null", "extended"):
        mean, sd = predict_model(verdict["models"][name], measured)
        z = (measured.y - mean) / sd
        scores.append(-0.5 * (np.log(2 * np.pi * sd**2) + z**2))
    null, extended = (score[~measured.lower_bound].mean() for score in scores)
    assert verdict["null"]["log_score_per_row"] == pytest.approx(null, abs=0.5)
    assert verdict["gain"]["estimate"] == pytest.approx(extended - null, abs=0.5)
