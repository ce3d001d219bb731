"""Calibration of an instrument: error bars and alarm, from its videos that did not train it.

One set of simulations gives spread, conformal scale, temperature of the fabrics and alarm. The
spread is one number: the promise of the conformal step is tested with it fitted on the same groups.

Other benches have other clamps, fabrics and cloths. What an instrument reads there of videos of
known friction is all that the conformal step needs to allow for them.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_json, read_parquet, read_sidecar
from slipstitch.dataset.videos import Videos
from slipstitch.learning.instrument.alarm import SCORES, Alarm, describe
from slipstitch.learning.instrument.distribution import (
    conformal_scales,
    grouped_quantile,
    ranked_probability_score,
    spread,
)
from slipstitch.learning.instrument.measuring import COVERAGE, ErrorBars, Instrument
from slipstitch.learning.instrument.poses import poses_of

#: File of an average with its answers that calibrated it.
ANSWERS = "calibration.parquet"
FALSE_ALARMS = 0.05  # of the alarm, on valid videos
TEMPERATURES = (0.2, 25.0)
SPREADS = (1.0, 30.0)
_NAMES = ("video", "simulation", "material")
ANSWERS_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in _NAMES),
        ("friction", pa.float64()),
        ("probabilities", pa.list_(pa.float32())),  # on the grid of mu, before any calibration
        ("material_logits", pa.list_(pa.float32())),
        *((name, pa.float64()) for name in SCORES),  # of the alarm, before they are scaled
    ]
)


def answers_on(
    instrument: Instrument, alarm: Alarm, videos: Videos, generator: np.random.Generator
) -> pa.Table:
    """Return what both say of videos that are to calibrate them, not yet rounded to `ANSWERS`."""
    frames = instrument.frames_of(videos).pixels
    answers = instrument.answers(frames, generator, poses_of(videos.rows))
    scores = alarm.raw(frames, answers.embedding, answers.order)
    return pa.table(
        {name: [row[name] for row in videos.rows] for name in (*_NAMES, "friction")}
        | {name: getattr(answers, name).tolist() for name in ("probabilities", "material_logits")}
        | dict(zip(SCORES, scores.T.tolist(), strict=True))
    )


def numbers(answers: pa.Table, *names: str) -> list[np.ndarray]:
    """Return columns of `answers_on` as arrays, float64 of shape (n,) or (n, any)."""
    return [np.array(answers[name].to_pylist(), np.float64) for name in names]


def fitted_spread(
    probabilities: np.ndarray, grid: np.ndarray, truth: np.ndarray, groups: Sequence[str]
) -> float:
    """Return the factor by which distributions (n, G) spread about their medians score best.

    By ranked probability: unlike the likelihood, few truths far from all modes do not rule it.
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
    trained = instrument.frames_of(videos.chosen(training)).pixels
    answers = instrument.answers(trained, generator, poses_of(videos.rows)[training])
    alarm = describe(trained, answers.embedding)
    del trained  # as large as all videos that train
    held = answers_on(instrument, alarm, videos.chosen(~training), generator)
    return with_error_bars(instrument, alarm, held)


def with_error_bars(instrument: Instrument, alarm: Alarm, held: pa.Table) -> Instrument:
    """Return the instrument with error bars from its `answers_on` videos that did not train it."""
    groups, names = held["simulation"].to_pylist(), instrument.card["materials"]
    friction, probabilities, logits = numbers(held, "friction", "probabilities", "material_logits")
    width = fitted_spread(probabilities, instrument.grid, friction, groups)
    scores = instrument.needed_scale(spread(probabilities, instrument.grid, width), friction)
    temperature = 1.0  # without a fabric that trains, nothing tells how sure the network may be
    fabrics = held["material"].to_pylist()
    if known := [k for k, fabric in enumerate(fabrics) if fabric in names]:
        truth = np.array([names.index(fabrics[k]) for k in known])
        of_known = [groups[k] for k in known]
        temperature = fitted_material_temperature(logits[known], truth, of_known)
    scale = grouped_quantile(scores, groups, COVERAGE)
    alarm = alarm.calibrated(np.stack(numbers(held, *SCORES), axis=1), groups, FALSE_ALARMS)
    return dataclasses.replace(instrument, error_bars=ErrorBars(width, temperature, scale, alarm))


#: File of an average with the readings that calibrated it.
READINGS = "readings.parquet"
#: Columns of a reading, in `READINGS` and in the files that `read_readings` reads.
COLUMNS = ("simulation", "friction", "reading", "low", "high")
READINGS_SCHEMA = pa.schema(
    [
        ("source", pa.string()),  # digest of the dataset, SHA-256 of the file
        ("dataset", pa.string()),  # its digest, if it is known
        ("simulation", pa.string()),  # videos of one are right or wrong together
        *((name, pa.float64()) for name in COLUMNS[1:]),
        ("stretch", pa.float64()),  # conformal scale at which the interval just holds
    ]
)


#: Rows as `READINGS_SCHEMA`, with the conformal scales at which their intervals just hold.
Readings = list[dict[str, Any]]


def groups_of(readings: Readings) -> list[str]:
    """Return the simulation of each, told apart from those of other sources."""
    return [f"{row['source']} {row['simulation']}" for row in readings]


def sources_of(readings: Readings) -> list[dict[str, Any]]:
    """Return for each source its digest, and the numbers of its videos and simulations."""
    simulations: dict[str, list[str]] = {}
    for row in readings:
        simulations.setdefault(row["source"], []).append(row["simulation"])
    return [
        {"digest": source, "videos": len(own), "simulations": len({*own})}
        for source, own in simulations.items()
    ]


def readings_on(instrument: Instrument, videos: Videos) -> Readings:
    """Return what a calibrated instrument reads of the videos of a dataset."""
    frames = instrument.frames_of(videos).pixels
    answers = instrument.answers(frames, np.random.default_rng(0), poses_of(videos.rows))
    distributions = instrument.distributions(answers.probabilities)
    friction = np.array([row["friction"] for row in videos.rows])
    scores = instrument.needed_scale(distributions, friction)
    source = {"source": videos.digest, "dataset": videos.digest}
    intervals = instrument.intervals(distributions).tolist()
    return [
        source
        | dict(zip(COLUMNS, (row["simulation"], row["friction"], *interval), strict=True))
        | {"stretch": score}
        for row, interval, score in zip(videos.rows, intervals, scores.tolist(), strict=True)
    ]


def read_readings(path: str | Path, instrument: Instrument) -> Readings:
    """Return the readings by an instrument that a JSON file lists, as those of studies do.

    The file is a mapping with ``readings``: a list of mappings with at least the `COLUMNS`; one
    with a ``seed`` that is not null is of a single training, and left out. The file's record, or
    its entry ``weights_sha256``, names the weights; ``dataset``, if it is there, the digest of the
    dataset. BadInput if the file is none, of another instrument or one without an error bar, or a
    reading is no number, outside of its interval, or of a coefficient that the instrument cannot
    say.
    """
    content = read_json(path)
    rows = content.get("readings") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"{path}: must be a mapping with readings, a list of mappings")
    _check_of(path, content, instrument)
    if not math.isfinite(instrument.conformal_scale):
        raise BadInput(f"{path}: of an instrument whose intervals are the whole grid")
    largest = instrument.settings.friction_max
    found = [
        _checked(row, f"{path}: reading {number}", largest)
        for number, row in enumerate(rows)
        if row.get("seed") is None
    ]
    if not found:
        raise BadInput(f"{path}: has no reading of the instrument")
    truth = np.array([row["friction"] for row in found])
    intervals = np.array([[row["reading"], row["low"], row["high"]] for row in found])
    scores = conformal_scales(intervals, truth)
    dataset = content.get("dataset")
    named = dataset if isinstance(dataset, str) else None
    of_file = {"source": file_digest(path), "dataset": named}
    # The intervals are scaled already.
    scale = instrument.conformal_scale
    return [
        of_file | row | {"stretch": float(score * scale)}
        for row, score in zip(found, scores, strict=True)
    ]


def _checked(row: dict[str, Any], where: str, largest: float) -> dict[str, Any]:
    """The `COLUMNS` of a reading; BadInput if it cannot be one, on a grid that ends at largest."""
    simulation, *values = (row.get(name) for name in COLUMNS)
    if not isinstance(simulation, str) or not all(map(_is_number, values)):
        raise BadInput(
            f"{where}: simulation must be a text, {', '.join(COLUMNS[1:])} must be numbers"
        )
    friction, reading, low, high = map(float, values)
    # Only where the grid ends has an interval no length to one side.
    if not (
        0 <= low <= reading <= high <= largest
        and (low < reading or low == 0)
        and (reading < high or high == largest)
    ):
        raise BadInput(f"{where}: 0 <= low < reading < high <= {largest:g} is required")
    if not 0 <= friction <= largest:
        raise BadInput(
            f"{where}: friction is {friction:g}; the instrument can say 0 to {largest:g}"
        )
    return dict(zip(COLUMNS, (simulation, friction, reading, low, high), strict=True))


def _is_number(value: Any) -> bool:
    try:
        return type(value) in (int, float) and math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _check_of(path: str | Path, content: dict[str, Any], instrument: Instrument) -> None:
    """BadInput unless the readings are of the instrument, with the error bars that it has."""
    weights = instrument.card["weights_sha256"]
    named = content.get("weights_sha256")
    try:
        inputs = read_sidecar(path).get("inputs")
    except FileNotFoundError:
        inputs = None
    if weights != named and weights not in (inputs if isinstance(inputs, dict) else {}).values():
        raise BadInput(
            f"{path}: names no readings of this instrument: its record, or weights_sha256 in it, "
            f"must name the weights {weights}"
        )


def pooled_scales(
    instrument: Instrument, held: pa.Table, readings: Readings
) -> tuple[np.ndarray, list[str]]:
    """Return the conformal scales that own videos and readings need, and their simulations."""
    probabilities, friction = numbers(held, "probabilities", "friction")
    own = instrument.needed_scale(instrument.distributions(probabilities), friction)
    scales = np.concatenate([own, [row["stretch"] for row in readings]])
    return scales, [*(f"own {one}" for one in held["simulation"].to_pylist()), *groups_of(readings)]


def kept_readings(folder: str | Path) -> Readings:
    """Return those that calibrated an average; none where its folder has no such file."""
    path = Path(folder) / READINGS
    return read_parquet(path, READINGS_SCHEMA.names).to_pylist() if path.is_file() else []
