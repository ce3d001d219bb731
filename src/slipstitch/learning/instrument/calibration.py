"""Calibration of an instrument: error bars and alarm, from its videos that did not train it.

One set of simulations gives spread, conformal scale, temperature of the fabrics and alarm. The
spread is one number: the promise of the conformal step is tested with it fitted on the same groups.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from slipstitch.base.provenance import read_parquet
from slipstitch.dataset.videos import Videos
from slipstitch.learning.instrument.alarm import SCORES, Alarm, describe
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.conformal import grouped_quantile
from slipstitch.learning.instrument.distribution import ranked_probability_score, spread
from slipstitch.learning.instrument.measuring import COVERAGE, ErrorBars, Instrument
from slipstitch.learning.instrument.poses import poses_of

#: File of an average with its answers that calibrated it.
ANSWERS = "calibration.parquet"
FALSE_ALARMS = 0.05  # of the alarm, on valid videos
TEMPERATURES = (0.2, 25.0)
SPREADS = (1.0, 30.0)
_NAMES = ("video", "simulation", "material", "friction")
ANSWERS_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in _NAMES[:3]),
        ("friction", pa.float64()),
        ("probabilities", pa.list_(pa.float32())),  # on the grid of mu, before any calibration
        ("material_logits", pa.list_(pa.float32())),
        *((name, pa.float64()) for name in SCORES),  # of the alarm, before they are scaled
    ]
)


@dataclass(frozen=True)
class CalibrationAnswers:
    """Uncalibrated answers on n videos that did not train."""

    rows: list[dict[str, Any]]  # ``video, simulation, material, friction`` of each
    probabilities: np.ndarray  # (n, G): on the grid of mu
    material_logits: np.ndarray  # (n, M)
    strangeness: np.ndarray  # (n, 4): scores of the alarm, before they are scaled

    @property
    def groups(self) -> list[str]:
        """Return the simulation of each."""
        return [row["simulation"] for row in self.rows]

    @property
    def friction(self) -> np.ndarray:
        """Return the coefficient of each, shape (n,)."""
        return np.array([row["friction"] for row in self.rows])

    def table(self) -> pa.Table:
        """Return the answers as `ANSWERS` keeps them: those of the networks in float32."""
        columns = {
            **{name: [row[name] for row in self.rows] for name in _NAMES},
            "probabilities": self.probabilities.tolist(),
            "material_logits": self.material_logits.tolist(),
            **dict(zip(SCORES, self.strangeness.T.tolist(), strict=True)),
        }
        return pa.table(columns, schema=ANSWERS_SCHEMA)


def from_table(table: pa.Table) -> CalibrationAnswers:
    """Return the inverse of `CalibrationAnswers.table`, rounded to what a table keeps."""
    columns = table.to_pydict()
    scores = [columns[name] for name in SCORES]
    return CalibrationAnswers(
        rows=table.select(_NAMES).to_pylist(),
        probabilities=np.array(columns["probabilities"], np.float64),
        material_logits=np.array(columns["material_logits"], np.float64),
        strangeness=np.stack(scores, axis=1).astype(np.float64),
    )


def read_answers(folder: str | Path) -> CalibrationAnswers:
    """Read `ANSWERS` of an average; BadInput if the file is missing, damaged or another one."""
    return from_table(read_parquet(Path(folder) / ANSWERS, ANSWERS_SCHEMA.names))


def answers_on(
    instrument: Instrument, alarm: Alarm, videos: Videos, generator: np.random.Generator
) -> CalibrationAnswers:
    """Return what an instrument and its alarm say of videos that are to calibrate both."""
    frames = phased(videos.pixels, instrument.card["frames"], None)
    answers = instrument.answers(frames, generator, poses_of(videos.rows))
    return CalibrationAnswers(
        rows=[{name: row[name] for name in _NAMES} for row in videos.rows],
        probabilities=answers.probabilities,
        material_logits=answers.material_logits,
        strangeness=alarm.raw(frames, answers.embedding, answers.order),
    )


def fitted_spread(
    probabilities: np.ndarray, grid: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> float:
    """Return the factor by which distributions (n, G) spread about their medians score best.

    The score is the continuous ranked probability score (Gneiting & Raftery 2007, eq. 20), as
    in training: unlike the likelihood, it is not ruled by the few truths far from all modes.
    Each group counts once.
    """
    weights = _one_each(groups)
    points, truths = torch.from_numpy(grid), torch.from_numpy(np.asarray(truth, np.float64))

    def score(factor: float) -> float:
        shares = spread(probabilities, grid, factor)
        cumulative = torch.from_numpy(np.cumsum(shares, axis=1)[:, :-1])
        return float(weights @ ranked_probability_score(cumulative, truths, points).numpy())

    return _best(score, SPREADS)


def fitted_material_temperature(
    logits: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> float:
    """Return the temperature of the fabrics' softmax, by the same rule; truth: class numbers."""
    weights = _one_each(groups)

    def surprise(temperature: float) -> float:
        likelihood = log_softmax(logits / temperature, axis=1)
        return -float((weights * likelihood[np.arange(len(truth)), truth]).sum())

    return _best(surprise, TEMPERATURES)


def _best(score: Callable[[float], float], bounds: tuple[float, float]) -> float:
    """The positive number with the least score, sought by its logarithm."""
    found = minimize_scalar(
        lambda logarithm: score(np.exp(logarithm)), bounds=np.log(bounds), method="bounded"
    )
    return float(np.exp(found.x))


def _one_each(groups: Sequence[str]) -> np.ndarray:
    """Weights by which every group counts 1 in all."""
    _, number, count = np.unique(groups, return_inverse=True, return_counts=True)
    return 1.0 / count[number]


def calibrated(instrument: Instrument, videos: Videos, training: np.ndarray) -> Instrument:
    """Return the instrument with error bars from the videos that did not train, if any did not."""
    if training.all():
        return instrument
    generator = np.random.default_rng(0)
    trained = phased(videos.pixels[training], instrument.card["frames"], None)
    answers = instrument.answers(trained, generator, poses_of(videos.rows)[training])
    alarm = describe(trained, answers.embedding)
    del trained  # as large as all videos that train
    held = answers_on(instrument, alarm, videos.chosen(~training), generator)
    return with_error_bars(instrument, alarm, held)


def with_error_bars(instrument: Instrument, alarm: Alarm, held: CalibrationAnswers) -> Instrument:
    """Return the instrument with error bars from its answers on videos that did not train it."""
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
        alarm=alarm.calibrated(held.strangeness, groups, FALSE_ALARMS),
    )
    return dataclasses.replace(instrument, error_bars=bars)
