"""Gain of the extended model on specimens it has not seen, the selection repeated without them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from slipstitch.criticise.inference import mixed_model
from slipstitch.criticise.inference.candidates import Candidate
from slipstitch.criticise.inference.faulty_data import without_zeros
from slipstitch.criticise.inference.fit import Fit, fit
from slipstitch.criticise.inference.mixed_model import Scatter
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.verdict import Analysis


def plain_scatters(analysis: Analysis, fitted: Fit) -> dict[str, Scatter]:
    """Scatter under a model taken at its word (no shrunken alternatives): for prediction.

    Outliers count: a fresh campaign will have them too.
    """
    m, residual = analysis.measurements, analysis.measurements.y - fitted.prediction
    return {
        group.protocol: mixed_model.estimate_scatter(
            group, residual[group.index], group.level(), mixed_model.zeros_of(m, group)
        )[0]
        for group in mixed_model.make_groups(m, analysis.state.sensitivity)
    }


@dataclass
class _Linear:
    """A fitted candidate with what each specimen contributes to its normal equations."""

    fitted: Fit
    extra: int
    curvature: np.ndarray
    gradient: np.ndarray
    squares: np.ndarray


def _linear(analysis: Analysis, fitted: Fit, parts, extra: int) -> _Linear:
    residual = without_zeros(analysis.measurements, fitted, analysis.state)
    curvature, gradient, squares = [], [], []
    for index, inverse in parts:
        weighted = inverse @ fitted.jacobian[index]
        curvature.append(fitted.jacobian[index].T @ weighted)
        gradient.append(weighted.T @ residual[index])
        squares.append(residual[index] @ inverse @ residual[index])
    count = len(fitted.values)
    return _Linear(
        fitted,
        extra,
        np.reshape(curvature, (-1, count, count)),
        np.reshape(gradient, (-1, count)),
        np.array(squares),
    )


def held_out_gain(analysis: Analysis, candidates: list[Candidate]) -> dict:
    """Leave one specimen out; in every fold the best of ``candidates`` by BIC, or the null.

    Refits are one Gauss-Newton step from the fit to all data, which is exact for what one
    specimen can move. Returns plain data: the gain in log score a reading, its interval, and the
    errors relative to friction.
    """
    m, state = analysis.measurements, analysis.state
    parts, rows_of = _parts(analysis, state)
    runs = np.log(max(m.runs, 2))
    # The null that is predicted with is the one reported, under its own scatter; the one that
    # competes for selection is the null under the scatter of the others.
    null = _linear(analysis, analysis.null, _parts(analysis, analysis.null_state, parts)[0], 0)
    models = [fit(m, state.weights, (), analysis.null.as_dict()), *(c.fitted for c in candidates)]
    count = len(analysis.null.values)
    rivals = [_linear(analysis, f, parts, len(f.values) - count) for f in models]
    plain_null = plain_scatters(analysis, analysis.null)
    reference = analysis.chosen.fitted if analysis.chosen is not None else analysis.null
    plain_extended = plain_scatters(analysis, reference)
    scores, errors = [], []
    for i, rows in enumerate(rows_of):
        fits = [_without(model, i) for model in rivals]
        cost = [found[0] + model.extra * runs for found, model in zip(fits, rivals, strict=True)]
        best = int(np.argmin(cost))
        pair = [_score(analysis, null.fitted, _without(null, i), rows, plain_null)] * 2
        if best:
            pair[1] = _score(analysis, rivals[best].fitted, fits[best], rows, plain_extended)
        scale = np.hypot(np.abs(state.sensitivity[rows]), m.u[rows])
        scores.append([score for score, _ in pair])
        errors.append([np.sum((error / scale) ** 2) for _, error in pair])
    sizes = np.array([len(rows) for rows in rows_of], float)
    total, specimens = sizes.sum(), len(sizes)
    if total == 0:  # bounds only
        found, specimens = [float("nan")] * 6, 0
    else:
        plain, extended = np.array(scores).T
        differences = extended - plain
        estimate = differences.sum() / total
        spread = np.sum((differences - estimate * sizes) ** 2)
        error = np.sqrt(spread * specimens / max(specimens - 1, 1)) / total
        reach = student.ppf(0.975, max(specimens - 1, 1)) * error
        rmse = np.sqrt(np.sum(errors, axis=0) / total)
        found = [estimate, estimate - reach, estimate + reach, plain.sum() / total, *rmse]
    estimate, low, high, null_score, rmse_null, rmse_extended = (round(float(x), 5) for x in found)
    return {
        "estimate": estimate,
        "ci95": [low, high],
        "null_score": null_score,
        "rmse_null": rmse_null,
        "rmse_extended": rmse_extended,
        "grouping": "specimen_id",
        "n_groups": specimens,
    }


def _parts(analysis: Analysis, state: State, like: list | None = None):
    """Specimen by specimen: its features with their inverse variance, and the rows to score.

    ``like``: the parts of another state, whose specimens are given in the same order.
    """
    m = analysis.measurements
    parts, rows_of = [], []
    for group in state.groups:
        specimens = m.specimen[group.index]
        for specimen in np.unique(specimens):
            mine = np.flatnonzero(specimens == specimen)
            variance = group.part(mine).variance(state.scatters[group.protocol])
            parts.append((group.index[mine], np.linalg.inv(variance)))
            # Outliers teach little but count in the score: a fresh campaign has them too.
            rows_of.append(np.flatnonzero((m.specimen == specimen) & ~m.lower_bound))
    if like is not None:
        found = {m.specimen[part[0][0]]: part for part in parts}
        nothing = (np.zeros(0, int), np.zeros((0, 0)))
        parts = [found.get(m.specimen[part[0][0]], nothing) for part in like]
    return parts, rows_of


def _without(model: _Linear, left: int):
    """Sum of squares on the other specimens, change of the parameters, their covariance."""
    curvature = model.curvature.sum(axis=0) - model.curvature[left]
    gradient = model.gradient.sum(axis=0) - model.gradient[left]
    squares = model.squares.sum() - model.squares[left]
    scale = np.array([p.scale for p in model.fitted.parameters])
    ridge = np.diag(1.0 / (30 * scale) ** 2)
    covariance = np.linalg.inv(curvature + ridge)
    step = covariance @ gradient
    return squares - gradient @ step, step, covariance


def _score(analysis: Analysis, fitted: Fit, folded, rows, scatters):
    """Log density and error of the rows of a specimen that was not seen."""
    m, state = analysis.measurements, analysis.state
    _, step, covariance = folded
    columns = fitted.jacobian[rows]
    error = without_zeros(m, fitted, state)[rows] - columns @ step
    scatter = scatters[m.protocol[rows[0]]]
    d = state.sensitivity[rows]
    variance = (
        (scatter.kappa * m.u[rows]) ** 2
        + d**2 * (scatter.specimen**2 + scatter.run**2)
        + np.einsum("ij,jk,ik->i", columns, covariance, columns)
    )
    log_density = -0.5 * (np.log(2 * np.pi * variance) + error**2 / variance)
    return float(log_density.sum()), error
