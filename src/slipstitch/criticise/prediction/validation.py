"""A verdict put to the test: a prediction locked before a case is looked at, and scored after."""

from __future__ import annotations

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import atomic_path, file_digest, read_json, write_json
from slipstitch.criticise.case import Case, read_case
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.prediction.predictive import predictions
from slipstitch.criticise.protocols import PROTOCOLS

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
