"""What may stand behind a mechanism's evidence: time in the session, and the run before.

Where loads, speeds or rests were taken in an order, a drift with time looks like an effect of
them. A cause is named only if its evidence survives beside every rival.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.inference.ratio import data_ratios
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.inference.structure import Test
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.mechanisms import MECHANISMS

SURVIVES_AT = 0.01
TIME, BEFORE, ZEROS_OFF = "time_in_session", "run_before", "sensor_zeros"
TITLES = {
    TIME: "a drift with the time in the session",
    BEFORE: "memory of the run before",
    ZEROS_OFF: "zeros of sensors that are off",
}
REMEMBERED_COLUMNS = ("load_ratio", "speed_mm_s", "dwell_s")


@dataclass(frozen=True)
class Rival:
    """A smooth curve that friction may follow instead: factors (n, k) of its columns."""

    name: str
    factors: np.ndarray


def rivals_of(measurements: Measurements) -> list[Rival]:
    """The rivals that a case's order of runs allows."""
    m = measurements
    time, memory = np.zeros((len(m.y), 3)), []
    before = {name: np.zeros(len(m.y)) for name in REMEMBERED_COLUMNS}
    for protocol in np.unique(m.protocol):
        mine = np.flatnonzero(m.protocol == protocol)
        runs, first, of_run = np.unique(m.run[mine], return_index=True, return_inverse=True)
        if len(runs) < 4:
            continue
        clock = m.rows["clock_min"].to_numpy(float)[mine][first]
        # Rows stand in the order in which they were measured, where no clock says otherwise.
        clock = clock if np.isfinite(clock).all() else first.astype(float)
        z = 2 * (clock - clock.min()) / max(np.ptp(clock), 1e-12) - 1
        time[mine] = np.column_stack([z, z**2, z**3])[of_run]
        specimen = m.specimen[mine][first]
        order = np.lexsort([clock, specimen])
        follows = np.flatnonzero(specimen[order][1:] == specimen[order][:-1])
        for name in REMEMBERED_COLUMNS:
            values = _of_runs(m.rows[name].to_numpy(float)[mine], of_run, len(runs))
            with np.errstate(divide="ignore", invalid="ignore"):
                values = np.log(values)
            last = np.full(len(runs), np.nan)
            last[order[follows + 1]] = values[order[follows]]
            known = np.isfinite(last)
            if known.sum() < 4 or np.ptp(last[known]) < 1e-9:
                continue
            before[name][mine] = np.where(known, last - last[known].mean(), 0.0)[of_run]
    memory = [column for column in before.values() if np.any(column != 0)]
    rivals = [Rival(TIME, time)] if np.any(time != 0) else []
    return [*rivals, Rival(BEFORE, np.column_stack(memory))] if memory else rivals


def _of_runs(values: np.ndarray, of_run: np.ndarray, count: int) -> np.ndarray:
    """The value of each run, NaN where no feature of it has one."""
    result = np.full(count, np.nan)
    known = np.isfinite(values)
    result[of_run[known]] = values[known]
    return result


def taken_by_rivals(
    measurements: Measurements, fitted: Fit, null_state: State, state: State
) -> dict[str, list[str]]:
    """Causes of a fit whose evidence a rival takes away, with the rivals that do."""
    m, names = measurements, [p.name for p in fitted.parameters]
    factors = {r.name: r.factors * state.sensitivity[:, None] for r in rivals_of(m)}
    taken: dict[str, list[str]] = {}
    for cause in fitted.causes:
        if MECHANISMS[cause].covariate is None:
            continue
        own = [names.index(p.name) for p in MECHANISMS[cause].parameters]
        others = [j for j in range(len(names)) if j not in own]
        columns = fitted.jacobian[:, own]
        change = columns @ (fitted.values[own] - [fitted.parameters[j].null for j in own])
        residual = m.y - fitted.prediction + change
        tests = [Test(columns, columns_of, mechanism=cause) for columns_of in factors.values()]
        if not tests:
            continue
        scatters = {g.protocol: null_state.scatters[g.protocol] for g in state.groups}
        ratios = data_ratios(
            tests, fitted.jacobian[:, others], residual, state.groups, scatters, m.zero_columns
        )
        limit = chi_square.isf(SURVIVES_AT, len(own))
        lost = [name for name, ratio in zip(factors, ratios, strict=True) if ratio < limit]
        if lost:
            taken[cause] = lost
    return taken
