"""Error bars: spread, conformal scale and alarm, from held-out simulations.

One set of simulations serves all three. The spread is one number, and the promise of the conformal
step is tested with it fitted on the same groups (tests/unit).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from slipstitch.dataset.videos import Videos
from slipstitch.learning.instrument.alarm import calibrated_alarm, describe, not_calibrated
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.calibration_answers import CalibrationAnswers
from slipstitch.learning.instrument.calibration_readings import CalibrationReadings
from slipstitch.learning.instrument.conformal import grouped_quantile
from slipstitch.learning.instrument.distribution import ranked_probability_score, spread
from slipstitch.learning.instrument.measuring import COVERAGE, ErrorBars, Instrument
from slipstitch.learning.instrument.poses import poses_of

FALSE_ALARMS = 0.05  # of the alarm, on valid videos
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
    if training.all():
        return instrument
    generator = np.random.default_rng(0)
    trained = phased(videos.pixels[training], instrument.card["frames"], None)
    answers = instrument.answers(trained, generator, poses_of(videos.rows)[training])
    statistics = describe(trained, answers.embedding)
    del trained  # as large as all videos that train
    held = answers_on(instrument, statistics, videos.chosen(~training), generator)
    return with_error_bars(instrument, statistics, held)


def answers_on(
    instrument: Instrument,
    statistics: tuple[np.ndarray, ...],
    videos: Videos,
    generator: np.random.Generator,
) -> CalibrationAnswers:
    """What an instrument says of videos that are to calibrate it.

    Parameters
    ----------
    instrument : Instrument
    statistics : tuple of ndarray
        Of the training videos, as `slipstitch.learning.instrument.alarm.describe` gives them.
    videos : Videos
    generator : numpy Generator
        Of the augmentations.
    """
    frames = phased(videos.pixels, instrument.card["frames"], None)
    answers = instrument.answers(frames, generator, poses_of(videos.rows))
    return CalibrationAnswers(
        rows=[
            {name: row[name] for name in ("video", "simulation", "material", "friction")}
            for row in videos.rows
        ],
        probabilities=answers.probabilities,
        material_logits=answers.material_logits,
        strangeness=not_calibrated(statistics).raw(frames, answers.embedding, answers.order),
    )


def with_error_bars(
    instrument: Instrument, statistics: tuple[np.ndarray, ...], held: CalibrationAnswers
) -> Instrument:
    """The instrument with error bars from its answers on videos that did not train it.

    Parameters
    ----------
    instrument : Instrument
    statistics : tuple of ndarray
        Of the training videos, as `slipstitch.learning.instrument.alarm.describe` gives them.
    held : CalibrationAnswers
    """
    groups, friction = held.groups, held.friction
    names = instrument.card["materials"]
    known = [k for k, row in enumerate(held.rows) if row["material"] in names]
    width = fitted_spread(held.probabilities, instrument.grid, friction, groups)
    scores = instrument.needed_scale(spread(held.probabilities, instrument.grid, width), friction)
    bars = ErrorBars(
        spread=width,
        # Without a fabric that trains, nothing tells how sure the network may be of one.
        material_temperature=fitted_material_temperature(
            held.material_logits[known],
            np.array([names.index(held.rows[k]["material"]) for k in known]),
            [groups[k] for k in known],
        )
        if known
        else 1.0,
        conformal_scale=grouped_quantile(scores, groups, COVERAGE),
        alarm=calibrated_alarm(statistics, held.strangeness, groups, FALSE_ALARMS),
    )
    return dataclasses.replace(instrument, error_bars=bars)


def rescaled_by(
    instrument: Instrument, held: CalibrationAnswers, readings: CalibrationReadings
) -> Instrument:
    """The instrument with intervals that hold on other benches too; all else stays as it is.

    Parameters
    ----------
    instrument : Instrument
        With error bars.
    held : CalibrationAnswers
        On its own videos that calibrate it.
    readings : CalibrationReadings
        On videos of other benches.

    Returns
    -------
    Instrument
        Its conformal scale is the quantile over all of these simulations, each counting once.
    """
    own = instrument.needed_scale(instrument.spread_out(held.probabilities), held.friction)
    scale = grouped_quantile(
        np.concatenate([own, [row["stretch"] for row in readings.rows]]),
        [*(f"own {group}" for group in held.groups), *readings.groups],
        COVERAGE,
    )
    bars = instrument.error_bars
    rescaled = bars and dataclasses.replace(bars, conformal_scale=scale)
    return dataclasses.replace(instrument, error_bars=rescaled)
