"""How often campaigns in which nothing is hidden would be said to hold something."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binomtest

from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.mixed_model import Scatter, make_groups
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.verdict import analyse

NO_ALARM = ("none", "insufficient")


@dataclass(frozen=True)
class FalseAlarms:
    """Verdicts that say something, of campaigns that hold nothing."""

    alarms: int
    campaigns: int

    def as_dict(self) -> dict:
        """The rate with its 95 % interval (Wilson)."""
        ci = binomtest(self.alarms, self.campaigns).proportion_ci(method="wilson")
        return {
            "estimate": round(self.alarms / self.campaigns, 4),
            "ci95": [round(float(ci.low), 4), round(float(ci.high), 4)],
            "campaigns": self.campaigns,
        }


def false_alarms(
    measurements: Measurements,
    null: Fit,
    scatters: dict[str, Scatter],
    campaigns: int,
    seed: int,
    replicates: int,
) -> FalseAlarms:
    """Judge features drawn from a fitted null, from the fit of the scatter to the verdict.

    Instruments and scatters are normal, sensors' zeros as usual; bounds stay what they are.
    """
    rng = np.random.default_rng([seed, 23])
    groups = make_groups(measurements, null.sensitivity())
    alarms = 0
    for number in range(campaigns):
        y = np.where(measurements.lower_bound, measurements.y, null.prediction)
        for group in groups:
            zeros = measurements.zero_columns[group.index]
            drawn = group.drawn(scatters[group.protocol], rng, 1)[:, 0]
            y[group.index] += drawn + zeros @ rng.standard_normal(zeros.shape[1])
        campaign = replace(measurements, y=y, rows=measurements.rows.assign(y=y), implausible=())
        alarms += analyse(campaign, seed + number, replicates).verdict not in NO_ALARM
    return FalseAlarms(alarms, campaigns)
