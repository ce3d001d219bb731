"""Predictions of a verdict's models for a new case: made, locked beforehand, and scored after."""

from __future__ import annotations

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import atomic_path, file_digest, read_json, write_json
from slipstitch.criticise.case import Case, read_case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.discrepancy import predicted_with
from slipstitch.criticise.inference.fit import jacobian, parameters_of
from slipstitch.criticise.measurements import Measurements, assemble
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.physics.friction_law.extended_model import curve_of

UNKNOWN_COEFFICIENT_LOG_SD = 1.0
USUAL_SCATTER = (0.05, 0.03, 1.2)


def read_verdict(path: Path) -> dict:
    """The verdict file.

    Raises
    ------
    BadInput
        If it is missing or holds no models.
    """
    verdict = read_json(path)
    if isinstance(verdict, dict) and not is_discrepancy(verdict.get("discrepancy")):
        raise BadInput(
            f"{path}: discrepancy: must contain covariate, knots, factors, ci95, coefficients and "
            "scatter, as written by slipstitch criticise"
        )
    models = verdict.get("models") if isinstance(verdict, dict) else None
    if not isinstance(models, dict) or not {"null", "extended"} <= set(models):
        raise BadInput(f"{path}: models: missing; must be a file written by slipstitch criticise")
    for name, model in models.items():
        if not _is_model(model):
            raise BadInput(
                f"{path}: models.{name}: must contain causes, parameters, values, covariance and "
                "scatter, as written by slipstitch criticise"
            )
        for cause in model["causes"]:
            if cause not in MECHANISMS:
                raise BadInput(f"{path}: models: unknown mechanism '{cause}'")
    return verdict


def _is_model(model: object) -> bool:
    """Whether it has the shape of a fitted model."""
    if not isinstance(model, dict):
        return False
    lists: list[Any] = [model.get(key) for key in ("causes", "parameters")]
    if not all(isinstance(found, list) for found in lists):
        return False
    if not all(isinstance(name, str) for found in lists for name in found):
        return False
    try:
        values = np.array(model["values"], dtype=float)
        covariance = np.array(model["covariance"], dtype=float)
        scatter = {key: np.array(value, float) for key, value in model["scatter"].items()}
        zeros = [
            np.array(value, dtype=float)
            for own in model.get("zeros", {}).values()
            for value in own.values()
        ]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return False
    count = len(model["parameters"])
    return (
        values.shape == (count,)
        and covariance.shape == (count, count)
        and all(value.shape == (3,) for value in scatter.values())
        and all(value.shape == (2,) for value in zeros)
        and all(
            np.isfinite(numbers).all()
            for numbers in (values, covariance, *scatter.values(), *zeros)
        )
    )


def is_discrepancy(found: Any) -> bool:
    """Whether it has the shape of a verdict's smooth factor, or of none."""
    if found is None or (isinstance(found, dict) and found.get("covariate", 0) is None):
        return True
    try:
        curve_of(found, "discrepancy")
        band = np.array(found["ci95"], dtype=float)
        levels = np.array(list(found["coefficients"].values()), dtype=float)
        scatter = [np.array(value, dtype=float) for value in found["scatter"].values()]
    except (BadInput, KeyError, TypeError, ValueError, AttributeError):
        return False
    return (
        band.shape == (len(found["knots"]), 2)
        and all(value.shape == (3,) for value in scatter)
        and all(np.isfinite(n).all() and (n > 0).all() for n in (band, levels, *scatter))
    )


def predictions(verdict: dict, case: Case) -> pd.DataFrame:
    """One line per run and quantity: run_id, quantity, null and extended mean and total sd."""
    design = assemble(case, measured=False)
    table = design.rows[["run_id", "quantity"]].copy()
    for name, label in (("null", "null"), ("extended", "ext")):
        found = verdict.get("discrepancy") if name == "extended" else None
        mean, sd = predict_model(verdict["models"][name], design, found)
        table[f"{label}_mean"], table[f"{label}_sd"] = mean, sd
    return table


def predict_model(
    model: dict, design: Measurements, discrepancy: dict | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd (instrument, run, specimen and parameters together) of a model, (n,) each.

    ``discrepancy`` is the verdict's smooth factor on the coefficients.
    """
    causes = tuple(model["causes"])
    known = dict(zip(model["parameters"], model["values"], strict=True))
    parameters = parameters_of(design, causes)
    values = np.array([known.get(p.name, p.null) for p in parameters])
    covariance = np.zeros((len(parameters), len(parameters)))
    position = {name: j for j, name in enumerate(model["parameters"])}
    full = np.array(model["covariance"])
    for a, p in enumerate(parameters):
        if p.name not in position:
            covariance[a, a] = UNKNOWN_COEFFICIENT_LOG_SD**2
            continue
        for b, q in enumerate(parameters):
            if q.name in position:
                covariance[a, b] = full[position[p.name], position[q.name]]
    named = {p.name: float(v) for p, v in zip(parameters, values, strict=True)}
    mean = design.predict(named, causes)
    factor_sd, known_scatter = np.zeros(len(mean)), model["scatter"]
    if discrepancy and discrepancy["covariate"]:
        known_scatter = known_scatter | discrepancy["scatter"]
        levels = {p.name: named[p.name] for p in parameters if p.coefficient}
        mean, factor_sd = predicted_with(discrepancy, design, levels)
    own = model.get("zeros", {})
    zeros = np.array(
        [own.get(protocol, {}).get(zero.field, (0.0, 0.0)) for protocol, zero in design.zeros]
    ).reshape(-1, 2)
    columns = jacobian(design, causes, parameters, values, mean)
    coefficients = [j for j, p in enumerate(parameters) if p.coefficient]
    sensitivity = columns[:, coefficients].sum(axis=1)
    scatter = np.array([known_scatter.get(protocol, USUAL_SCATTER) for protocol in design.protocol])
    variance = (
        (scatter[:, 2] * design.u) ** 2
        + sensitivity**2 * (scatter[:, 0] ** 2 + scatter[:, 1] ** 2 + factor_sd**2)
        + np.einsum("ij,jk,ik->i", columns, covariance, columns)
        + (design.zero_columns**2) @ zeros[:, 1] ** 2
    )
    return mean + design.zero_columns @ zeros[:, 0], np.sqrt(variance)


MODELS = (("null", "null"), ("extended", "ext"))


def _digest(verdict: dict) -> str:
    """Of the models alone: what predictions follow from."""
    factor = verdict.get("discrepancy")
    models = verdict["models"] | ({"discrepancy": factor} if factor else {})
    text = json.dumps(models, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _campaign(case: Case) -> dict:
    """What else predictions follow from: nominal values, and what is known of runs beforehand."""
    tables = {}
    for name in case.protocols_of_runs:
        protocol = PROTOCOLS[name]
        columns = protocol.tables[protocol.runs_table]
        planned = case.tables[protocol.runs_table][[c.name for c in columns if not c.measured]]
        tables[protocol.runs_table] = {
            run: {name: cell for name, cell in cells.items() if cell == cell and cell != ""}
            for run, cells in planned.set_index("run_id").to_dict("index").items()
        }
    return {"nominal": case.nominal, "runs": tables}


def _difference(locked: dict, found: dict) -> str | None:
    """What makes a campaign another than the one that was locked.

    What was empty may have been recorded since, and a run that failed may be gone.
    """
    if found["nominal"] != locked["nominal"]:
        return "its nominal values are others"
    for table, runs in found["runs"].items():
        for run, cells in runs.items():
            planned = locked["runs"].get(table, {}).get(run)
            if planned is None:
                return f"run {run} of {table} was not predicted"
            for name, cell in planned.items():
                if cells.get(name) != cell:
                    there = cells.get(name, "an empty cell")
                    return f"run {run} of {table} was predicted with {name} {cell}, not {there}"
    return None


def lock(verdict: dict, case_folder: Path, prediction: Path) -> dict:
    """Write a prediction of a case, whose measured values are not read, and its lock beside it.

    A prediction that is there already is kept, and must be the one that was locked for this case.

    Returns
    -------
    dict
        The lock: ``prediction_sha256``, ``models_sha256``, ``locked_at`` (UTC), and of the case
        ``nominal`` and ``runs`` as it was predicted with them.

    Raises
    ------
    BadInput
        If the prediction was altered, or locked for other models or another campaign.
    """
    beside = prediction.with_suffix(".lock.json")
    campaign = _campaign(case := read_case(case_folder, with_measurements=False))
    if beside.exists() and prediction.exists():
        kept = read_json(beside)
        if not isinstance(kept, dict) or kept.get("prediction_sha256") != file_digest(prediction):
            raise BadInput(f"{prediction}: not the prediction that {beside.name} locks")
        if kept.get("models_sha256") != _digest(verdict):
            raise BadInput(f"{prediction}: locked for other models than this verdict's")
        if not all(isinstance(kept.get(key), dict) for key in campaign):
            raise BadInput(
                f"{beside}: does not say which campaign it was locked for; remove it to predict "
                "anew"
            )
        if other := _difference(kept, campaign):
            raise BadInput(f"{prediction}: locked for another campaign than {case_folder}: {other}")
        return kept
    table = predictions(verdict, case)
    with atomic_path(prediction) as temporary:
        table.to_csv(temporary, index=False)
    record = {
        "prediction_sha256": file_digest(prediction),
        "models_sha256": _digest(verdict),
        "locked_at": datetime.now(UTC).isoformat(timespec="seconds"),
        **campaign,
    }
    write_json(beside, record)
    return record


def score(case_folder: Path, prediction: Path, record: dict) -> dict:
    """Hold the locked prediction against the case's measured values.

    Returns
    -------
    dict
        The lock but for its runs, counts, and for null and extended model the share of readings
        within their 95 % intervals, the mean log score a reading and the error by quantity; the
        gain in log score with a t-interval over specimens.

    Raises
    ------
    BadInput
        If the prediction is not the locked one, or nothing that it predicts was measured.
    """
    if file_digest(prediction) != record["prediction_sha256"]:
        raise BadInput(f"{prediction}: altered since it was locked")
    measured = assemble(read_case(case_folder))
    rows = measured.rows[["run_id", "specimen_id", "quantity", "y"]][~measured.lower_bound]
    foreseen = pd.read_csv(prediction, dtype={"run_id": str})
    both = rows.merge(foreseen, on=["run_id", "quantity"], validate="one_to_one")
    if not len(both):
        raise BadInput(f"{case_folder}: nothing that was predicted has been measured")
    found: dict = {key: record[key] for key in record if key not in ("nominal", "runs")}
    found["readings"] = len(both)
    for name, column in MODELS:
        miss, sd = both["y"] - both[f"{column}_mean"], both[f"{column}_sd"]
        both[name] = -0.5 * np.log(2 * np.pi * sd**2) - 0.5 * (miss / sd) ** 2
        errors = (miss**2).groupby(both["quantity"]).mean() ** 0.5
        found[name] = {
            "within_95": round(float(np.mean(np.abs(miss) < 1.96 * sd)), 4),
            "log_score": round(float(both[name].mean()), 4),
            "error": {quantity: float(f"{error:.5g}") for quantity, error in errors.items()},
        }
    gains = (both["extended"] - both["null"]).groupby(both["specimen_id"]).agg(["sum", "size"])
    mean = float(gains["sum"].sum() / gains["size"].sum())
    count = len(gains)
    interval = None
    if count > 1:
        spread = np.sqrt(np.sum((gains["sum"] - mean * gains["size"]) ** 2) * count / (count - 1))
        half = float(student.ppf(0.975, count - 1) * spread / gains["size"].sum())
        interval = [round(mean - half, 4), round(mean + half, 4)]
    found |= {"specimens": count, "gain": {"estimate": round(mean, 4), "ci95": interval}}
    return found


def score_words(found: dict) -> str:
    """What the score says, in one sentence."""
    gain, inside = found["gain"], 100 * found["extended"]["within_95"]
    by = f"{gain['estimate']:+.2f}"
    if gain["ci95"] is not None:
        by += f" [{gain['ci95'][0]:.2f}, {gain['ci95'][1]:.2f}]"
    certain = gain["ci95"] is not None and gain["ci95"][0] > 0
    what = "the extended model predicts better" if certain else "no gain is certain"
    return (
        f"On {found['readings']} readings of {found['specimens']} fresh specimens, predicted "
        f"before they were looked at, {what}: {by} in log score a reading; {inside:.0f} % lie "
        "within its 95 % intervals."
    )
