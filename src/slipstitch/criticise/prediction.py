"""Predictions of a verdict's models for a new case: made, locked beforehand, and scored after."""

from __future__ import annotations

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import file_digest, read_json, write_json, write_text
from slipstitch.criticise.case import Case, read_case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.discrepancy import predicted_with
from slipstitch.criticise.inference.fit import carried_over
from slipstitch.criticise.inference.gain import mean_of_clusters
from slipstitch.criticise.inference.mixed_model import total_variance
from slipstitch.criticise.measurements import Measurements, assemble
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.physics.friction_law.extended_model import curve_of

COLUMNS = {"null": "null", "extended": "ext"}  # of the models in a table of predictions


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Model(BaseModel):
    """A fitted model, as it stands in a verdict."""

    causes: list[str]
    parameters: list[str]
    values: list[FiniteFloat]
    covariance: list[list[FiniteFloat]]
    scatter: dict[str, tuple[FiniteFloat, FiniteFloat, FiniteFloat]]
    zeros: dict[str, dict[str, tuple[FiniteFloat, FiniteFloat]]] = {}

    @model_validator(mode="after")
    def _sizes_agree(self):
        sizes = {len(self.values), len(self.covariance), *map(len, self.covariance)}
        if sizes != {len(self.parameters)}:
            raise ValueError
        return self


class _Discrepancy(BaseModel):
    """A smooth factor on the coefficients, as it stands in a verdict."""

    covariate: Any
    knots: Any
    factors: Any
    ci95: list[tuple[Positive, Positive]]
    coefficients: dict[str, Positive]
    scatter: dict[str, tuple[Positive, Positive, Positive]]

    @model_validator(mode="after")
    def _is_a_curve(self):
        curve_of(self.model_dump(), "discrepancy")
        if len(self.ci95) != len(self.knots):
            raise ValueError
        return self


def _check(kind: type[BaseModel], found: Any, where: str) -> None:
    """Refuse plain data that have not the shape of what a verdict has."""
    try:
        kind.model_validate(found)
    except (BadInput, ValidationError):
        *names, last = (name for name, f in kind.model_fields.items() if f.is_required())
        raise BadInput(
            f"{where}: must contain {', '.join(names)} and {last}, as written by slipstitch "
            "criticise"
        ) from None


def read_verdict(path: Path) -> dict:
    """The verdict file; raises BadInput if it is missing or holds no models."""
    verdict = read_json(path)
    if not isinstance(verdict, dict):
        verdict = {}
    found = verdict.get("discrepancy")
    if found is not None and not (isinstance(found, dict) and found.get("covariate", 0) is None):
        _check(_Discrepancy, found, f"{path}: discrepancy")
    models = verdict.get("models")
    if not isinstance(models, dict) or not {"null", "extended"} <= set(models):
        raise BadInput(f"{path}: models: missing; must be a file written by slipstitch criticise")
    for name, model in models.items():
        _check(_Model, model, f"{path}: models.{name}")
        for cause in model["causes"]:
            if cause not in MECHANISMS:
                raise BadInput(f"{path}: models: unknown mechanism '{cause}'")
    return verdict


def predictions(verdict: dict, case: Case) -> pd.DataFrame:
    """One line per run and quantity: run_id, quantity, null and extended mean and total sd."""
    design = assemble(case, measured=False)
    table = design.rows[["run_id", "quantity"]].copy()
    for name, column in COLUMNS.items():
        found = verdict.get("discrepancy") if name == "extended" else None
        mean, sd = predict_model(verdict["models"][name], design, found)
        table[f"{column}_mean"], table[f"{column}_sd"] = mean, sd
    return table


def predict_model(
    model: dict, design: Measurements, discrepancy: dict | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd (instrument, run, specimen and parameters together) of a model, (n,) each.

    ``discrepancy`` is the verdict's smooth factor on the coefficients.
    """
    causes = tuple(model["causes"])
    known = dict(zip(model["parameters"], model["values"], strict=True))
    covariance = np.array(model["covariance"], float).reshape(len(known), len(known))
    values, columns, covariance = carried_over(design, causes, known, covariance)
    mean = design.predict(values, causes)
    factor_sd, known_scatter = np.zeros(len(mean)), model["scatter"]
    if discrepancy and discrepancy["covariate"]:
        known_scatter = known_scatter | discrepancy["scatter"]
        levels = {p.name: values[p.name] for p in design.null_parameters}
        mean, factor_sd = predicted_with(discrepancy, design, levels)
    own = model.get("zeros", {})
    zeros = np.array(
        [own.get(protocol, {}).get(zero.field, (0.0, 0.0)) for protocol, zero in design.zeros]
    ).reshape(-1, 2)
    sensitivity = columns[:, : len(design.null_parameters)].sum(axis=1)
    variance = (
        total_variance(design.protocol, design.u, sensitivity, known_scatter)
        + (sensitivity * factor_sd) ** 2
        + np.einsum("ij,jk,ik->i", columns, covariance, columns)
        + (design.zero_columns**2) @ zeros[:, 1] ** 2
    )
    return mean + design.zero_columns @ zeros[:, 0], np.sqrt(variance)


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
    The lock has ``prediction_sha256``, ``models_sha256``, ``locked_at`` (UTC), and ``nominal`` and
    ``runs`` of the case as it was predicted with them.

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
    write_text(prediction, table.to_csv(index=False))
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

    For null and extended model the share of readings within their 95 % intervals, the mean log
    score a reading and the error by quantity; the gain with a t-interval over specimens.

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
    for name, column in COLUMNS.items():
        miss, sd = both["y"] - both[f"{column}_mean"], both[f"{column}_sd"]
        both[name] = -0.5 * np.log(2 * np.pi * sd**2) - 0.5 * (miss / sd) ** 2
        errors = (miss**2).groupby(both["quantity"]).mean() ** 0.5
        found[name] = {
            "within_95": round(float(np.mean(np.abs(miss) < 1.96 * sd)), 4),
            "log_score": round(float(both[name].mean()), 4),
            "error": {quantity: float(f"{error:.5g}") for quantity, error in errors.items()},
        }
    gains = (both["extended"] - both["null"]).groupby(both["specimen_id"]).agg(["sum", "size"])
    mean, half = mean_of_clusters(*gains.to_numpy(float).T)
    interval = [round(mean - half, 4), round(mean + half, 4)] if len(gains) > 1 else None
    found |= {"specimens": len(gains), "gain": {"estimate": round(mean, 4), "ci95": interval}}
    return found


def score_words(found: dict) -> str:
    """What the score says, in one sentence."""
    gain, interval = found["gain"], found["gain"]["ci95"]
    by = f"{gain['estimate']:+.2f}"
    what = "no gain is certain"
    if interval is not None:
        by += f" [{interval[0]:.2f}, {interval[1]:.2f}]"
        what = "the extended model predicts better" if interval[0] > 0 else what
    return (
        f"On {found['readings']} readings of {found['specimens']} fresh specimens, predicted "
        f"before they were looked at, {what}: {by} in log score a reading; "
        f"{100 * found['extended']['within_95']:.0f} % lie within its 95 % intervals."
    )
