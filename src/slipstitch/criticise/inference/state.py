"""Scatter, weights and tests at a fitted model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.inference.alternatives import Alternatives, alternatives
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.mixed_model import (
    START_SCATTER,
    Group,
    Scatter,
    estimate_scatter,
    make_groups,
    zeros_of,
)
from slipstitch.criticise.inference.ratio import Ratios
from slipstitch.criticise.inference.structure import Outcome, Test
from slipstitch.criticise.measurements import Measurements

REFITS = 2


@dataclass(frozen=True)
class State:
    """Scatter, weights and tests at one fitted model of the measurements."""

    measurements: Measurements
    fitted: Fit
    groups: list[Group]
    scatters: dict[str, Scatter]
    weights: Weights
    sensitivity: np.ndarray
    tests: list[Test]
    untestable: dict[str, str]

    @property
    def keep(self) -> np.ndarray:
        """(n,) features that are no outliers."""
        return self.measurements.usual

    def outcome(
        self, rng: np.random.Generator, replicates: int, limits: tuple[float, ...] = ()
    ) -> Outcome:
        """Tests of everything beyond the fitted model."""
        m, fitted = self.measurements, self.fitted
        residual = m.y - fitted.prediction
        return Ratios(
            self.tests, fitted.jacobian, residual, self.groups, self.scatters, m.zero_columns
        ).outcome(rng, replicates, limits)


def state_at(
    measurements: Measurements,
    fitted: Fit,
    start: dict[str, Scatter] | None = None,
    found: Alternatives | None = None,
) -> State:
    """Estimate the scatter at a fitted model and set up the weights and tests there."""
    sensitivity = fitted.sensitivity()
    found = found or alternatives(measurements, fitted)
    residual = measurements.y - fitted.prediction
    scatters = {}
    for group in make_groups(measurements, sensitivity):
        scatters[group.protocol], _ = estimate_scatter(
            group,
            residual[group.index],
            group.level(),
            zeros_of(measurements, group),
            (start or {}).get(group.protocol, START_SCATTER),
        )
    weights = Weights(measurements, sensitivity, scatters)
    return State(
        measurements,
        fitted,
        weights.groups,
        scatters,
        weights,
        sensitivity,
        found.tests,
        found.untestable,
    )


@dataclass(frozen=True)
class Refit:
    """A model fitted with the scatter that suits it, and its maximised log-likelihood."""

    fitted: Fit
    scatters: dict[str, Scatter]
    log_likelihood: float


def refit(
    measurements: Measurements,
    causes: tuple[str, ...],
    start: Fit,
    scatters: dict[str, Scatter],
    sensitivity: np.ndarray,
    nuisance: np.ndarray | None = None,
) -> Refit:
    """Fit causes and scatter in turn, from a fit and scatters to start from.

    Parameters
    ----------
    sensitivity : (n,) by which scatter enters, the same for all models that are compared: slips
        that sampling puts on a grid make it jump with the coefficient.
    nuisance : (n, q) columns that are fitted freely.
    """
    fitted, scatters = start, dict(scatters)
    total = -np.inf
    for _ in range(REFITS):
        weights = Weights(measurements, sensitivity, scatters, nuisance)
        fitted = fit(measurements, weights, causes, fitted.as_dict())
        residual = measurements.y - fitted.prediction
        total = weights.log_probability(fitted.prediction)
        for group in weights.groups:
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
