"""Evaluation of trained networks on their test videos."""

import math
import os
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    file_digest,
    provenance_record,
    read_json,
    read_parquet,
    read_provenance,
    start_clock,
    write_json,
    write_parquet,
)
from slipstitch.config.evaluate import EvaluateSettings
from slipstitch.config.train import NETWORKS, REFLECTIVE, SPLITS, TRAINED_ON, TrainSettings
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.videos import Videos, read_videos, takes_part, test_only
from slipstitch.learning.classes import classes_of, labels_of
from slipstitch.learning.evaluation.instruments import (
    AVERAGE,
    ENSEMBLE,
    TRAINING,
    alarm_rates,
    evaluate_instruments,
    find_instruments,
    instrument_weights,
    prediction_of,
    stretched_again,
)
from slipstitch.learning.evaluation.metrics import (
    chance,
    check_probabilities,
    confusion,
    constant_error,
    entry,
    friction_scores,
    material_scores,
    mean_over_seeds,
    spread_over_seeds,
)
from slipstitch.learning.evaluation.probes import entries as probe_entries
from slipstitch.learning.evaluation.probes import probes
from slipstitch.learning.instrument.measuring import Instrument, load_instrument
from slipstitch.learning.lrcn_model import CARD, WEIGHTS, LrcnModel, load_model
from slipstitch.learning.torch_setup import set_up_torch
from slipstitch.learning.trainer import simulations

# The friction network whose entry carries the material scores too: both are the paper's baseline.
MODELS = {"lrcn_baseline": "friction_baseline", "lrcn_conditional": "friction_conditional"}

PREDICTIONS_SCHEMA = pa.schema(
    [
        ("video", pa.string()),
        ("simulation", pa.string()),
        ("texture", pa.string()),
        ("viewpoint", pa.string()),
        ("split", pa.string()),
        ("trained_on", pa.string()),
        ("network", pa.string()),
        ("seed", pa.int32()),
        ("true", pa.string()),
        ("predicted", pa.string()),
        ("true_value", pa.float64()),
        ("predicted_value", pa.float64()),
        ("probabilities", pa.list_(pa.float64())),  # of classes; an instrument's on its grid
        ("likeliest_material", pa.string()),  # by an instrument
        ("low", pa.float64()),  # of the instrument's interval
        ("high", pa.float64()),
        ("alarm", pa.string()),  # its reason, empty without
    ]
)


Row = dict[str, Any]
NETWORKS_SCORED = "networks"


@dataclass(frozen=True)
class EvaluationSet:
    """Videos that test the networks trained on one split."""

    name: str
    trained_on: str
    holds: Callable[[Row], bool]


def evaluation_sets(
    rows: list[dict[str, Any]], calibrated: str, viewpoints: str
) -> list[EvaluationSet]:
    """The test sets that a dataset has, in the order of the tables.

    by_video, by_simulation: the split's test videos in training textures and views.
    off_grid, unseen_fabric: friction coefficients between those of the grid, and fabrics that no
    network trains on, with the networks trained by simulation.
    unseen_texture: test-only textures in training views; view_-15 ...: test-only views by their
    turn from the calibrated one, in degrees, in training textures. Both test the networks trained
    by video on every simulation, as the paper does: the texture or the view is new to them, the
    cloth's motion is not.
    reflective_floors, by_video_reflective: by_video's test videos on the floors of the second
    training set, with the networks that have not learnt from it, and with those that have.

    Parameters
    ----------
    rows : list of dict
        The manifest.
    calibrated : str
        Name of the calibrated viewpoint.
    viewpoints : {"training", "calibrated"}
        Training views to count.
    """

    def counts(row: Row) -> bool:
        return viewpoints == "training" or row["viewpoint"] == calibrated

    def of_split(split: str, row: Row) -> bool:
        return takes_part(row) and counts(row) and row[f"split_{split}"] == "test"

    def unseen(kind: str, row: Row) -> bool:
        return counts(row) and test_only(row) == {kind}

    def turned(turn_deg: float, row: Row) -> bool:
        return test_only(row) == {"viewpoint"} and row["viewpoint_turn_deg"] == turn_deg

    def mirrored(row: Row) -> bool:
        return counts(row) and test_only(row) == {"floor"} and row["split_by_video"] == "test"

    turns = {row["viewpoint_turn_deg"] for row in rows if row["viewpoint_role"] == "test"}
    sets = [
        *(EvaluationSet(split, split, partial(of_split, split)) for split in SPLITS),
        EvaluationSet("off_grid", "by_simulation", partial(unseen, "friction")),
        EvaluationSet("unseen_texture", "by_video", partial(unseen, "texture")),
        EvaluationSet("unseen_fabric", "by_simulation", partial(unseen, "material")),
        *(
            EvaluationSet(f"view_{turn:+.0f}", "by_video", partial(turned, turn))
            for turn in sorted(turns)
        ),
        EvaluationSet("reflective_floors", "by_video", mirrored),
        EvaluationSet(REFLECTIVE, REFLECTIVE, mirrored),
    ]
    return [test for test in sets if any(map(test.holds, rows))]


def network_weights(folder: str | os.PathLike, train: TrainSettings | None = None) -> list[Path]:
    """Weights in ``{split}/{network}/seed{seed}/``: all, or of the configured trainings only."""
    return [
        path
        for split in (TRAINED_ON if train is None else train.splits)
        for network in NETWORKS
        for path in sorted(Path(folder, split, network).glob(f"seed*/{WEIGHTS}"))
        if train is None
        or (network, path.parent.name.removeprefix("seed"))
        in {(name, str(seed)) for name, seed in train.trainings(split)}
    ]


def find_models(
    folder: str | os.PathLike, train: TrainSettings | None = None
) -> dict[tuple[str, str, int], LrcnModel]:
    """The models in ``{split}/{network}/seed{seed}/``, by (split, network, seed).

    Parameters
    ----------
    folder : path
    train : TrainSettings, optional
        Which splits and seeds count; others, left by an earlier configuration, do not.

    Raises
    ------
    BadInput
        If there is none, one is damaged, or one is not what its place says.
    """
    models = {}
    for path in network_weights(folder, train):
        model = load_model(path.parent)
        card = model.card
        named = (card["split"], card["network"], f"seed{card['seed']}")
        if named != path.parts[-4:-1]:
            raise BadInput(
                f"{path}: holds {card['network']} {card['split']} seed {card['seed']}: "
                "does not match its folder"
            )
        models[card["split"], card["network"], card["seed"]] = model
    if not models:
        raise BadInput(f"{folder}: no models found ({{split}}/{{network}}/seed{{seed}}/{WEIGHTS})")
    return models


def predicted_probabilities(
    models: dict, key: tuple[str, str, int], videos: Videos, batch_size: int
) -> np.ndarray:
    """Probabilities of a model on videos; a conditional one gets its material network's answer."""
    split, network, seed = key
    model = models[key]
    condition = None
    if network == "friction_conditional":
        material = models.get((split, "material_baseline", seed))
        if material is None:
            raise BadInput(
                f"friction_conditional {split} seed {seed} has no matching material_baseline"
            )
        material.check_is_material_network_of(split, seed, videos.digest)
        if material.card["weights_sha256"] != model.card["condition_sha256"]:
            raise BadInput(
                f"friction_conditional {split} seed {seed} was trained with a different "
                "material_baseline"
            )
        condition = material.probabilities(videos, batch_size=batch_size).argmax(1)
    return model.probabilities(videos, condition, batch_size)


def evaluate(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    models_folder: str | os.PathLike | None,
    *,
    calibrated: str,
    train: TrainSettings | None = None,
    frames: int | None = None,
    instruments_folder: str | os.PathLike | None = None,
    instrument_seeds: list[int] | None = None,
    scored: Collection[str] = (),
    threads: int = 1,
) -> tuple[dict[str, Any], dict[str, Any], list[dict[str, Any]]]:
    """Evaluate all models on all test sets.

    Parameters
    ----------
    settings : EvaluateSettings
    dataset : path
        What the sample stage wrote.
    models_folder : path or None
        What the train stage wrote; None: instruments only.
    calibrated : str
        Name of the calibrated viewpoint.
    train : TrainSettings, optional
        The splits and seeds that count; by default every model in the folder.
    frames : int, optional
        Frames of a video that the networks see; by default all of the dataset's.
    instruments_folder : path, optional
        What the instrument stage wrote.
    instrument_seeds : list of int, optional
        Seeds that count; by default all.
    scored : collection of {"networks", "instrument", "instrument_ensemble"}
        Kinds of models that are left out, and then the probes of the dataset too.
    threads : int

    Returns
    -------
    metrics : dict
        ``{split: {model: {field: number or None}}}``, the content of metrics.json.
    details : dict
        For every split and network: chance, scores of each seed, by viewpoint, confusion matrix.
    predictions : list of dict
        Rows of predictions.parquet.

    Raises
    ------
    BadInput
        If a model is missing its partner, was trained on other data, files are damaged, or what
        must tell nothing of friction tells it (see `slipstitch.learning.evaluation.probes`).
    """
    set_up_torch(threads)
    models = {}
    if models_folder is not None and NETWORKS_SCORED not in scored:
        models = find_models(models_folder, train)
    pixels = {model.card["pixels"] for model in models.values()}
    if len(pixels) > 1:
        raise BadInput(f"{models_folder}: models of different image sizes: {sorted(pixels)}")
    instruments = {}
    if instruments_folder is not None:
        instruments = {
            key: instrument
            for key, instrument in find_instruments(
                instruments_folder, train, instrument_seeds
            ).items()
            if (AVERAGE if key[1] is None else TRAINING) not in scored
        }
    manifest, _ = read_manifest(dataset)
    trained_on = {key[0] for key in (*models, *instruments)}
    tests = [
        test
        for test in evaluation_sets(manifest, calibrated, settings.viewpoints)
        if test.trained_on in trained_on
    ]
    if not tests:
        return {}, {}, []
    videos = read_videos(dataset, lambda row: any(test.holds(row) for test in tests))
    for (split, network, seed), model in models.items():
        if model.card["dataset_digest"] != videos.digest:
            raise BadInput(f"{network} {split} seed {seed} was not trained on {dataset}")

    for (split, of_one), instrument in instruments.items():
        if instrument.card.get("dataset_digest") != videos.digest:
            which = "ensemble" if of_one is None else f"seed {of_one}"
            raise BadInput(f"instrument {split} {which} was not trained on {dataset}")

    grid = classes_of([row for row in manifest if takes_part(row)], "friction")
    probed = {} if scored else probes(settings, dataset)
    side = pixels.pop() if pixels else None
    metrics: dict[str, Any] = {}
    details: dict[str, Any] = {}
    predictions: list[dict[str, Any]] = []
    for test in tests:
        chosen = np.array([test.holds(row) for row in videos.rows])
        whole = videos.chosen(chosen)
        part = whole if side is None else whole.seen_with(side, frames)
        by_network: dict[str, dict[int, np.ndarray]] = defaultdict(dict)
        for key in models:
            if key[0] == test.trained_on:
                probabilities = predicted_probabilities(models, key, part, settings.batch_size)
                by_network[key[1]][key[2]] = probabilities
                predictions += _rows(part, test, key, models[key], probabilities)
        measured = {
            network: evaluate_instruments(settings, test, whole, instruments, grid, network)
            for network in (TRAINING, AVERAGE)
        }
        if not by_network and not any(found for found, _ in measured.values()):
            continue
        scores = {
            network: _scores(settings, part, models, test.trained_on, network, of_seed)
            for network, of_seed in by_network.items()
        }
        details[test.name] = scores
        metrics[test.name] = {}
        for name, network in MODELS.items():
            used = [network] + ["material_baseline"] * (name == "lrcn_baseline")
            used = [network for network in used if network in scores]
            if used:
                seeds = sorted({seed for network in used for seed in by_network[network]})
                metrics[test.name][name] = entry(
                    len(part), seeds, *(scores[network]["mean"] for network in used)
                )
        details[test.name] |= probed.get(test.name, {})
        metrics[test.name] |= probe_entries(probed.get(test.name, {}))
        for network, (found, rows) in measured.items():
            if not found:
                continue
            if test.name in TRAINED_ON:
                found["alarms"] = alarm_rates(instruments, test.name, whole, network)
            details[test.name][network] = found
            predictions += rows
            seeds = (
                sorted(map(int, found["seeds"]))
                if network == TRAINING
                else instruments[test.trained_on, None].card["seeds"]
            )
            metrics[test.name][network] = entry(found["n"], seeds, found["mean"])
    return metrics, details, predictions


def _score(
    settings, card, probabilities: np.ndarray, rows: list[dict[str, Any]]
) -> dict[str, float]:
    """Scores of one network; empty for the fabrics of videos of which any is no class."""
    if card["target"] == "friction":
        values = np.array([of_class["value"] for of_class in card["classes"]])
        true = np.array([row["friction"] for row in rows])
        return friction_scores(values[probabilities.argmax(1)], true, settings.friction_step)
    truth = known_labels(rows, card)
    return {} if truth is None else material_scores(probabilities, truth)


def known_labels(rows: list[dict[str, Any]], card: dict[str, Any]) -> np.ndarray | None:
    """Class numbers of videos; None if one is of no class, as off the grid."""
    known = {of_class["id"] for of_class in card["classes"]}
    if any(row[f"{card['target']}_id"] not in known for row in rows):
        return None
    return labels_of(rows, card["classes"], card["target"])


def _scores(settings, part: Videos, models, split, network, of_seed) -> dict[str, Any]:
    """Everything that details.json says of one network on one test set."""
    card = models[split, network, min(of_seed)].card
    truth = known_labels(part.rows, card)
    viewpoints = np.array([row["viewpoint"] for row in part.rows])
    each = {
        seed: _score(settings, card, probabilities, part.rows)
        for seed, probabilities in of_seed.items()
    }
    result: dict[str, Any] = {
        "n": len(part),
        "simulations": len({row["simulation"] for row in part.rows}),
        "trained_on": split,
        "classes": card["classes"],
        "chance": {} if truth is None else chance(truth, len(card["classes"])),
        **_over_seeds(list(each.values())),
        "seeds": {str(seed): score for seed, score in sorted(each.items())},
        "viewpoints": {
            str(viewpoint): {
                "n": int((viewpoints == viewpoint).sum()),
                "simulations": len(simulations(part, viewpoints == viewpoint)),
                **_over_seeds(
                    [
                        _score(
                            settings,
                            card,
                            probabilities[viewpoints == viewpoint],
                            list(compress(part.rows, viewpoints == viewpoint)),
                        )
                        for probabilities in of_seed.values()
                    ]
                ),
            }
            for viewpoint in sorted(set(viewpoints))
        },
        "confusion": None,
    }
    if truth is not None:
        counts = [confusion(probabilities, truth) for probabilities in of_seed.values()]
        result["confusion"] = np.sum(counts, axis=0).tolist()
    if card["target"] == "friction":
        true = np.array([row["friction"] for row in part.rows])
        result["chance"]["mean_absolute_error"] = constant_error(true)
    return result


def _over_seeds(scores: list[dict[str, float]]) -> dict[str, Any]:
    return {"mean": mean_over_seeds(scores), "spread": spread_over_seeds(scores)}


def _rows(
    part: Videos, test: EvaluationSet, key, model: LrcnModel, probabilities
) -> list[dict[str, Any]]:
    card = model.card
    truth = known_labels(part.rows, card)
    no_truth = np.zeros(len(probabilities), np.int64)
    check_probabilities(probabilities, no_truth if truth is None else truth)
    ids = [of_class["id"] for of_class in card["classes"]]
    values = [of_class.get("value", math.nan) for of_class in card["classes"]]
    return [
        {
            **prediction_of(row, test, key[1], key[2]),
            "true": row[f"{card['target']}_id"],
            "predicted": ids[int(of_classes.argmax())],
            "true_value": row["friction"] if card["target"] == "friction" else math.nan,
            "predicted_value": values[int(of_classes.argmax())],
            "probabilities": of_classes.tolist(),
        }
        for row, of_classes in zip(part.rows, probabilities, strict=True)
    ]


def _scored_before(
    settings: EvaluateSettings, manifest: Path, out: str | os.PathLike
) -> dict[str, str]:
    """Path -> SHA-256 of what the metrics in `out` are of."""
    try:
        record = read_provenance(out)
    except FileNotFoundError:
        raise BadInput(f"{out}: no scores to update: run without --update") from None
    inputs = record.get("inputs", {})
    if file_digest(manifest) not in inputs.values():
        raise BadInput(f"{out}: scores of another dataset than {manifest.parent}")
    if record.get("config", {}).get("evaluate") != settings.model_dump(mode="json"):
        raise BadInput(f"{out}: scores by other settings than those of the section evaluate")
    return inputs


def _updated(kept: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Test sets with their models, those that are new in the place of earlier ones."""
    return kept | {name: kept.get(name, {}) | models for name, models in new.items()}


def _stretched_since(averages: Sequence[Path], before: Mapping[str, str]) -> list[Instrument]:
    """The averages, if all are those scored before but for the stretch of their intervals."""
    if not before:
        return []
    now = [load_instrument(path) for path in averages]
    known = {one.card.get("recalibrated_from", {}).get("weights_sha256") for one in now}
    return now if known <= {*before.values()} else []


def _stretch(
    settings: EvaluateSettings,
    metrics: dict[str, Any],
    details: dict[str, Any],
    predictions: list[dict[str, Any]],
    rows: dict[str, dict[str, Any]],
    instrument: Instrument,
) -> None:
    """Put the intervals that an average gives now in the place of those that it gave before."""
    for test, models in details.items():
        found = models.get(AVERAGE)
        if found is None or found["trained_on"] != instrument.card["split"]:
            continue
        mine = [
            k
            for k, row in enumerate(predictions)
            if (row["split"], row["network"]) == (test, AVERAGE)
        ]
        models[AVERAGE], now = stretched_again(
            found,
            [predictions[k] for k in mine],
            [rows[predictions[k]["video"]] for k in mine],
            instrument,
            settings.friction_step,
        )
        for k, row in zip(mine, now, strict=True):
            predictions[k] = row
        metrics[test][AVERAGE] = entry(
            found["n"], instrument.card["seeds"], models[AVERAGE]["mean"]
        )


def write_evaluation(
    settings: EvaluateSettings,
    dataset: str | os.PathLike,
    models_folder: str | os.PathLike | None,
    out: str | os.PathLike,
    predictions_out: str | os.PathLike,
    details_out: str | os.PathLike,
    *,
    train: TrainSettings | None = None,
    instruments_folder: str | os.PathLike | None = None,
    instrument_seeds: list[int] | None = None,
    update: bool = False,
    **options: Any,
) -> dict[str, Any]:
    """`evaluate`, written to metrics.json, details.json and predictions.parquet; the metrics.

    With `update`, what these files say of models that are unchanged stays, as of the dataset's
    probes, and only kinds of models (networks, instruments, their averages) of which one is new or
    changed are evaluated. Of averages that differ in the stretch of their intervals alone
    (`slipstitch.learning.instrument.ensemble.recalibrate_instrument`) no image is needed.

    Raises
    ------
    BadInput
        As `evaluate`; with `update` also if the files are of another dataset or other settings.
    """
    started = start_clock()
    manifest = Path(dataset) / MANIFEST
    kinds: dict[str, list[Path]] = {NETWORKS_SCORED: [], TRAINING: [], AVERAGE: []}
    if models_folder is not None:
        weights = network_weights(models_folder, train)
        kinds[NETWORKS_SCORED] = [
            path.with_name(name) for path in weights for name in (WEIGHTS, CARD)
        ]
    if instruments_folder is not None:
        for path in instrument_weights(instruments_folder, train, instrument_seeds):
            kinds[AVERAGE if path.parent.name == ENSEMBLE else TRAINING].append(path)
    before = _scored_before(settings, manifest, out) if update else {}
    scored = {
        kind
        for kind, paths in kinds.items()
        if before and all(file_digest(path) in before.values() for path in paths)
    }
    stretched = [] if AVERAGE in scored else _stretched_since(kinds[AVERAGE], before)
    if stretched:
        scored.add(AVERAGE)
    metrics, details, predictions = evaluate(
        settings,
        dataset,
        models_folder,
        train=train,
        instruments_folder=instruments_folder,
        instrument_seeds=instrument_seeds,
        scored=scored,
        **options,
    )
    if scored:
        again = {row["network"] for row in predictions}
        metrics = _updated(read_json(out), metrics)
        details = _updated(read_json(details_out), details)
        kept = read_parquet(predictions_out).to_pylist()
        predictions = [row for row in kept if row["network"] not in again] + predictions
    if stretched:
        rows = {row["video"]: row for row in read_manifest(dataset)[0]}
        for instrument in stretched:
            _stretch(settings, metrics, details, predictions, rows, instrument)
    record = provenance_record(
        "evaluate",
        inputs=[manifest, *(path for paths in kinds.values() for path in paths)],
        config={"evaluate": settings},
        started=started,
    )
    for place, content in ((out, metrics), (details_out, details)):
        write_json(place, content, record)
    table = pa.Table.from_pylist(predictions, schema=PREDICTIONS_SCHEMA)
    write_parquet(table, predictions_out, {}, record)
    return metrics
