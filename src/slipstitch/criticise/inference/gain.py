"""Gain of the extended model on specimens it has not seen, the selection repeated without them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from slipstitch.criticise.inference.candidates import Candidate
from slipstitch.criticise.inference.faulty_data import estimated_zeros
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.mixed_model import Scatter, by_specimen, total_variance
from slipstitch.criticise.inference.state import State, scatters_of
from slipstitch.criticise.verdict import Analysis


def plain_scatters(analysis: Analysis, fitted: Fit) -> dict[str, Scatter]:
    """Scatter under a model taken at its word (no shrunken alternatives): for prediction.

    Outliers count: a fresh campaign will have them too.
    """
    return scatters_of(analysis.measurements, fitted, analysis.state.sensitivity, {})


@dataclass
class _Linear:
    """A fitted candidate with what each specimen contributes to its normal equations.

    ``rows`` are the features of each. ``grams`` (specimens, k + 1, k + 1) are of the parameters'
    columns and the residual (n,), from which sensors' zeros are taken.
    """

    fitted: Fit
    residual: np.ndarray
    extra: int
    rows: list[np.ndarray]
    grams: np.ndarray

    def without(self, left: int) -> tuple[float, np.ndarray, np.ndarray]:
        """Sum of squares on the other specimens, change of the parameters, their covariance."""
        gram = self.grams.sum(axis=0) - self.grams[left]
        gradient = gram[:-1, -1]
        scale = np.array([p.scale for p in self.fitted.parameters])
        covariance = np.linalg.inv(gram[:-1, :-1] + np.diag(1.0 / (30 * scale) ** 2))
        step = covariance @ gradient
        return float(gram[-1, -1] - gradient @ step), step, covariance


def _linear(analysis: Analysis, fitted: Fit, state: State, extra: int) -> _Linear:
    zeros, _ = estimated_zeros(fitted, analysis.state)
    m = analysis.measurements
    residual = m.y - fitted.prediction - m.zero_columns @ zeros
    columns = np.column_stack([fitted.jacobian, residual])
    parts = by_specimen(state.groups, state.scatters, columns)
    rows, grams = [rows for rows, _ in parts], np.array([gram for _, gram in parts])
    return _Linear(fitted, residual, extra, rows, grams)


def mean_of_clusters(sums: np.ndarray, sizes: np.ndarray) -> tuple[float, float]:
    """Mean over all members of clusters, and half of its 95 % interval by what clusters say."""
    mean, others = sums.sum() / sizes.sum(), max(len(sums) - 1, 1)
    error = np.sqrt(np.sum((sums - mean * sizes) ** 2) * len(sums) / others) / sizes.sum()
    return float(mean), float(student.ppf(0.975, others) * error)


def held_out_gain(analysis: Analysis, candidates: list[Candidate]) -> dict:
    """Leave one specimen out; in every fold the best of ``candidates`` by BIC, or the null.

    Refits are one Gauss-Newton step from the fit to all data, which is exact for what one
    specimen can move. Returns plain data: the gain in log score a reading, its interval, and the
    errors relative to friction.
    """
    m, state = analysis.measurements, analysis.state
    runs = np.log(max(m.runs, 2))
    # The null that is predicted with is the one reported, under its own scatter; the one that
    # competes for selection is the null under the scatter of the others.
    null = _linear(analysis, analysis.null, analysis.null_state, 0)
    weights = Weights(state.measurements, state.sensitivity, state.scatters)
    models = [fit(m, weights, (), analysis.null.as_dict()), *(c.fitted for c in candidates)]
    count = len(analysis.null.values)
    rivals = [_linear(analysis, f, state, len(f.values) - count) for f in models]
    plain_null = plain_scatters(analysis, analysis.null)
    reference = analysis.chosen.fitted if analysis.chosen is not None else analysis.null
    plain_extended = plain_scatters(analysis, reference)
    # Outliers teach little but count in the score: a fresh campaign has them too.
    scores, errors = [], []
    for i, rows in enumerate(null.rows):
        fits = [model.without(i) for model in rivals]
        cost = [found[0] + model.extra * runs for found, model in zip(fits, rivals, strict=True)]
        best = int(np.argmin(cost))
        pair = [_score(analysis, null, null.without(i), rows, plain_null)] * 2
        if best:
            pair[1] = _score(analysis, rivals[best], fits[best], rows, plain_extended)
        scale = np.hypot(np.abs(state.sensitivity[rows]), m.u[rows])
        scores.append([score for score, _ in pair])
        errors.append([np.sum((error / scale) ** 2) for _, error in pair])
    sizes = np.array([len(rows) for rows in null.rows], float)
    total, specimens = sizes.sum(), len(sizes)
    if total == 0:  # bounds only
        found = [float("nan")] * 6
    else:
        plain, extended = np.array(scores).T
        estimate, reach = mean_of_clusters(extended - plain, sizes)
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


def _score(analysis: Analysis, model: _Linear, folded, rows, scatters):
    """Log density and error of the rows of a specimen that was not seen."""
    m, state = analysis.measurements, analysis.state
    _, step, covariance = folded
    columns = model.fitted.jacobian[rows]
    error = model.residual[rows] - columns @ step
    own = m.protocol[rows], m.u[rows], state.sensitivity[rows]
    variance = total_variance(*own, scatters) + np.einsum(
        "ij,jk,ik->i", columns, covariance, columns
    )
    log_density = -0.5 * (np.log(2 * np.pi * variance) + error**2 / variance)
    return float(log_density.sum()), error
