"""The alternatives that a fitted model is tested against: other mechanisms and generic shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.inference.covariance import Group, Scatter
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.generic import generic_shapes
from slipstitch.criticise.inference.structure import Test
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS

# Noncentrality, a run, that the shrunken rich model expects of all columns together. The same for
# every column: room given to columns because they stand out is not given in the simulated
# replicates, and doubled the false alarms when it was tried.
EXPECTED_NONCENTRALITY = 0.25


@dataclass
class Alternatives:
    """Tests beside a fitted model, and the sensitivity d(feature)/d(ln mu) at it."""

    tests: list[Test]
    sensitivity: np.ndarray
    untestable: dict[str, str]


def sensitivity_of(fitted: Fit) -> np.ndarray:
    """d(feature)/d(ln mu), (n,)."""
    own = [j for j, p in enumerate(fitted.parameters) if p.coefficient]
    return fitted.jacobian[:, own].sum(axis=1)


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


def alternatives(measurements: Measurements, fitted: Fit, keep: np.ndarray) -> Alternatives:
    """Every mechanism beyond the fitted causes, and every generic shape."""
    sensitivity = sensitivity_of(fitted)
    tests, untestable = [], {}
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
                change = (ends[0] - ends[1]) / (step + back)
                columns.append(np.where(unrecorded, 0.0, change * parameter.scale))
            column_values.append(np.column_stack(columns))
        acting = np.any([np.any(c != 0, axis=1) for c in column_values], axis=0) & keep
        if not acting.any():
            silent = unrecorded.any()
            untestable[name] = (
                "what drives it was not recorded" if silent else "no feature would reveal it"
            )
            continue
        nuisance = nuisance_columns(measurements, unrecorded & keep, sensitivity)
        parameters = mechanism.tested_parameters()
        one_sided = len(parameters) == 1 and parameters[0].lower == parameters[0].null
        tests += [
            Test(columns, nuisance, mechanism=name, one_sided=one_sided)
            for columns in column_values
        ]
    usable = keep & (sensitivity != 0) & measurements.of_friction
    for shape in generic_shapes(measurements.rows, usable):
        column = measurements.rows[shape.covariate]
        empty = (column == "").to_numpy() if column.dtype == object else column.isna().to_numpy()
        nuisance = nuisance_columns(measurements, empty & usable, sensitivity)
        columns = shape.columns * np.where(usable, sensitivity, 0.0)[:, None]
        tests.append(
            Test(
                columns,
                nuisance,
                covariate=shape.covariate,
                shape=shape.form,
                scanned=shape.scanned,
                spanned=shape.spanned,
            )
        )
    return Alternatives(tests, sensitivity, untestable)


def rich_columns(
    tests: list[Test], group: Group, scatter: Scatter, fixed: np.ndarray
) -> np.ndarray:
    """Shrunken columns for the scatter's estimate: mechanisms and a few shapes a covariate.

    Each is scaled to the noncentrality expected of it, seen orthogonal to the fixed columns.
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
    columns = np.column_stack(chosen)
    root = group.whitening(scatter)
    white = root.whiten(columns)
    if fixed.shape[1]:
        q, _ = np.linalg.qr(root.whiten(fixed))
        projected = white - q @ (q.T @ white)
    else:
        projected = white
    norm, before = (projected**2).sum(axis=0), (white**2).sum(axis=0)
    good = norm > 1e-3 * np.maximum(before, 1e-12)
    runs = len(np.unique(group.run))
    expected = EXPECTED_NONCENTRALITY * runs / max(int(good.sum()), 1)
    return columns[:, good] * np.sqrt(expected / norm[good])
