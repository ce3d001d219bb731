"""Error bars: spread, conformal stretch and alarm, from held-out simulations.

One set of simulations serves all three. The spread is one number, and the promise of the conformal
step is tested with it fitted on the same groups (tests/unit).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from slipstitch.instrument.alarm import calibrated_alarm, describe
from slipstitch.instrument.augmentation import phased
from slipstitch.instrument.conformal import grouped_quantile
from slipstitch.instrument.distribution import ranked_probability_score, spread
from slipstitch.instrument.measuring import ErrorBars, Instrument, stretch_scores
from slipstitch.instrument.poses import poses_of
from slipstitch.sample.videos import Videos

TEMPERATURES = (0.2, 25.0)
SPREADS = (1.0, 30.0)


def fitted_spread(
    probabilities: np.ndarray, grid: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> float:
    """Factor by which distributions spread about their medians score best, every group once.

    The score is the continuous ranked probability score (Gneiting & Raftery 2007, eq. 20), as in
    training: unlike the likelihood, it is not ruled by the few truths far from all modes.

    Parameters
    ----------
    probabilities : ndarray, shape (n, G)
    grid : ndarray, shape (G,)
    truth : ndarray, shape (n,)
        Values on the grid's scale.
    groups : sequence of str, length n
    """
    weights = _one_each(groups)
    points, truths = torch.from_numpy(grid), torch.from_numpy(np.asarray(truth, np.float64))

    def score(logarithm: float) -> float:
        shares = spread(probabilities, grid, np.exp(logarithm))
        cumulative = torch.from_numpy(np.cumsum(shares, axis=1)[:, :-1])
        return float(weights @ ranked_probability_score(cumulative, truths, points).numpy())

    found = minimize_scalar(score, bounds=np.log(SPREADS), method="bounded")
    return float(np.exp(found.x))


def fitted_material_temperature(
    logits: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> float:
    """Temperature of the fabrics' softmax, by the same rule; truth holds class numbers."""
    weights = _one_each(groups)

    def surprise(logarithm: float) -> float:
        likelihood = log_softmax(logits / np.exp(logarithm), axis=1)
        return -float((weights * likelihood[np.arange(len(truth)), truth]).sum())

    found = minimize_scalar(surprise, bounds=np.log(TEMPERATURES), method="bounded")
    return float(np.exp(found.x))


def _one_each(groups: Sequence[str]) -> np.ndarray:
    """Weights by which every group counts 1 in all."""
    _, number, count = np.unique(groups, return_inverse=True, return_counts=True)
    return 1.0 / count[number]


def calibrated(instrument: Instrument, videos: Videos, training: np.ndarray) -> Instrument:
    """The instrument with error bars from the videos that did not train; as it is without any.

    Parameters
    ----------
    instrument : Instrument
    videos : Videos
    training : ndarray of bool, shape (n,)
    """
    held = np.flatnonzero(~training)
    if not len(held):
        return instrument
    generator = np.random.default_rng(0)
    frames = phased(videos.pixels, instrument.card["frames"], None)
    poses = poses_of(videos.rows)
    trained = instrument.answers(frames[training], generator, poses[training])
    answers = instrument.answers(frames[held], generator, poses[held])
    groups = [videos.rows[number]["simulation"] for number in held]
    friction = np.array([videos.rows[number]["friction"] for number in held])
    names = instrument.card["materials"]
    fabrics = [videos.rows[number]["material"] for number in held]
    known = [k for k, fabric in enumerate(fabrics) if fabric in names]

    width = fitted_spread(answers.probabilities, instrument.grid, friction, groups)
    coverage = instrument.settings.coverage
    scores = stretch_scores(
        spread(answers.probabilities, instrument.grid, width), instrument.grid, coverage, friction
    )
    bars = ErrorBars(
        spread=width,
        # Without a fabric that trains, nothing tells how sure the network may be of one.
        material_temperature=fitted_material_temperature(
            answers.material_logits[known],
            np.array([names.index(fabrics[k]) for k in known]),
            [groups[k] for k in known],
        )
        if known
        else 1.0,
        factor=grouped_quantile(scores, groups, coverage),
        alarm=calibrated_alarm(
            describe(frames[training], trained.embedding),
            frames[held],
            answers.embedding,
            answers.order,
            groups,
            instrument.settings.false_alarms,
        ),
    )
    return dataclasses.replace(instrument, error_bars=bars)
