"""Predictive means and total standard deviations for runs of new specimens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import read_json
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.discrepancy import predicted_with
from slipstitch.criticise.inference.fit import jacobian, parameters_of
from slipstitch.criticise.measurements import Measurements, assemble
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
