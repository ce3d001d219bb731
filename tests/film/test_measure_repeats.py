"""Several videos of a pair: intervals that hold, and outliers that are named."""

import numpy as np
import pytest

from slipstitch.film.measure.repeats import HALF_WIDTH, combined

ENDS = (0.0, 1.5)


def _coverage(shared, own, count, extra=0.0, draws=200, truths=(0.3, 1.0)):
    """Share of intervals that hold the truth, and their mean width over that of one video's.

    Medians and intervals are clipped to the grid, as an instrument's are.
    """
    generator = np.random.default_rng(3)
    half = HALF_WIDTH * np.hypot(shared, own)
    holds, width = [], []
    for _ in range(draws):
        truth = generator.uniform(*truths)
        values = truth + shared * generator.normal()
        values = values + np.hypot(own, extra) * generator.normal(size=count)
        # Never of no width: a distribution on the grid is one step wide at least.
        lower, upper = np.minimum(values - half, 1.49), np.maximum(values + half, 0.01)
        intervals = np.clip(np.column_stack([lower, upper]), *ENDS)
        low, high = combined(np.clip(values, *ENDS), intervals, ENDS).interval_90
        assert ENDS[0] <= low <= high <= ENDS[1]
        holds.append(low <= truth <= high)
        width.append((high - low) / (2 * half))
    return np.mean(holds), np.mean(width)


@pytest.mark.parametrize(
    ("sd", "truths"), [(0.02, (0.3, 1.0)), (0.05, (0.0, 0.1)), (0.05, (1.45, 1.45))]
)
@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize(("shared", "own"), [(1.0, 0.0), (0.7, 0.7), (0.0, 1.0)])
def test_the_interval_holds_whatever_the_videos_share(sd, truths, shared, own, count):
    """In the middle of the grid and at its ends."""
    coverage, width = _coverage(sd * shared, sd * own, count, truths=truths)
    assert coverage >= 0.87
    # Two videos that disagree say little of their scatter; three are worth one at least.
    assert width <= (1.3 if count > 2 else 2.6)


def test_a_half_that_the_grid_cuts_off_is_no_small_error():
    """Where (0, 0.1) holds the truth in nine cases of ten, three such videos say the same."""
    assert combined([0.0] * 3, [(0.0, 0.1)] * 3, ENDS).interval_90 == pytest.approx(
        (0.0, 0.1), abs=1e-3
    )
    assert combined([1.45] * 3, [(1.2, 1.5)] * 3, ENDS).interval_90 == pytest.approx(
        (1.2, 1.5), abs=2e-3
    )
    # The grid ends elsewhere: these are whole halves.
    assert combined([1.45] * 3, [(1.2, 1.5)] * 3, (0.0, 2.0)).interval_90 == pytest.approx(
        (1.2, 1.5), abs=2e-3
    )


def test_a_skew_interval_stays_skew():
    assert combined([0.5] * 3, [(0.48, 0.56)] * 3, ENDS).interval_90 == pytest.approx(
        (0.48, 0.56), abs=1e-3
    )


def test_videos_without_an_error_bar_have_none_together():
    result = combined([0.3, 0.32, 0.9], [ENDS] * 3, ENDS)
    assert result.interval_90 == ENDS
    assert result.outliers == []


def test_what_differs_between_videos_averages_out():
    _, width = _coverage(0.0, 0.02, 10)
    assert width < 0.6


def test_scatter_beyond_the_stated_error_widens_the_interval():
    coverage, width = _coverage(0.005, 0.005, 5, extra=0.05)
    assert coverage >= 0.85
    assert width > 3


def test_one_video_is_told_as_it_is():
    result = combined([0.3], [(0.25, 0.4)], ENDS)
    assert result.interval_90 == (0.25, 0.4)
    assert result.friction_coefficient == 0.3 and np.isnan(result.scatter)


def test_a_stray_video_is_named_and_an_ordinary_one_hardly_ever():
    values = [0.30, 0.31, 0.305, 0.52, 0.298]
    result = combined(values, [(value - 0.03, value + 0.03) for value in values], ENDS)
    assert result.outliers == [3]
    assert result.friction_coefficient == pytest.approx(np.mean(values))
    generator = np.random.default_rng(5)
    named = [
        bool(combined(v, [(x - 0.03, x + 0.03) for x in v], ENDS).outliers)
        for v in 0.5 + 0.018 * generator.normal(size=(200, 5))
    ]
    assert np.mean(named) <= 0.1
