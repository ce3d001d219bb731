"""Scatter, weights and tests at a fitted model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from slipstitch.criticise.inference.alternatives import alternatives, sensitivity_of
from slipstitch.criticise.inference.covariance import Group, Scatter, make_groups
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.ratio import run_tests
from slipstitch.criticise.inference.scatter import START_SCATTER, estimate_scatter
from slipstitch.criticise.inference.structure import Outcome, Test
from slipstitch.criticise.measurements import Measurements

REFITS = 2


@dataclass
class State:
    """Scatter, weights and tests at one fitted model."""

    keep: np.ndarray
    groups: list[Group]
    scatters: dict[str, Scatter]
    weights: Weights
    sensitivity: np.ndarray
    tests: list[Test]
    untestable: dict[str, str]


def state_at(
    measurements: Measurements,
    fitted: Fit,
    keep: np.ndarray,
    start: dict[str, Scatter] | None = None,
) -> State:
    """Estimate the scatter at a fitted model and set up the weights and tests there."""
    sensitivity = sensitivity_of(fitted)
    uncensored = keep & ~measurements.lower_bound
    groups = make_groups(measurements, sensitivity, uncensored)
    found = alternatives(measurements, fitted, keep)
    residual = measurements.y - fitted.prediction
    scatters = {}
    for group in groups:
        guess = (start or {}).get(group.protocol, START_SCATTER)
        scatters[group.protocol], _ = estimate_scatter(
            group,
            residual[group.index],
            level_column(group, sensitivity),
            zeros_of(measurements, group),
            guess,
        )
    weights = Weights.build(groups, scatters, measurements, sensitivity, keep)
    return State(keep, groups, scatters, weights, sensitivity, found.tests, found.untestable)


def zeros_of(measurements: Measurements, group: Group) -> np.ndarray:
    """Columns of the zeros of a protocol's sensors, (features, z), each with unit prior sd."""
    own = [k for k, (protocol, _) in enumerate(measurements.zeros) if protocol == group.protocol]
    return measurements.zero_columns[np.ix_(group.index, own)]


def level_column(group: Group, sensitivity: np.ndarray) -> np.ndarray:
    """The fixed effect of the scatter's estimate, (features, 1): the level of friction."""
    d = sensitivity[group.index]
    size = np.linalg.norm(d)
    return (d / size)[:, None] if size > 0 else np.zeros((len(d), 0))


def test_at(
    measurements: Measurements,
    fitted: Fit,
    state: State,
    rng: np.random.Generator,
    replicates: int,
    limits: tuple[float, ...] = (),
) -> Outcome:
    """Tests of everything beyond the fitted model."""
    residual = measurements.y - fitted.prediction
    return run_tests(
        state.tests,
        fitted.jacobian,
        residual,
        state.groups,
        state.scatters,
        rng,
        replicates,
        limits,
        measurements.zero_columns,
    )


@dataclass
class Refit:
    """A model fitted with the scatter that suits it, and its maximised log-likelihood."""

    fitted: Fit
    scatters: dict[str, Scatter]
    log_likelihood: float


def refit(
    measurements: Measurements,
    keep: np.ndarray,
    causes: tuple[str, ...],
    start: Fit,
    scatters: dict[str, Scatter],
    nuisance: np.ndarray | None = None,
) -> Refit:
    """Fit causes and scatter in turn, from a fit and scatters to start from.

    ``nuisance`` (n, q) columns are fitted freely.
    """
    fitted, scatters = start, dict(scatters)
    total = -np.inf
    for _ in range(REFITS):
        sensitivity = sensitivity_of(fitted)
        groups = make_groups(measurements, sensitivity, keep & ~measurements.lower_bound)
        weights = Weights.build(groups, scatters, measurements, sensitivity, keep)
        if nuisance is not None:
            weights = weights.with_nuisance(nuisance)
        fitted = fit(measurements, weights, causes, fitted.as_dict())
        residual = measurements.y - fitted.prediction
        bounds = weights.bounds
        z = (fitted.prediction - measurements.y)[bounds] / weights.bound_sd
        total = float(log_ndtr(z).sum())
        for group in groups:
            fixed = np.zeros((len(group.index), 0))
            if nuisance is not None:
                fixed = _independent(nuisance[group.index])
            scatters[group.protocol], value = estimate_scatter(
                group,
                residual[group.index],
                fixed,
                zeros_of(measurements, group),
                scatters[group.protocol],
                restricted=False,
            )
            total += value
    return Refit(fitted, scatters, total)


def _independent(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the columns."""
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, values > 1e-9 * max(values.max(initial=0.0), 1e-300)]
