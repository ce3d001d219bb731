"""Every score from the table of predictions: predictions.parquet -> metrics.json, details.json.

Nothing here trains or predicts, and nothing needs PyTorch: whoever has the table has the scores.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_metadata, read_parquet
from slipstitch.learning.evaluation.metrics import (
    BY_NAME,
    TEST_SETS,
    PredictionsAndTruth,
    constant_error,
    entry,
    mean_over_seeds,
    scores_of,
    spread_over_seeds,
)

Row = dict[str, Any]
MATERIAL = "material_baseline"
# Entry of metrics.json -> the friction network whose scores it has. That of the baseline has the
# scores of the material network too: both are the paper's baseline.
MODELS = {"lrcn_baseline": "friction_baseline", "lrcn_conditional": "friction_conditional"}
# Instruments of one training each, and the average of several.
TRAINING, AVERAGE = "instrument", "instrument_ensemble"
# The instrument that comes with Slipstitch, which no simulation of the dataset trained.
SHIPPED = "instrument_shipped"
ENSEMBLE = "ensemble"
#: Behind the names of fine-tuned networks, and of their entries, where those before fine-tuning are
#: kept: these predict in all views, the fine-tuned ones in the calibrated view alone.
CALIBRATED = "_calibrated"
#: Networks whose names start so are probes.
PROBE = "probe_"

SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("video", "simulation", "texture", "viewpoint")),
        # test set, on what the model was trained, which
        *((name, pa.string()) for name in ("split", "trained_on", "network")),
        ("seed", pa.int32()),  # null: an average
        *((name, pa.string()) for name in ("true", "predicted")),  # ids of fabric or coefficient
        *((name, pa.float64()) for name in ("true_value", "predicted_value")),
        ("probabilities", pa.list_(pa.float64())),  # of classes; an instrument's on its grid
        ("material", pa.string()),  # the true one
        ("fabrics", pa.list_(pa.string())),  # predicted, from the likeliest on
        ("likeliest_material", pa.string()),  # of them, by an instrument
        *((name, pa.float64()) for name in ("low", "high")),  # of the interval
        ("alarm", pa.string()),  # its reason, empty without
    ]
)


def _renamed(name: str, others: Mapping[str, str]) -> str:
    """The name that others have for one, fine-tuned or not."""
    base = name.removesuffix(CALIBRATED)
    return others.get(base, base) + name[len(base) :]


def entries_of(network: str) -> str:
    """Return the entry of metrics.json that has the scores of a network."""
    of_friction = {name: entry for entry, name in MODELS.items()}
    return _renamed(network, {MATERIAL: "lrcn_baseline"} | of_friction)


def network_of(model: str) -> str:
    """Return the network whose scores of friction an entry of metrics.json has."""
    return _renamed(model, MODELS)


def predicts_material_alone(network: str) -> bool:
    """Return whether a network predicts the fabric and no coefficient."""
    return network.removesuffix(CALIBRATED) == MATERIAL


def grouped(rows: Iterable[Row], *keys: str) -> dict[Any, list[Row]]:
    """Return the rows by the values of some columns, a tuple if these are several."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        of_row = tuple(row[key] for key in keys)
        found.setdefault(of_row if len(keys) > 1 else of_row[0], []).append(row)
    return found


def answers_of(rows: Sequence[Row]) -> PredictionsAndTruth:
    """Return rows of one model (`SCHEMA`; captures: also ``reference_error``) as arrays."""
    known = [row for row in rows if row["fabrics"] and row["material"] in row["fabrics"]]
    return PredictionsAndTruth(
        np.array([row["predicted_value"] for row in rows]),
        np.array([row["true_value"] for row in rows]),
        np.array([row.get("reference_error", 0.0) for row in rows]),
        intervals=None
        if rows[0]["low"] is None
        else np.array([[row["low"], row["high"]] for row in rows]),
        groups=[row["simulation"] for row in rows],
        alarms=None if rows[0]["alarm"] is None else np.array([row["alarm"] != "" for row in rows]),
        fabric_rank=np.array([row["fabrics"].index(row["material"]) for row in known], int),
    )


def scores(rows: Sequence[Row]) -> dict[str, float]:
    """Return one model's and seed's scores: `METRICS` of test sets, an instrument's own two."""
    answers = answers_of(rows)
    result: dict[str, float] = {}
    if not predicts_material_alone(rows[0]["network"]):
        result |= scores_of(answers, "friction")
    if answers.intervals is not None:
        result |= scores_of(answers, "interval", table=TEST_SETS)
        result["alarm_rate"] = BY_NAME["alarms"].compute(answers)
        if np.isfinite(answers.coverage[1]):
            result["coverage_90_error"] = answers.coverage[1]
    if len(answers.fabric_rank) == len(rows):
        result |= scores_of(answers, "fabric")
    return result


def scores_by_seed(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Return the scores of every seed of a network, by the seed's name."""
    found = {name_of(seed): scores(of_seed) for seed, of_seed in grouped(rows, "seed").items()}
    return dict(sorted(found.items()))


def name_of(seed: int | None) -> str:
    """Return what tables call a training by: its seed, or the average."""
    return ENSEMBLE if seed is None else str(seed)


def metrics_of_table(rows: Sequence[Row], models: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics.json, of rows as `SCHEMA`; `models` has the seeds of averages."""
    metrics: dict[str, Any] = {}
    for test, of_test in grouped(rows, "split").items():
        metrics[test] = {}
        by_entry: dict[str, list[str]] = {}
        by_network = grouped(of_test, "network")
        for network in sorted(by_network, key=place_in_tables):
            by_entry.setdefault(entries_of(network), []).append(network)
        for name, networks in by_entry.items():
            found = [by_network[network] for network in networks]
            seeds = {row["seed"] for part in found for row in part}
            if None in seeds:
                seeds = set(models[found[0][0]["trained_on"]][networks[0]]["seeds"])
            metrics[test][name] = entry(
                len(grouped(found[0], "video")),
                sorted(seeds),
                *(mean_over_seeds([*scores_by_seed(part).values()]) for part in found),
            )
    return metrics


def place_in_tables(network: str) -> int:
    """Return the place of a network among the rows of a table: the paper's, probes, instruments."""
    order = (MATERIAL, *MODELS.values())
    base = network.removesuffix(CALIBRATED)
    if base in order:
        return order.index(base) + (base != network) * len(order)
    return 8 if network.startswith(PROBE) else {AVERAGE: 10, SHIPPED: 11}.get(network, 9)


def details_of_table(
    rows: Sequence[Row], models: Mapping[str, Any], manifest: Mapping[str, Row]
) -> dict[str, Any]:
    """Return details.json but for the alarms; `manifest` has the row of every video."""
    details: dict[str, Any] = {}
    for (test, network), part in grouped(rows, "split", "network").items():
        of_network = models[part[0]["trained_on"]].get(network, {})
        details.setdefault(test, {})[network] = _detail(part, of_network.get("classes"), manifest)
    return details


def _detail(
    rows: list[Row], classes: list[Row] | None, manifest: Mapping[str, Row]
) -> dict[str, Any]:
    """Return everything that details.json says of one network on one test set."""
    first = next(iter(grouped(rows, "seed").values()))
    of_seeds = scores_by_seed(rows)
    result: dict[str, Any] = _counts(first) | {
        "trained_on": first[0]["trained_on"],
        "chance": {},
        **_over_seeds(of_seeds),
        "seeds": of_seeds,
    }
    if classes is None:
        result["by"] = breakdown(rows, manifest)
    else:
        result |= {"classes": classes, **_of_classes(rows, first, classes)}
        if not first[0]["network"].startswith(PROBE):
            result["viewpoints"] = {
                viewpoint: _counts(grouped(seen, "seed")[first[0]["seed"]])
                | _over_seeds(scores_by_seed(seen))
                for viewpoint, seen in sorted(grouped(rows, "viewpoint").items())
            }
    if not predicts_material_alone(first[0]["network"]):
        true = np.array([row["true_value"] for row in first])
        result["chance"]["mean_absolute_error"] = constant_error(true)
    return result


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    return {"n": len(rows), "simulations": len({row["simulation"] for row in rows})}


def _over_seeds(of_seeds: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    each = list(of_seeds.values())
    return {"mean": mean_over_seeds(each), "spread": spread_over_seeds(each)}


def _of_classes(rows: list[Row], first: list[Row], classes: list[Row]) -> dict[str, Any]:
    """Return chance levels and confusion; nothing where a video is of no class, as off the grid."""
    number = {of_class["id"]: k for k, of_class in enumerate(classes)}
    if any(row["true"] not in number for row in first):
        return {"chance": {}, "confusion": None}
    counts = np.zeros((len(classes), len(classes)), int)
    for row in rows:
        counts[number[row["true"]], number[row["predicted"]]] += 1
    of_class = np.bincount([number[row["true"]] for row in first])
    chance = {"uniform": 1.0 / len(classes), "majority": float(of_class.max() / len(first))}
    return {"chance": chance, "confusion": counts.tolist()}


def breakdown(rows: Sequence[Row], manifest: Mapping[str, Row]) -> dict[str, dict[str, Row]]:
    """Return errors and coverage by fabric, coefficient, floor, texture, and pose of the camera.

    Poses are relative to the calibrated view: azimuth and elevation in degrees, rounded to fives
    and fours, the distance beyond it in per cent, rounded to tens.
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
    names = {"mean_absolute_error": "mean_absolute_error", "within_0_1": "within_0.1"}
    names["coverage_90"] = "coverage_90"
    result: dict[str, dict[str, Row]] = {kind: {} for kind in kinds}
    for kind, value_of in kinds.items():
        valued = [row | {"value": value_of(manifest[row["video"]])} for row in rows]
        for value, part in sorted(grouped(valued, "value").items()):
            answers = answers_of(part)
            scores = {name: BY_NAME[metric].compute(answers) for name, metric in names.items()}
            result[kind][value] = _counts(part) | scores
    return result


def read_table(path: str | Path) -> tuple[list[Row], dict[str, Any]]:
    """Return the rows of predictions.parquet and its metadata; BadInput if it is none of today."""
    notes = read_metadata(path)
    if "models" not in notes:
        raise BadInput(f"{path}: of an earlier version of Slipstitch: evaluate again")
    return read_parquet(path, SCHEMA.names).to_pylist(), notes


def recomputed(path: str | Path) -> dict[str, Any]:
    """Return the content that metrics.json must have, from predictions.parquet alone."""
    rows, notes = read_table(path)
    return metrics_of_table(rows, notes["models"])
