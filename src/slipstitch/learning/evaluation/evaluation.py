"""Evaluation of trained models: a table of predictions, and the scores that follow from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    file_digest,
    provenance_record,
    read_json,
    read_metadata,
    read_provenance,
    start_clock,
    write_json,
    write_parquet,
)
from slipstitch.config.train import TRAINED_ON
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.probes import probed_splits
from slipstitch.dataset.videos import Videos, read_videos, takes_part
from slipstitch.learning.evaluation.scores import (
    AVERAGE,
    ENSEMBLE,
    PROBE,
    SCHEMA,
    SHIPPED,
    TRAINING,
    details_of_table,
    metrics_of_table,
    name_of,
    place_in_tables,
    predicts_material_alone,
    read_table,
)
from slipstitch.learning.evaluation.test_sets import evaluation_sets, probes, wrong_inputs
from slipstitch.learning.evaluation.trained import Key, Trained, place_of
from slipstitch.learning.instrument.measuring import Instrument, load_instrument
from slipstitch.learning.lrcn import LrcnModel
from slipstitch.learning.prediction import Prediction, classes_of
from slipstitch.learning.torch_setup import set_up_torch

Row = dict[str, Any]
# More would be the larger part of the table, and noise.
PROBABILITY_DECIMALS = 6


@dataclass
class Table:
    """Predictions, and what they do not say of the models."""

    rows: list[Row] = field(default_factory=list)  # as `scores.SCHEMA`
    # ``{trained_on: {network: {"classes": [...]} or {"seeds": [...]}}}``
    models: dict[str, dict[str, Any]] = field(default_factory=dict)
    # ``{test set: {network: {seed: {kind of wrong input: share of alarms}}}}``
    alarms: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, other: "Table", also: Callable[[Row], bool]) -> None:
        """Add of another table the rows asked for, and what it notes of their networks."""
        rows = [row for row in other.rows if also(row)]
        self.rows += rows
        for split, network in dict.fromkeys((row["trained_on"], row["network"]) for row in rows):
            noted = other.models.get(split, {})
            if network in noted:
                self.models.setdefault(split, {}).setdefault(network, noted[network])
        of_tests = ((row["split"], row["network"], name_of(row["seed"])) for row in rows)
        for test, network, name in dict.fromkeys(of_tests):
            rates = other.alarms.get(test, {}).get(network, {})
            if name in rates:
                self.alarms.setdefault(test, {}).setdefault(network, {})[name] = rates[name]


def prediction_row(
    row: Mapping[str, Any],
    network: str,
    prediction: Prediction,
    classes: Sequence[Mapping[str, Any]],
) -> Row:
    """Return what predictions.parquet says of a video and its prediction, by the nearest class."""
    fabrics = prediction.fabrics
    if predicts_material_alone(network):
        shares = [*prediction.material_probabilities.values()]
        true = {"true": row["material_id"], "true_value": np.nan}
        predicted = next(one["id"] for one in classes if one["name"] == fabrics[0])
    else:
        shares = prediction.distribution[1].tolist()
        true = {"true": row["friction_id"], "true_value": row["friction"]}
        mu = prediction.friction_coefficient
        predicted = min(classes, key=lambda of_class: abs(of_class["value"] - mu))["id"]
    if not np.isfinite(shares).all():
        raise BadInput(f"{network}: a prediction for {row['video']} is no number")
    low, high = prediction.interval_90 or (None, None)
    return {
        **{name: row[name] for name in ("video", "simulation", "texture", "viewpoint")},
        "network": network,
        **true,
        "predicted": predicted,
        "predicted_value": prediction.friction_coefficient,
        "probabilities": shares,
        "material": row["material"],
        "fabrics": fabrics,
        "likeliest_material": fabrics[0] if prediction.alarm is not None else None,
        "low": low,
        "high": high,
        "alarm": None if prediction.alarm is None else prediction.alarm_reason,
    }


def predicted_table(dataset: str | Path, models: Mapping[Key, LrcnModel | Instrument]) -> Table:
    """Return the predictions of models on all their test sets; BadInput if of other data."""
    manifest, _ = read_manifest(dataset)
    table = Table()
    trained_on = {key[0] for key in models}
    tests = [test for test in evaluation_sets(manifest) if test.trained_on in trained_on]
    if not tests:
        return table
    videos = read_videos(dataset, lambda row: any(test.holds(row) for test in tests))
    coefficients = classes_of([row for row in manifest if takes_part(row)], "friction")
    for (split, network, seed), model in models.items():
        if network != SHIPPED and model.card.get("dataset_digest") != videos.digest:
            which = ENSEMBLE if seed is None else f"seed {seed}"
            raise BadInput(f"{network} {split} {which} was not trained on {dataset}")
        noted = {"seeds": model.card["seeds"]} if seed is None else {}
        if isinstance(model, LrcnModel):
            noted = {"classes": model.card["classes"]}
        table.models.setdefault(split, {}).setdefault(network, noted)
    for test in tests:
        whole = videos.chosen(np.array([test.holds(row) for row in videos.rows]))
        for (split, network, seed), model in models.items():
            seen = np.array([model.sees(row) for row in whole.rows])
            if split != test.trained_on or not seen.any():
                continue
            part = whole.chosen(seen)
            named = {"split": test.name, "trained_on": split, "seed": seed}
            classes = table.models[split][network].get("classes", coefficients)
            table.rows += [
                prediction_row(row, network, prediction, classes) | named
                for row, prediction in zip(part.rows, model.predict(part), strict=True)
            ]
            if network in (TRAINING, AVERAGE) and test.name in TRAINED_ON:
                of_network = table.alarms.setdefault(test.name, {}).setdefault(network, {})
                of_network[name_of(seed)] = alarm_rates(model, whole)
    return table


def alarm_rates(instrument: Instrument, videos: Videos) -> dict[str, float]:
    """Return shares of alarms, by kind of wrong input, also other views; ``good``: false ones."""
    mine = np.array([row["viewpoint"] in instrument.card["viewpoints"] for row in videos.rows])
    own = instrument.frames_of(videos.chosen(mine))
    kinds = {
        kind: Videos(own.rows, pixels, own.digest)
        for kind, pixels in {"good": own.pixels, **wrong_inputs(own.pixels)}.items()
    }
    if not mine.all():
        kinds["viewpoint"] = videos.chosen(~mine)
    return {
        kind: float(np.mean([one.alarm for one in instrument.predict(part)]))
        for kind, part in kinds.items()
    }


def probe_table(dataset: str | Path) -> Table:
    """Return the predictions of the probes on the splits that must tell nothing."""
    table = Table()
    for name, network, classes, rows in probes(dataset):
        table.models.setdefault(name, {})[network] = {"classes": classes}
        named = {"split": name, "trained_on": name, "network": network, "seed": 0}
        table.rows += [dict.fromkeys(SCHEMA.names) | row | named for row in rows]
    return table


def write_evaluation(
    dataset: str | Path,
    trained: Trained,
    out: tuple[Path, Path, Path],
    update: bool = False,
    threads: int = 1,
) -> dict[str, Any]:
    """Write scores, predictions and details, as `out` names these files; return the scores.

    With `update`, what these files say of models that are unchanged stays, as of those whose
    weights are on another machine and of the dataset's probes, and only kinds of models of which
    one is new or changed predict; of averages that differ in their conformal scale alone no image
    is needed. BadInput if a model is missing its partner or was trained on other data, files are
    damaged or, with `update`, of another dataset, or what must tell nothing of friction tells it
    (`test_sets.probe_split`).
    """
    started = start_clock()
    set_up_torch(threads)
    manifest = Path(dataset) / MANIFEST
    rows, digest = read_manifest(dataset)
    files = trained.files()
    metrics_file, predictions_file, details_file = out
    before = _scored_before(dataset, digest, metrics_file, predictions_file) if update else {}
    elsewhere = trained.elsewhere(before)
    kept = {
        kind
        for kind, paths in files.items()
        if before and all(file_digest(path) in before.values() for path in paths)
    }
    rescaled = [] if AVERAGE in kept else _rescaled_since(files[AVERAGE], before)
    if rescaled:
        kept.add(AVERAGE)
    table = predicted_table(dataset, trained.load(frozenset(kept)))
    if before:
        again = {row["network"] for row in table.rows}

        def stays(row: Row) -> bool:
            network = row["network"]
            if network in again:
                return place_of(row) in elsewhere
            return network.startswith((PROBE, SHIPPED)) or trained.counts(*place_of(row))

        table.add(_written(predictions_file, details_file, rescaled), stays)
    scored = {row["split"] for row in table.rows if not row["network"].startswith(PROBE)}
    probed = {row["split"] for row in table.rows if row["network"].startswith(PROBE)}
    unprobed = scored.intersection(probed_splits(rows)) - probed
    if unprobed:
        table.add(probe_table(dataset), lambda row: row["split"] in unprobed)
    order = [test.name for test in evaluation_sets(rows)]
    found = sorted(
        (row for row in table.rows if row["split"] in scored),
        key=lambda row: (order.index(row["split"]), place_in_tables(row["network"])),
    )
    for row in found:
        # Of averages an update computes intervals from them again.
        if row["probabilities"] is not None and row["network"] != AVERAGE:
            row["probabilities"] = np.round(row["probabilities"], PROBABILITY_DECIMALS).tolist()
    metrics = metrics_of_table(found, table.models)
    of_video = {row["video"]: row for row in rows}
    details = details_of_table(found, table.models, of_video)
    for test, networks in table.alarms.items():
        for network, rates in networks.items():
            details[test][network]["alarms"] = rates
    record = provenance_record(
        "evaluate",
        inputs=[manifest, *(path for paths in files.values() for path in paths)],
        started=started,
    )
    for entries in elsewhere.values():
        record["inputs"] |= entries
    write_json(metrics_file, metrics, record)
    write_json(details_file, details, record)
    predictions = pa.Table.from_pylist(found, schema=SCHEMA)
    notes = {"models": table.models, "dataset_digest": digest}
    write_parquet(predictions, predictions_file, notes, record)
    return metrics


def _scored_before(
    dataset: str | Path, digest: str, metrics: Path, predictions: Path
) -> dict[str, str]:
    """Path -> SHA-256 of what the scores there are of."""
    try:
        record = read_provenance(metrics)
        scored = read_metadata(predictions).get("dataset_digest")
    except FileNotFoundError:
        raise BadInput(f"{metrics}: no scores to update: run without --update") from None
    if scored is None:
        raise BadInput(f"{predictions}: of an earlier version: run without --update")
    if scored != digest:
        raise BadInput(f"{metrics}: scores of another dataset than {dataset}")
    return record.get("inputs", {})


def _rescaled_since(averages: Sequence[Path], before: Mapping[str, str]) -> list[Instrument]:
    """The averages, if all are those scored before but for their conformal scale."""
    if not before:
        return []
    now = [load_instrument(path) for path in averages]
    known = {one.card.get("recalibrated_from", {}).get("weights_sha256") for one in now}
    return now if known <= {*before.values()} else []


def _written(predictions: Path, details: Path, rescaled: Sequence[Instrument]) -> Table:
    """The table of before, with the intervals that averages give now."""
    rows, notes = read_table(predictions)
    table = Table(rows, notes["models"])
    for test, networks in read_json(details).items():
        found = {name: one["alarms"] for name, one in networks.items() if "alarms" in one}
        table.alarms |= {test: found} if found else {}
    for instrument in rescaled:
        split = instrument.card["split"]
        mine = [row for row in rows if (row["network"], row["trained_on"]) == (AVERAGE, split)]
        intervals = instrument.intervals(np.array([row["probabilities"] for row in mine]))
        for row, (_, low, high) in zip(mine, intervals, strict=True):
            row |= {"low": float(low), "high": float(high)}
    return table
