"""Evaluation of instruments on their test videos: errors, coverage of intervals, alarms."""

import math
import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.config.train import TRAINED_ON, TrainSettings
from slipstitch.dataset.videos import Videos
from slipstitch.learning.evaluation.metrics import (
    BY_NAME,
    TEST_SETS,
    PredictionsAndTruth,
    constant_error,
    material_scores,
    mean_over_seeds,
    scores_of,
    spread_over_seeds,
)
from slipstitch.learning.evaluation.wrong_inputs import wrong_inputs
from slipstitch.learning.instrument.augmentation import phased
from slipstitch.learning.instrument.measuring import (
    WEIGHTS,
    Instrument,
    Measurement,
    load_instrument,
)
from slipstitch.learning.instrument.poses import poses_of

Row = dict[str, Any]
# Of the trainings each, and of their average: names of entries, and the folder of the latter.
TRAINING, AVERAGE = "instrument", "instrument_ensemble"
ENSEMBLE = "ensemble"


def instrument_weights(
    folder: str | os.PathLike,
    train: TrainSettings | None = None,
    seeds: Sequence[int] | None = None,
) -> list[Path]:
    """Weights in ``{split}/seed{seed}/``: all, or of the configured splits and seeds only.

    After those of a split comes their average in ``{split}/ensemble/``, unless a single seed is
    configured.
    """
    wanted = None if seeds is None else {f"seed{seed}" for seed in seeds}
    if wanted is not None and len(wanted) > 1:
        wanted.add(ENSEMBLE)
    return [
        path
        for split in (TRAINED_ON if train is None else train.splits)
        for pattern in ("seed*", ENSEMBLE)
        for path in sorted(Path(folder, split).glob(f"{pattern}/{WEIGHTS}"))
        if wanted is None or path.parent.name in wanted
    ]


def find_instruments(
    folder: str | os.PathLike,
    train: TrainSettings | None = None,
    seeds: Sequence[int] | None = None,
) -> dict[tuple[str, int | None], Instrument]:
    """The instruments in ``{split}/seed{seed}/``, by (split, seed), and averages by (split, None).

    Parameters
    ----------
    folder : path
    train : TrainSettings, optional
        Which splits count; others, left by an earlier configuration, do not.
    seeds : sequence of int, optional
        Likewise.

    Raises
    ------
    BadInput
        If one is damaged, or does not match its folder, or an average is of other instruments than
        those beside it.
    """
    found: dict[tuple[str, int | None], Instrument] = {}
    for path in instrument_weights(folder, train, seeds):
        instrument = load_instrument(path)
        card = instrument.card
        averaged = len(instrument.networks) > 1
        name = ENSEMBLE if averaged else f"seed{card.get('seed')}"
        if (card.get("split"), name) != path.parts[-3:-1]:
            held = "an average" if averaged else f"seed {card.get('seed')}"
            raise BadInput(f"{path}: holds {card.get('split')} {held}: does not match its folder")
        if averaged:
            beside = {found[key].card["weights_sha256"] for key in found if key[0] == card["split"]}
            if set(card["members_sha256"]) != beside:
                raise BadInput(
                    f"{path}: is the average of other instruments than those beside it; combine "
                    "these with slipstitch instrument --members"
                )
        found[card["split"], None if averaged else card["seed"]] = instrument
    return found


def measured(instrument: Instrument, videos: np.ndarray, rows: Sequence[Row]) -> list[Measurement]:
    """Measure videos, each with the same augmented views as any other."""
    return [
        instrument.measure(video, pose=pose)
        for video, pose in zip(videos, poses_of(rows), strict=True)
    ]


def scores(
    measurements: list[Measurement], rows: list[Row], settings: EvaluateSettings
) -> dict[str, float]:
    """Scores of one instrument on videos; fabrics only where all are ones that it knows.

    Returns
    -------
    dict
        Those of `metrics.METRICS` for test sets; of more than one simulation
        the coverage's standard error, ``coverage_90_error`` (every simulation counts once);
        ``alarm_rate``.
    """
    names = list(measurements[0].material_probabilities)
    answers = _answers(measurements, rows, settings.friction_step)
    result = {
        **scores_of(answers, "friction"),
        **scores_of(answers, "interval", table=TEST_SETS),
        "alarm_rate": BY_NAME["alarms"].compute(answers),
    }
    result |= _coverage_error(answers)
    if all(row["material"] in names for row in rows):
        probabilities = np.array(
            [list(measurement.material_probabilities.values()) for measurement in measurements]
        )
        truth = np.array([names.index(row["material"]) for row in rows])
        result |= material_scores(probabilities, truth)
    return result


def _answers(
    measurements: list[Measurement], rows: list[Row], friction_step: float
) -> PredictionsAndTruth:
    return PredictionsAndTruth(
        friction_step,
        np.array([measurement.friction_coefficient for measurement in measurements]),
        np.array([row["friction"] for row in rows]),
        intervals=np.array([measurement.interval_90 for measurement in measurements]),
        groups=[row["simulation"] for row in rows],
        alarms=np.array([measurement.alarm for measurement in measurements]),
    )


def breakdown(
    measurements: list[Measurement], rows: list[Row], friction_step: float
) -> dict[str, dict[str, Row]]:
    """Errors and coverage by fabric, coefficient, floor, texture, and pose of the camera.

    Parameters
    ----------
    measurements : list of Measurement
    rows : list of dict
        Of the manifest, one a measurement.
    friction_step : float
        Of the grid of mu.

    Returns
    -------
    dict
        Kind -> value -> ``n, simulations, mean_absolute_error, within_0_1, coverage_90``. Poses are
        relative to the calibrated view: azimuth and elevation in degrees, rounded to fives and
        fours, the distance beyond it in per cent, rounded to tens.
    """
    kinds: dict[str, Callable[[Row], Any]] = {
        "material": lambda row: row["material"],
        "friction": lambda row: f"{row['friction']:g}",
        "floor": lambda row: row["floor"],
        "texture": lambda row: row["texture"],
        "yaw_deg": lambda row: f"{5 * round(row['pose_yaw_deg'] / 5):+d}",
        "pitch_deg": lambda row: f"{4 * round(row['pose_pitch_deg'] / 4):+d}",
        "farther_percent": lambda row: (
            f"{10 * round(10 * math.expm1(row['pose_log_distance'])):+d}"
        ),
    }
    result: dict[str, dict[str, Row]] = {}
    for kind, value_of in kinds.items():
        parts = defaultdict(list)
        for pair in zip(measurements, rows, strict=True):
            parts[value_of(pair[1])].append(pair)
        result[kind] = {}
        for value, pairs in sorted(parts.items()):
            answers = _answers([one for one, _ in pairs], [row for _, row in pairs], friction_step)
            result[kind][value] = {
                "n": len(pairs),
                "simulations": len({row["simulation"] for _, row in pairs}),
                "mean_absolute_error": BY_NAME["mean_absolute_error"].compute(answers),
                "within_0_1": BY_NAME["within_0.1"].compute(answers),
                "coverage_90": answers.coverage[0],
            }
    return result


def evaluate_instruments(
    settings: EvaluateSettings,
    test,
    videos: Videos,
    instruments: dict[tuple[str, int | None], Instrument],
    grid: Sequence[Row],
    network: str = TRAINING,
) -> tuple[dict[str, Any] | None, list[Row]]:
    """All instruments of a test set's split on its videos from the viewpoint that they know.

    On the test sets of other viewpoints (turned by some degrees) every video is measured.

    Parameters
    ----------
    settings : EvaluateSettings
    test : slipstitch.learning.evaluation.evaluation.EvaluationSet
    videos : Videos
        Of the test set.
    instruments : dict
        By (split, seed); seed None: an average.
    grid : sequence of mapping
        Friction coefficients that train, as `slipstitch.learning.classes.classes_of` gives them.
    network : {"instrument", "instrument_ensemble"}
        Whether those of one training each count, or averages.

    Returns
    -------
    details : dict or None
        ``n, simulations, trained_on, chance, mean, seeds`` as for the networks, and `breakdown` of
        all seeds as ``by``; an average counts as a seed ``ensemble``. None if there is no
        instrument or no video.
    predictions : list of dict
        Rows of predictions.parquet.
    """
    each: dict[str, dict[str, float]] = {}
    predictions: list[Row] = []
    everything: list[Measurement] = []
    for (split, seed), instrument in instruments.items():
        if split != test.trained_on or (seed is None) != (network == AVERAGE):
            continue
        views = instrument.card["viewpoints"]
        seen = np.array(
            [row["viewpoint"] in views or row["viewpoint_role"] == "test" for row in videos.rows]
        )
        if not seen.any():
            return None, []
        chosen = videos.chosen(seen)
        rows = chosen.rows
        frames = phased(chosen.pixels, instrument.card["frames"], None)
        measurements = measured(instrument, frames, rows)
        each[_name(seed)] = scores(measurements, rows, settings)
        everything += measurements
        predictions += [
            _prediction(row, test, network, seed, measurement, grid)
            for row, measurement in zip(rows, measurements, strict=True)
        ]
    if not each:
        return None, []
    true = np.array([row["friction"] for row in rows])
    return {
        "n": len(rows),
        "simulations": len({row["simulation"] for row in rows}),
        "trained_on": test.trained_on,
        "chance": {"mean_absolute_error": constant_error(true)},
        "mean": mean_over_seeds(list(each.values())),
        "spread": spread_over_seeds(list(each.values())),
        "seeds": each,
        "by": breakdown(everything, rows * len(each), settings.friction_step),
    }, predictions


def stretched_again(
    found: Row, predictions: Sequence[Row], rows: Sequence[Row], instrument: Instrument, step: float
) -> tuple[Row, list[Row]]:
    """Scores and predictions of an average after its intervals alone were stretched otherwise.

    Parameters
    ----------
    found : dict
        What `evaluate_instruments` said of it before.
    predictions : sequence of dict
        Its rows of predictions.parquet of then, with the distributions of which the intervals are.
    rows : sequence of dict
        Of the manifest, one a prediction.
    instrument : Instrument
        As it is now.
    step : float
        Of the grid of mu, for the scores.

    Returns
    -------
    dict, list of dict
        The same, but for ends and widths of intervals and the shares that hold.
    """
    distributions = np.array([row["probabilities"] for row in predictions])
    intervals = instrument.intervals(distributions)
    now = [
        row | {"low": float(low), "high": float(high)}
        for row, (_, low, high) in zip(predictions, intervals, strict=True)
    ]
    measurements = [
        Measurement(
            friction_coefficient=row["predicted_value"],
            distribution=(instrument.grid, np.array(row["probabilities"])),
            interval_90=(row["low"], row["high"]),
            material_probabilities={row["likeliest_material"]: 1.0},
            alarm=bool(row["alarm"]),
            alarm_reason=row["alarm"],
            attention_weights=np.zeros(0),
        )
        for row in now
    ]
    answers = _answers(measurements, list(rows), step)
    new = {**scores_of(answers, "interval", table=TEST_SETS), **_coverage_error(answers)}
    by = breakdown(measurements, list(rows), step)
    return found | {
        "mean": found["mean"] | new,
        "seeds": {name: one | new for name, one in found["seeds"].items()},
        "by": by,
    }, now


def _coverage_error(answers: PredictionsAndTruth) -> dict[str, float]:
    """Its standard error, of more than one simulation."""
    _, error = answers.coverage
    return {"coverage_90_error": error} if np.isfinite(error) else {}


def alarm_rates(
    instruments: dict[tuple[str, int | None], Instrument],
    split: str,
    videos: Videos,
    network: str = TRAINING,
) -> dict[str, dict[str, float]]:
    """Share of alarms on wrong inputs made from the split's test videos, and on these themselves.

    Parameters
    ----------
    videos : Videos
        All test videos of the split; those of other training viewpoints are wrong inputs too.

    Returns
    -------
    dict
        Seed -> kind -> share; ``good`` is the share of false alarms.
    """
    result: dict[str, dict[str, float]] = {}
    for (trained_on, seed), instrument in instruments.items():
        if trained_on != split or (seed is None) != (network == AVERAGE):
            continue
        mine = np.array([row["viewpoint"] in instrument.card["viewpoints"] for row in videos.rows])
        own, others = (list(compress(videos.rows, which)) for which in (mine, ~mine))
        frames = phased(videos.pixels, instrument.card["frames"], None)
        inputs = {"good": frames[mine], **wrong_inputs(frames[mine])}
        kinds = {kind: (some, own) for kind, some in inputs.items()}
        if others:
            kinds["viewpoint"] = (frames[~mine], others)
        result[_name(seed)] = {
            kind: float(np.mean([one.alarm for one in measured(instrument, of_kind, rows)]))
            for kind, (of_kind, rows) in kinds.items()
        }
    return result


def _name(seed: int | None) -> str:
    return ENSEMBLE if seed is None else str(seed)


def prediction_of(row: Row, test, network: str, seed: int | None) -> Row:
    """Of a row of predictions.parquet: whose it is."""
    video = {name: row[name] for name in ("video", "simulation", "texture", "viewpoint")}
    told = {"split": test.name, "trained_on": test.trained_on, "network": network, "seed": seed}
    return video | told


def _prediction(
    row: Row, test, network: str, seed: int | None, measurement: Measurement, grid: Sequence[Row]
) -> Row:
    friction = measurement.friction_coefficient
    materials = measurement.material_probabilities
    return {
        **prediction_of(row, test, network, seed),
        "true": row["friction_id"],
        "predicted": min(grid, key=lambda of_class: abs(of_class["value"] - friction))["id"],
        "true_value": row["friction"],
        "predicted_value": friction,
        "probabilities": measurement.distribution[1].tolist(),
        "likeliest_material": max(materials, key=materials.__getitem__),
        "low": measurement.interval_90[0],
        "high": measurement.interval_90[1],
        "alarm": measurement.alarm_reason,
    }
