"""The rules of the verdict, and what keeps a cause from being named."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.candidates import left_along_own, rarity
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.intervals import Intervals
from slipstitch.criticise.inference.structure import Test as Alternative
from slipstitch.criticise.verdict import RULES


def test_rules_have_names_of_their_own_and_the_last_one_names_the_cause():
    assert len({rule.name for rule in RULES}) == len(RULES)
    assert {rule.verdict for rule in RULES} == {
        "none",
        "cause",
        "confounded",
        "unknown",
        "insufficient",
    }
    assert all(rule.says.endswith(".") for rule in RULES)
    assert RULES[-1].verdict == "cause" and RULES[-1].reason(None) == ""


def fitted(cause, values, covariance):
    parameters = list(MECHANISMS[cause].parameters)
    none = np.zeros((0, 0))
    return Fit((cause,), parameters, np.array(values), 0.0, none, none, np.array(covariance))


@pytest.mark.parametrize(
    "cause, values, covariance, nothing",
    [
        ("backlash", [0.2], [[0.01]], True),
        ("backlash", [0.4], [[0.01]], False),
        ("force_gain", [-0.3], [[0.04]], True),
        ("force_gain", [0.3], [[0.004]], False),
        ("camera_scale", [1.02], [[0.0004]], True),
        ("camera_scale", [1.2], [[0.0004]], False),
        # How fast the wear comes on is hardly known, its size is.
        ("wear", [0.16, 3.0], [[0.02, 0.45], [0.45, 10.5]], False),
        ("tilt", [0.1, 0.1], [[0.01, 0.0], [0.0, 0.01]], True),
        ("tilt", [0.3, 0.4], [[0.01, 0.0], [0.0, 0.01]], False),
    ],
)
def test_a_size_may_be_nothing_where_its_interval_holds_no_effect(
    cause, values, covariance, nothing
):
    intervals = Intervals(fitted(cause, values, covariance), 20, {})
    assert intervals.may_be_nothing(cause) == nothing
    assert Intervals(fitted(cause, values, covariance), 20, {cause: 100.0}).may_be_nothing(cause)


def test_a_stage_is_blamed_for_lost_motion_only_against_its_prior_odds():
    assert rarity(("ageing",)) == 0.0
    assert rarity(("backlash", "ageing")) == pytest.approx(2 * np.log(4))


def test_a_shape_along_the_own_covariate_counts_by_itself():
    def left(covariate, log_p, statistic=9.0):
        tests = [Alternative(np.zeros((1, 1)), covariate=name) for name in (covariate, "rh_pct")]
        log_p, statistic = np.array([log_p, 0.1]), np.array([statistic, 0.1])
        return SimpleNamespace(tests=tests, log_p=log_p, statistic=statistic)

    ageing = SimpleNamespace(causes=("ageing",), credit=100.0)
    mass = SimpleNamespace(causes=("mass_error",), credit=100.0)
    assert left_along_own(ageing, left("dwell_s", 3.0)) == "dwell_s"
    assert left_along_own(ageing, left("dwell_s", 3.0, 4.0)) is None
    assert left_along_own(ageing, left("dwell_s", 1.5)) is None
    assert left_along_own(ageing, left("pos_x_mm", 9.0)) is None
    assert left_along_own(mass, left("pos_x_mm", 9.0)) is None
