"""Scatter, weights and tests at a fitted model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.inference.alternatives import alternatives, rich_columns, sensitivity_of
from slipstitch.criticise.inference.covariance import Group, Scatter, estimate_scatter, make_groups
from slipstitch.criticise.inference.fit import Fit, Weights
from slipstitch.criticise.inference.structure import Outcome, Test, run_tests
from slipstitch.criticise.measurements import Measurements

START_SCATTER = Scatter(0.05, 0.03, 1.2)


@dataclass
class State:
    """Scatter, weights and tests at one fitted model."""

    keep: np.ndarray
    groups: list[Group]
    scatters: dict[str, Scatter]
    weights: Weights
    sensitivity: np.ndarray
    tests: list[Test]
    rich: dict[str, np.ndarray]
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
    scatters, rich = {}, {}
    for group in groups:
        fixed = level_column(group, sensitivity)
        guess = (start or {}).get(group.protocol, START_SCATTER)
        own = rich_columns(found.tests, group, group.variance(START_SCATTER), fixed)
        scatter = estimate_scatter(group, residual[group.index], fixed, own, guess)
        rich[group.protocol] = own
        scatters[group.protocol] = scatter
    weights = Weights.build(groups, scatters, measurements, sensitivity, keep)
    return State(keep, groups, scatters, weights, sensitivity, found.tests, rich, found.untestable)


def level_column(group: Group, sensitivity: np.ndarray) -> np.ndarray:
    """The fixed effect of the scatter's estimate, (features, 1): the level of friction."""
    d = sensitivity[group.index]
    size = np.linalg.norm(d)
    return (d / size)[:, None] if size > 0 else np.zeros((len(d), 0))


def test_at(
    measurements: Measurements, fitted: Fit, state: State, rng: np.random.Generator, replicates: int
) -> Outcome:
    """Tests of everything beyond the fitted model."""
    residual = measurements.y - fitted.prediction
    return run_tests(
        state.tests,
        fitted.jacobian,
        residual,
        state.groups,
        state.scatters,
        state.rich,
        rng,
        replicates,
    )
