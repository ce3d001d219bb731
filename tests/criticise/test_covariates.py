"""Covariates that are no column of a table, but follow from the order of runs."""

import numpy as np
import pandas as pd

from slipstitch.criticise.covariates import load_before


def test_the_load_before_is_that_of_the_protocols_run_before_by_the_clock():
    rows = pd.DataFrame(
        {
            "protocol": ["drag"] * 4 + ["strip"],
            "run_id": ["a", "a", "b", "c", "s"],
            "clock_min": [20.0, 20.0, 10.0, 30.0, 5.0],
            "load_ratio": [2.0, 2.0, 1.0, 8.0, 3.0],
        }
    )
    np.testing.assert_allclose(load_before(rows), [0.5, 0.5, np.nan, 0.25, np.nan])
    # Without a clock, in the order of the table.
    found = load_before(rows.assign(clock_min=np.nan))
    np.testing.assert_allclose(found, [np.nan, np.nan, 2.0, 0.125, np.nan])
