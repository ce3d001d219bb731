"""What the data themselves have wrong: sensors' zeros, and noise beyond what is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from slipstitch.criticise.inference.alternatives import sensitivity_of
from slipstitch.criticise.inference.clusters import Clusters, log_likelihood
from slipstitch.criticise.inference.covariance import (
    KAPPA_LIMITS,
    Group,
    Scatter,
    make_groups,
    scatter_prior,
)
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.scatter import estimate_scatter
from slipstitch.criticise.inference.state import State, zeros_of
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.sensors import DataFinding

# Twice the gain in log-likelihood of a finding: chi squared of one degree at p = .001.
CLEAR_RATIO = 10.8
# From where on a quantity has its own noise, and the factors among which it is sought.
USED_RATIO = 6.6
NOISE_FACTORS = (0.8, 1.25, 1.6, 2.0, 2.5, 3.0)
FEWEST_FEATURES = 8
SWEEPS = 2
# A quantity's own noise has swelled the others' common factor before it is allowed for.
KAPPA_SHARES = (0.6, 0.7, 0.8, 0.9, 1.0, 1.1)
USUAL_UNDERSTATEMENT = 1.5


def estimated_zeros(
    measurements: Measurements, fitted: Fit, state: State, usual: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Zeros in units of their prior sd, and their covariance, beside a fitted model.

    ``usual``: with their priors; else each one without its own, beside the others with theirs.
    """
    m, count = measurements, measurements.zero_columns.shape[1]
    if not count or not state.groups:
        return np.zeros(count), np.zeros((count, count))
    residual = m.y - fitted.prediction
    columns = np.column_stack([m.zero_columns, fitted.jacobian])
    size = columns.shape[1]
    gram, pulled = np.zeros((size, size)), np.zeros(size)
    for group in state.groups:
        variance = group.variance(state.scatters[group.protocol])
        factor = cholesky(variance, lower=True, check_finite=False)
        white = solve_triangular(
            factor,
            np.column_stack([columns[group.index], residual[group.index]]),
            lower=True,
            check_finite=False,
        )
        gram += white[:, :-1].T @ white[:, :-1]
        pulled += white[:, :-1].T @ white[:, -1]
    scale = [1.0] * count + [30.0 * p.scale for p in fitted.parameters]
    ridge = 1.0 / np.array(scale) ** 2
    if usual:
        covariance = np.linalg.inv(gram + np.diag(ridge))
        return (covariance @ pulled)[:count], covariance[:count, :count]
    values, variances = np.zeros(count), np.zeros((count, count))
    for k in range(count):
        own = ridge.copy()
        own[k] = 1e-6
        covariance = np.linalg.inv(gram + np.diag(own))
        values[k], variances[k, k] = (covariance @ pulled)[k], covariance[k, k]
    return values, variances


def without_zeros(measurements: Measurements, fitted: Fit, state: State) -> np.ndarray:
    """Residuals less what the sensors' zeros explain, (n,)."""
    values, _ = estimated_zeros(measurements, fitted, state)
    return measurements.y - fitted.prediction - measurements.zero_columns @ values


def zero_findings(measurements: Measurements, fitted: Fit, state: State) -> list[DataFinding]:
    """Zeros that are clearly off."""
    values, covariance = estimated_zeros(measurements, fitted, state, usual=False)
    found = []
    for k, (protocol, zero) in enumerate(measurements.zeros):
        error = float(np.sqrt(covariance[k, k]))
        if error > 0 and (values[k] / error) ** 2 > CLEAR_RATIO:
            size, reach = values[k] * zero.sd, 1.96 * error * zero.sd
            found.append(
                DataFinding(
                    protocol,
                    zero.sensor,
                    zero.quantity,
                    "zero",
                    float(size),
                    (float(size - reach), float(size + reach)),
                    zero.unit,
                )
            )
    return found


def noise_of_quantities(
    measurements: Measurements, fitted: Fit, state: State
) -> tuple[np.ndarray, list[DataFinding]]:
    """Factors of the uncertainties, (n,), where a quantity's noise is not as stated, and findings.

    Every mechanism's column is fitted freely beside: an effect on one quantity is not its noise.
    """
    factors, found = np.ones(len(measurements.y)), []
    residual = measurements.y - fitted.prediction
    groups = make_groups(
        measurements, sensitivity_of(fitted), state.keep & ~measurements.lower_bound
    )
    quantity = measurements.rows["quantity"].to_numpy()
    for group in groups:
        names = [
            name
            for name in np.unique(quantity[group.index])
            if np.sum(quantity[group.index] == name) >= FEWEST_FEATURES
        ]
        if len(np.unique(quantity[group.index])) < 2:
            continue  # the noise of one reading a run cannot be told from the runs' scatter
        own, shares = _own_noise(measurements, group, residual, state, fitted, names, quantity)
        for name, (factor, ratio, kappa) in shares.items():
            count = np.sum(quantity[group.index] == name)
            everywhere = (measurements.protocol == group.protocol) & (quantity == name)
            factors[everywhere] = own[name]
            size = factor * kappa
            if ratio > CLEAR_RATIO and size > USUAL_UNDERSTATEMENT:
                reach = 1.96 * size / np.sqrt(2 * count)
                title = next(
                    q.title for q in PROTOCOLS[group.protocol].quantities if q.name == name
                )
                found.append(
                    DataFinding(
                        group.protocol,
                        title,
                        name,
                        "noise",
                        float(size),
                        (float(size - reach), float(size + reach)),
                        "1",
                    )
                )
    return factors, found


def _own_noise(measurements, group: Group, residual, state, fitted, names, quantity):
    """Factor of each quantity, and (factor, twice the gain, kappa) of those that have their own."""
    columns = [fitted.jacobian[group.index]]
    columns += [t.columns[group.index] for t in state.tests if t.mechanism is not None]
    columns = np.column_stack(columns)
    norm = np.linalg.norm(columns, axis=0)
    left, size, _ = np.linalg.svd(columns[:, norm > 0] / norm[norm > 0], full_matrices=False)
    fixed = left[:, size > 1e-3 * size.max(initial=1e-300)]
    if fixed.shape[1] > 0.4 * len(group.index):
        fixed = fixed[:, : int(0.4 * len(group.index))]
    zeros = zeros_of(measurements, group)
    labels, own = quantity[group.index], dict.fromkeys(names, 1.0)
    scatter, _ = estimate_scatter(group, residual[group.index], fixed, zeros)
    shares: dict[str, tuple[float, float, float]] = {}

    def value(factors: dict[str, float], scatter: Scatter) -> tuple[float, float]:
        u = group.u * np.array([factors.get(label, 1.0) for label in labels])
        changed = Group(
            group.protocol, group.index, u, group.sensitivity, group.specimen, group.run
        )
        clusters = Clusters(changed, np.column_stack([fixed, zeros]))
        of = clusters.responses(residual[group.index][:, None])
        tried = [replace(scatter, kappa=share * scatter.kappa) for share in KAPPA_SHARES]
        tried = [s for s in tried if KAPPA_LIMITS[0] <= s.kappa <= KAPPA_LIMITS[1]]
        return max(
            (
                log_likelihood(clusters, s, of, fixed.shape[1], True) + scatter_prior(s),
                s.kappa,
            )
            for s in tried
        )

    for _ in range(SWEEPS):
        for name in names:
            bare = value(own | {name: 1.0}, scatter)
            tried = {f: value(own | {name: f}, scatter) for f in NOISE_FACTORS}
            factor = max(tried, key=tried.get)
            ratio = 2 * (tried[factor][0] - bare[0])
            if ratio > USED_RATIO:
                own[name], shares[name] = factor, (factor, ratio, tried[factor][1])
            else:
                own[name] = 1.0
                shares.pop(name, None)
    return own, shares
