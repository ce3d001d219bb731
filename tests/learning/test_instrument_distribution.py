"""Distributions of mu on a grid, intervals whose coverage is promised, and the alarm."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from slipstitch.base.errors import BadInput
from slipstitch.learning.instrument.alarm import SCORES, describe, thumbnails
from slipstitch.learning.instrument.calibration import fitted_spread
from slipstitch.learning.instrument.distribution import (
    conformal_intervals,
    conformal_scales,
    friction_grid,
    grouped_quantile,
    mixture_cumulative,
    probabilities_on_grid,
    quantiles,
    ranked_probability_score,
    spread,
)

GRID = friction_grid(1.5)
MIDDLES = (GRID[1:] + GRID[:-1]) / 2


def cumulative_of(mean, deviation):
    """F of one normal distribution at the middles of the grid, by way of the mixture."""
    parameters = torch.tensor([[[0.3, -1.0], [mean, mean], [np.log(deviation)] * 2]])
    return mixture_cumulative(parameters.double(), torch.from_numpy(MIDDLES))


def shares_of(*means, deviation=0.02):
    """Normal distributions on the grid, one a mean."""
    each = [probabilities_on_grid(cumulative_of(mean, deviation).numpy()) for mean in means]
    return np.concatenate(each)


@pytest.mark.parametrize(("truth", "deviation"), [(0.6, 0.1), (0.734, 0.1), (0.5, 0.03)])
def test_the_loss_is_the_closed_form_of_a_normal_distribution(truth, deviation):
    # Gneiting & Raftery 2007, eq. 21: sigma [z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)].
    z = (truth - 0.6) / deviation
    closed = deviation * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    said, grid = cumulative_of(0.6, deviation), torch.from_numpy(GRID)
    score = ranked_probability_score(said, torch.tensor([truth]), grid)
    assert score.item() == pytest.approx(closed, abs=2e-4)


def test_a_mixture_of_two_equal_normals_is_that_normal_and_has_its_quantiles():
    cumulative = cumulative_of(0.6, 0.1).numpy()
    np.testing.assert_allclose(cumulative[0], norm.cdf(MIDDLES, 0.6, 0.1), atol=1e-6)
    shares, levels = probabilities_on_grid(cumulative), np.array([0.05, 0.5, 0.95])
    assert shares.sum() == pytest.approx(1.0)
    found = quantiles(shares, GRID, levels)[0]
    np.testing.assert_allclose(found, norm.ppf(levels, 0.6, 0.1), atol=1e-3)


def test_a_spread_doubles_a_deviation_and_keeps_the_median_of_two_modes():
    shares = spread(shares_of(0.7, deviation=0.05), GRID, 2.0)
    mean = (shares * GRID).sum()
    assert np.sqrt((shares * (GRID - mean) ** 2).sum()) == pytest.approx(0.1, rel=0.01)
    shares = np.array([[0.7, 0.3]]) @ shares_of(0.3, 1.2)
    both = np.concatenate([shares, spread(shares, GRID, 5.0)])
    before, after = quantiles(both, GRID, np.array([0.5]))[:, 0]
    assert before == pytest.approx(after, abs=2e-3)
    assert abs(before - 0.3) < 0.02


def test_the_fitted_spread_is_that_of_the_errors():
    random = np.random.default_rng(3)
    truth = random.uniform(0.3, 1.2, 400)
    shares = shares_of(*(truth + random.normal(size=400) * 0.06))
    assert fitted_spread(shares, GRID, truth, [str(n) for n in range(400)]) == pytest.approx(3, 0.1)


def test_the_quantile_counts_every_group_once():
    # Three groups of 1, 1 and 8 scores, and one at infinity: weights 1/4, 1/4, 8 times 1/32.
    scores = np.array([1.0, 2.0, *range(3, 11)])
    groups = ["a", "b", *"c" * 8]
    assert grouped_quantile(scores, groups, 0.25) == 1.0
    assert grouped_quantile(scores, groups, 0.5) == 2.0
    assert grouped_quantile(scores, groups, 0.625) == 6.0
    assert grouped_quantile(scores, groups, 0.76) == np.inf
    # Eight groups are too few to promise nine tenths.
    each = [str(number) for number in range(9)]
    assert np.isfinite(grouped_quantile(scores[:9], each, 0.9))
    assert grouped_quantile(scores[:8], each[:8], 0.9) == np.inf
    for none in ([], [1.0, 2.0], [np.nan]):
        with pytest.raises(BadInput, match="one number each"):
            grouped_quantile(np.array(none), ["a"], 0.9)


def test_intervals_cover_new_groups_as_promised_and_not_much_more():
    # Errors shared within a group: 30 groups of unequal size calibrate, one more is tested.
    random = np.random.default_rng(5)
    hits, trials = 0, 3000
    for _ in range(trials):
        sizes = random.integers(1, 12, 31)
        groups = np.repeat(np.arange(31), sizes)
        scores = abs(random.normal(size=31)[groups] + 0.3 * random.normal(size=len(groups)))
        old = groups < 30
        limit = grouped_quantile(scores[old], groups[old].astype(str), 0.9)
        hits += (scores[~old] <= limit).mean()
    assert 0.89 < hits / trials < 0.935  # promised: 0.9 ... 0.9 + 1 / 31


def test_stretched_intervals_reach_the_truths_they_were_stretched_for():
    truth = np.array([0.45, 0.4, 1.05])
    shares = shares_of(0.4, 0.7, 1.0, deviation=0.03)
    factors = conformal_scales(conformal_intervals(shares, GRID, 0.9, 1.0), truth)
    for row, factor in enumerate(factors):
        _, low, high = conformal_intervals(shares, GRID, 0.9, factor)[row]
        assert min(abs(low - truth[row]), abs(high - truth[row])) < 1e-9
    # Without a promise the interval is the whole grid.
    whole = conformal_intervals(shares_of(0.5, deviation=0.1), GRID, 0.9, np.inf)
    np.testing.assert_allclose(whole, [[0.5, 0.0, 1.5]], atol=1e-3)


SIDE, FRAMES = 36, 10


def bars(random, count):
    """Bars of random width, brightness, place and speed that go from left to right."""
    across = np.arange(SIDE)
    videos = np.full((count, FRAMES, SIDE, SIDE, 3), 30.0)
    for video in videos:
        width, speed, start = random.uniform([6, 2.0, -2], [10, 2.4, 2])
        colour = random.uniform(120, 240, 3)
        for frame, image in enumerate(video):
            inside = abs(across - start - speed * frame - 6) < width / 2
            image[8:30, inside] = colour
    return np.clip(videos + random.normal(0, 3, videos.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def alarm():
    random = np.random.default_rng(0)
    training, held = bars(random, 120), bars(random, 80)
    embedding = random.normal(size=(120, 4))
    alarm = describe(training, embedding)
    groups = [f"simulation {number // 2}" for number in range(80)]
    raw = alarm.raw(held, random.normal(size=(80, 4)), random.normal(size=80))
    return alarm.calibrated(raw, groups, 0.05)


def share(alarm, videos, embedding=None, order=None):
    """Share of the videos at which the alarm is raised, and the commonest reason."""
    count = len(videos)
    random = np.random.default_rng(7)
    embedding = random.normal(size=(count, 4)) if embedding is None else embedding
    order = random.normal(size=count) if order is None else order
    raw = alarm.raw(videos, embedding, order)
    reasons = [alarm.reason(row) for row in raw]
    return np.mean([reason != "" for reason in reasons]), max(reasons, key=reasons.count)


@pytest.fixture(scope="module")
def new():
    return bars(np.random.default_rng(99), 200)


WRONG = {
    "viewpoint": lambda videos: videos.swapaxes(2, 3),
    "protocol": lambda videos: videos[:, np.arange(FRAMES) // 2],
    "empty": lambda videos: np.random.default_rng(1).normal(30, 3, videos.shape),
    "object": lambda videos: np.where(
        np.indices((SIDE, SIDE)).sum(0)[..., None] % 12 < 6, videos, 30
    ),
    "reversed": lambda videos: videos[:, ::-1],
}


@pytest.mark.parametrize("kind", WRONG)
def test_it_is_raised_for_what_is_wrong(alarm, new, kind):
    caught, reason = share(alarm, WRONG[kind](new[:60]).astype(np.uint8))
    assert caught >= 0.95
    assert reason


def test_it_is_quiet_for_new_videos_of_the_kind_at_any_exposure(alarm, new):
    assert share(alarm, new)[0] <= 0.1  # promised: 0.05
    half = (new[:5] // 2).astype(np.uint8)
    np.testing.assert_allclose(thumbnails(half), thumbnails(new[:5]), atol=0.05)


def test_an_embedding_or_an_order_that_is_strange_raises_it_and_is_named(alarm, new):
    caught, reason = share(alarm, new[:60], embedding=np.full((60, 4), 12.0))
    assert caught == 1.0 and "outside the training distribution" in reason
    caught, reason = share(alarm, new[:60], order=np.full(60, -30.0))
    assert caught == 1.0 and "order of the frames does not match" in reason
    assert share(alarm, new[:3], order=np.full(3, np.nan))[0] == 1.0


def test_with_few_simulations_the_limit_is_their_strangest_video():
    random = np.random.default_rng(3)
    alarm = describe(bars(random, 40), random.normal(size=(40, 4)))
    held, embedding, order = bars(random, 6), random.normal(size=(6, 4)), random.normal(size=6)
    raw = alarm.raw(held, embedding, order)
    few = alarm.calibrated(raw, list("abcdef"), 0.05)
    scores = few.scaled(raw)
    assert scores.shape == (6, len(SCORES))
    assert few.threshold == scores.max()
