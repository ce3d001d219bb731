"""A fitted model with its scatter and weights, and the alternatives that it is tested against."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import orth

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.covariates import generic_shapes
from slipstitch.criticise.inference import mixed_model
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.mixed_model import Clusters, Group, Scatter
from slipstitch.criticise.inference.ratio import Ratios
from slipstitch.criticise.inference.structure import Outcome, Test
from slipstitch.criticise.measurements import Measurements

# Noncentrality, a run, that the shrunken rich model expects of all columns together. The same for
# every column: room given to columns because they stand out is not given in the simulated
# replicates, and doubled the false alarms when it was tried.
EXPECTED_NONCENTRALITY = 0.25
# What a mechanism changes by less, in units of the noise, is rounding of what cancels.
ROUNDING = 1e-7
REFITS = 2


def nuisance_columns(
    measurements: Measurements, unrecorded: np.ndarray, sensitivity: np.ndarray
) -> np.ndarray | None:
    """A free level for the features whose driving covariate is unknown, a level a protocol."""
    if not unrecorded.any():
        return None
    columns = []
    static = measurements.rows["static"].to_numpy(bool)
    for protocol in np.unique(measurements.protocol):
        for kind in (True, False):
            mine = unrecorded & (measurements.protocol == protocol) & (static == kind)
            if mine.any() and np.any(sensitivity[mine] != 0):
                columns.append(np.where(mine, sensitivity, 0.0))
    return np.column_stack(columns) if columns else None


def alternatives(measurements: Measurements, fitted: Fit) -> tuple[list[Test], dict[str, str]]:
    """Every mechanism beyond the fitted causes, and every generic shape.

    And the mechanisms that cannot be tested, with why.
    """
    sensitivity = fitted.sensitivity()
    tests: list[Test] = []
    untestable: dict[str, str] = {}
    values = fitted.as_dict()
    for name, mechanism in MECHANISMS.items():
        if name in fitted.causes:
            continue
        unrecorded = measurements.unrecorded(name)
        column_values = []
        for setting in mechanism.tested_at or ({},):
            start = values | mechanism.null_values() | setting
            causes = (*fitted.causes, name)
            columns = []
            for parameter in mechanism.tested_parameters():
                # A static excess shows once it exceeds the noise: a step of its whole scale.
                step = parameter.scale * (1.0 if parameter.kinked else 0.1)
                back = 0.0 if parameter.lower == parameter.null else step
                ends = [
                    measurements.predict(start | {parameter.name: parameter.null + s}, causes)
                    for s in (step, -back)
                ]
                change = (ends[0] - ends[1]) / (step + back) * parameter.scale
                silent = unrecorded | (np.abs(change) < ROUNDING * measurements.u)
                columns.append(np.where(silent, 0.0, change))
            column_values.append(np.column_stack(columns))
        acting = np.any([np.any(c != 0, axis=1) for c in column_values], axis=0)
        if not acting.any():
            silent = unrecorded.any()
            untestable[name] = (
                "what drives it was not recorded" if silent else "no feature would reveal it"
            )
            continue
        nuisance = nuisance_columns(measurements, unrecorded, sensitivity)
        parameters = mechanism.tested_parameters()
        one_sided = len(parameters) == 1 and parameters[0].lower == parameters[0].null
        tests += [
            Test(columns, nuisance, mechanism=name, one_sided=one_sided)
            for columns in column_values
        ]
    usable = (sensitivity != 0) & measurements.of_friction
    for shape in generic_shapes(measurements.rows, usable):
        column = measurements.rows[shape.covariate]
        empty = (column == "").to_numpy() if column.dtype == object else column.isna().to_numpy()
        nuisance = nuisance_columns(measurements, empty & usable, sensitivity)
        columns = shape.columns * np.where(usable, sensitivity, 0.0)[:, None]
        tests.append(replace(shape, columns=columns, nuisance=nuisance))
    return tests, untestable


def rich_columns(tests: list[Test], group: Group) -> np.ndarray:
    """Shrunken columns for the scatter's estimate: mechanisms and a few shapes a covariate.

    Each has the noncentrality expected of it under usual scatter, orthogonal to the level.
    """
    chosen, scanned = [], {}
    for test in tests:
        if test.spanned:
            continue
        if test.scanned:  # neighbours are alike: every third will do
            scanned[test.covariate] = scanned.get(test.covariate, 0) + 1
            if scanned[test.covariate] % 3 != 1:
                continue
        chosen.append(test.columns[group.index])
    if not chosen:
        return np.zeros((len(group.index), 0))
    columns, level = np.column_stack(chosen), group.level()
    gram = Clusters(group, np.column_stack([columns, level])).gram(mixed_model.START_SCATTER)
    before = gram.diagonal()[: columns.shape[1]]
    norm = before.copy()
    if level.shape[1]:
        norm -= gram[-1, :-1] ** 2 / gram[-1, -1]
    good = norm > 1e-3 * np.maximum(before, 1e-12)
    runs = len(np.unique(group.run))
    expected = EXPECTED_NONCENTRALITY * runs / max(int(good.sum()), 1)
    return columns[:, good] * np.sqrt(expected / norm[good])


@dataclass(frozen=True)
class State:
    """One fitted model of the measurements, its scatter, and the tests beside it."""

    measurements: Measurements
    fitted: Fit
    scatters: dict[str, Scatter]
    tests: list[Test]
    untestable: dict[str, str]

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """(n,) d(feature)/d(ln mu)."""
        return self.fitted.sensitivity()

    @cached_property
    def groups(self) -> list[Group]:
        """The features by protocol."""
        return mixed_model.make_groups(self.measurements, self.sensitivity)

    def outcome(
        self, rng: np.random.Generator, replicates: int, limits: tuple[float, ...] = ()
    ) -> Outcome:
        """Tests of everything beyond the fitted model."""
        return self.ratios().outcome(rng, replicates, limits)

    def ratios(self) -> Ratios:
        """Likelihood ratios of the tests."""
        m, base = self.measurements, self.fitted.jacobian
        residual = m.y - self.fitted.prediction
        return Ratios(self.tests, base, residual, self.groups, self.scatters, m.zero_columns)


def scatters_of(
    m: Measurements, fitted: Fit, sensitivity: np.ndarray, start: dict[str, Scatter]
) -> dict[str, Scatter]:
    """The scatter of each protocol beside a fitted model."""
    return {
        group.protocol: mixed_model.estimate_scatter(
            group,
            (m.y - fitted.prediction)[group.index],
            group.level(),
            mixed_model.zeros_of(m, group),
            start.get(group.protocol, mixed_model.START_SCATTER),
        )[0]
        for group in mixed_model.make_groups(m, sensitivity)
    }


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

    ``sensitivity`` (n,), by which scatter enters, is the same for all models that are compared:
    slips that sampling puts on a grid make it jump. ``nuisance`` columns are fitted freely.
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
                fixed = orth(nuisance[group.index], 1e-9)
            scatters[group.protocol], value = mixed_model.estimate_scatter(
                group,
                residual[group.index],
                fixed,
                mixed_model.zeros_of(measurements, group),
                scatters[group.protocol],
                restricted=False,
            )
            total += value
    return Refit(fitted, scatters, total)
