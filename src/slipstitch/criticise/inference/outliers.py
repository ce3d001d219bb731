"""Runs, and single features of runs, that no model explains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slipstitch.criticise.inference.alternatives import rich_columns
from slipstitch.criticise.inference.fit import Fit, Weights, fit
from slipstitch.criticise.inference.mixed_model import (
    START_SCATTER,
    Clusters,
    estimate_scatter,
    zeros_of,
)
from slipstitch.criticise.inference.state import State, state_at
from slipstitch.criticise.measurements import Measurements

OUTLIER_T = 4.2
SUSPECT_T = 2.6
OUTLIER_FRACTION = 0.08


@dataclass
class Excluded:
    """A run, or one feature of it, that no model explains."""

    run_id: str
    reason: str
    features: np.ndarray


def fit_without_outliers(
    measurements: Measurements,
    causes: tuple[str, ...],
    start: dict[str, float] | None,
    fitted: Fit | None = None,
) -> tuple[Fit, State, list[Excluded]]:
    """Fit, estimate the scatter, set the worst outliers aside; repeat until none is left."""
    keep = np.ones(len(measurements.y), bool)
    excluded: list[Excluded] = []
    runs = {
        p: len(set(measurements.run[measurements.protocol == p]))
        for p in np.unique(measurements.protocol)
    }
    budget = {p: max(1, int(1.5 * OUTLIER_FRACTION * n + 0.5)) for p, n in runs.items()}
    in_all = max(1, int(OUTLIER_FRACTION * sum(runs.values()) + 0.5))
    spent = {p: [0, 0] for p in runs}  # whole runs, single features
    if fitted is None:
        fitted = _first_fit(measurements, causes, keep, start)
    state = state_at(measurements, fitted, keep)
    for _ in range(6):
        new, seen = [], set()
        for outlier in find_outliers(measurements, fitted, state):
            # An outlier bends the level of its specimen: its siblings are judged without it.
            specimen = measurements.specimen[outlier.features[0]]
            if specimen in seen:
                continue
            seen.add(specimen)
            protocol = measurements.protocol[outlier.features[0]]
            whole = keep & (measurements.run == measurements.run[outlier.features[0]])
            kind = int(len(outlier.features) < whole.sum())
            total = sum(count[kind] for count in spent.values())
            room = spent[protocol][kind] < budget[protocol] and total < in_all
            if room and keep[outlier.features].all():
                spent[protocol][kind] += 1
                new.append(outlier)
            if len(new) >= 3:
                break
        fitted = fit(measurements, state.weights, causes, fitted.as_dict())
        if not new:
            break
        for outlier in new:
            keep[outlier.features] = False
        excluded += new
        state = state_at(measurements, fitted, keep, state.scatters)
        fitted = fit(measurements, state.weights, causes, fitted.as_dict())
    state = state_at(measurements, fitted, keep, state.scatters)
    fitted = fit(measurements, state.weights, causes, fitted.as_dict())
    return fitted, replace(state, fitted=fitted), excluded


def _first_fit(measurements, causes, keep, start) -> Fit:
    """A fit with usual scatters; sensitivities from a first guess of the coefficients."""
    values = dict(start or {})
    for _ in range(2):
        named = {p.name: values.get(p.name, p.null) for p in measurements.null_parameters}
        scatters = dict.fromkeys(np.unique(measurements.protocol), START_SCATTER)
        weights = Weights(measurements, measurements.sensitivity(named), keep, scatters)
        fitted = fit(measurements, weights, causes, values)
        values = fitted.as_dict()
    return fitted


def find_outliers(measurements: Measurements, fitted: Fit, state: State) -> list[Excluded]:
    """Runs (and single features) that lie far off under the rich model, the worst first.

    Suspects are left out of the scatter by which they are judged.
    """
    found: list[tuple[float, Excluded]] = []
    residual = measurements.y - fitted.prediction
    for group in state.groups:
        rich = np.column_stack([rich_columns(state.tests, group), zeros_of(measurements, group)])
        # Effects would count as scatter, and hide outliers, without columns for them.
        scatter, _ = estimate_scatter(group, residual[group.index], group.level(), rich)
        suspects = _deviations(measurements, group, scatter, rich, residual)
        suspects = [s for s in suspects if s[0] > SUSPECT_T]
        if not suspects:
            continue
        runs = len(np.unique(measurements.run[group.index]))
        suspects = suspects[: 1 + int(1.5 * OUTLIER_FRACTION * runs)]
        suspicious = np.concatenate([s[2] for s in suspects])
        kept = np.flatnonzero(~np.isin(group.index, suspicious))
        if len(kept) < 0.6 * len(group.index):
            continue
        rest = group.part(kept)
        scatter, _ = estimate_scatter(rest, residual[rest.index], rest.level(), rich[kept], scatter)
        for t, signed, features, what in _deviations(measurements, group, scatter, rich, residual):
            limit = OUTLIER_T if what == "run-level outlier" else OUTLIER_T + 0.6
            if t > limit:
                name = str(measurements.rows["run_id"].iloc[features[0]])
                found.append((t, Excluded(name, f"{what}, t={signed:.1f}", features)))
    found.sort(key=lambda item: -item[0])
    return [item[1] for item in found]


def _deviations(measurements, group, scatter, rich, residual):
    """(|t|, t, features, what) of every run and of single features, the worst first."""
    columns = np.column_stack([rich, group.level()])
    free = np.arange(columns.shape[1]) >= rich.shape[1]
    clusters = Clusters(group, columns)
    # Less what rich columns (unit prior sd) and the level (free) take.
    taken = clusters.solved(scatter, columns)
    core = columns.T @ taken + np.diag(np.where(free, 0.0, 1.0))
    precision = clusters.solved(scatter, np.eye(len(columns)))
    precision -= taken @ np.linalg.solve(core, taken.T)
    pulled = precision @ residual[group.index]
    runs, d = measurements.run[group.index], group.sensitivity
    quantities = measurements.rows["quantity"].to_numpy()[group.index]
    result = []
    for run in np.unique(runs):
        mine = np.flatnonzero(runs == run)
        information = d[mine] @ precision[np.ix_(mine, mine)] @ d[mine]
        worst = 0.0
        if information > 1e-9:
            t = float(d[mine] @ pulled[mine] / np.sqrt(information))
            worst = abs(t)
            result.append((worst, t, group.index[mine], "run-level outlier"))
        if len(mine) == 1:
            continue
        for i in mine:
            t = float(pulled[i] / np.sqrt(max(precision[i, i], 1e-12)))
            if abs(t) > worst + 1.0:
                result.append((abs(t), t, group.index[[i]], f"outlier in {quantities[i]}"))
    return sorted(result, key=lambda item: -item[0])
