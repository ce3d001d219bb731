"""The noise of a trace is told by the trace, wherever it bends and however it is sampled."""

import numpy as np
import pytest

from slipstitch.criticise.traces import noise_of, off_neighbours

SEEDS = 60


@pytest.mark.parametrize("true", [1.0, 2.5])
def test_noise_is_found_under_bends_drops_and_uneven_sampling(true):
    factors, covered = [], 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        x = np.sort(rng.uniform(0, 100, 600))
        saw = 40 * (x / 25 - np.floor(x / 25)) + 0.002 * x**2
        found = noise_of("cell", "force", [off_neighbours(x, saw + true * rng.normal(size=600))])
        low, high = found.ci95
        assert high / low < 1.6
        assert found.allowance == max(found.factor / 1.25, 1.0)
        covered += low < true < high
        factors.append(found.factor)
    assert covered >= 0.9 * SEEDS
    # The mean of 60 is known to 1 %.
    assert np.mean(factors) == pytest.approx(true, rel=0.03)


def test_too_few_readings_tell_nothing():
    found = noise_of("cell", "force", [np.full(10, 5.0)])
    assert found.allowance == 1.0
    assert found.ci95[0] == 0.0
