"""What may stand behind a mechanism's evidence: time, the run before, the place on the track.

Where loads, speeds or rests were taken in an order, a drift with time looks like an effect of
them. A cause is named only if its evidence survives beside every rival.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2 as chi_square

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.ratio import Ratios
from slipstitch.criticise.inference.state import State
from slipstitch.criticise.inference.structure import Test
from slipstitch.criticise.measurements import Measurements
from slipstitch.physics.friction_law import CONTACT_MECHANISMS

SURVIVES_AT = 0.01
TIME, BEFORE, PLACE = "time_in_session", "run_before", "place"
TITLES = {
    TIME: "a drift with the time in the session",
    BEFORE: "memory of the run before",
    PLACE: "friction that differs along the track",
}
REMEMBERED_COLUMNS = ("load_ratio", "speed_mm_s", "dwell_s")
# Of twice the log-likelihood, between two curves of one column.
CLEAR_LEAD = 10.0
# Of the polynomial along the track: it bends as often as a patch of a third of it needs.
PLACE_DEGREE = 4


@dataclass(frozen=True)
class Rival:
    """A smooth curve that friction may follow instead: factors (n, k) of its columns.

    ``must_lead``: half of the curve is the mechanism's own covariate; it has to explain more.
    """

    name: str
    factors: np.ndarray
    must_lead: bool = False


def rivals_of(measurements: Measurements) -> list[Rival]:
    """The rivals that a case's order of runs allows."""
    m = measurements
    time, place = np.zeros((len(m.y), 3)), np.zeros((len(m.y), PLACE_DEGREE))
    before = {name: np.zeros(len(m.y)) for name in REMEMBERED_COLUMNS}
    since = {name: np.zeros(len(m.y)) for name in REMEMBERED_COLUMNS}
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
        along = m.rows["pos_x_mm"].to_numpy(float)[mine][first]
        if np.isfinite(along).all() and len(np.unique(along)) > 2 * PLACE_DEGREE:
            z = 2 * (along - along.min()) / np.ptp(along) - 1
            place[mine] = legendre.legvander(z, PLACE_DEGREE)[of_run, 1:]
        specimen = m.specimen[mine][first]
        order = np.lexsort([clock, specimen])
        # Some features of a run may lack what others have: the last one that is known.
        of_runs = m.rows.loc[mine, list(REMEMBERED_COLUMNS)].groupby(of_run).last()
        with np.errstate(divide="ignore", invalid="ignore"):
            of_runs = np.log(of_runs.astype(float))
        before_them = of_runs.iloc[order].groupby(specimen[order]).shift().sort_index()
        for name in REMEMBERED_COLUMNS:
            values, last = of_runs[name].to_numpy(), before_them[name].to_numpy()
            known = np.isfinite(last)
            if known.sum() < 4 or np.ptp(last[known]) < 1e-9:
                continue
            before[name][mine] = np.where(known, last - last[known].mean(), 0.0)[of_run]
            both = known & np.isfinite(values)
            if both.any():
                change = last - values
                since[name][mine] = np.where(both, change - change[both].mean(), 0.0)[of_run]
    found = [Rival(TIME, time), Rival(PLACE, place)]
    found.append(Rival(BEFORE, np.column_stack(list(before.values()))))
    # What is remembered may fade towards the run's own value.
    found += [Rival(BEFORE, column[:, None], must_lead=True) for column in since.values()]
    return [
        replace(rival, factors=rival.factors[:, rival.factors.any(axis=0)])
        for rival in found
        if rival.factors.any()
    ]


def _takes(rival: Rival, nothing_left: bool, lead: float) -> bool:
    """Does a rival take a cause's evidence? ``lead``: by how much more it explains by itself."""
    if not rival.must_lead:
        return nothing_left
    return lead > CLEAR_LEAD or (nothing_left and lead > 0)


def taken_by_rivals(null_state: State, state: State) -> dict[str, list[str]]:
    """Causes of a state's fit whose evidence a rival takes away, with the rivals that do."""
    m, fitted = state.measurements, state.fitted
    names = [p.name for p in fitted.parameters]
    rivals = rivals_of(m)
    factors = [rival.factors * state.sensitivity[:, None] for rival in rivals]
    taken: dict[str, list[str]] = {}
    for cause in fitted.causes:
        if MECHANISMS[cause].covariate is None and cause not in CONTACT_MECHANISMS:
            continue
        own = [names.index(p.name) for p in MECHANISMS[cause].parameters]
        others = [j for j in range(len(names)) if j not in own]
        columns = fitted.jacobian[:, own]
        change = columns @ (fitted.values[own] - [fitted.parameters[j].null for j in own])
        residual = m.y - fitted.prediction + change
        tests = [Test(columns, columns_of, mechanism=cause) for columns_of in factors]
        if not tests:
            continue
        scatters = {g.protocol: null_state.scatters[g.protocol] for g in state.groups}
        tests += [Test(columns_of, mechanism=cause) for columns_of in factors]
        tests.append(Test(columns, mechanism=cause))
        ratios = Ratios(
            tests, fitted.jacobian[:, others], residual, state.groups, scatters, m.zero_columns
        )
        best = ratios.observed().max(axis=0)
        beside, alone, own_alone = np.split(best, [len(rivals), 2 * len(rivals)])
        limit = chi_square.isf(SURVIVES_AT, len(own))
        lost = [
            rival.name
            for rival, left, explained in zip(rivals, beside, alone, strict=True)
            if _takes(rival, left < limit, explained - own_alone[0])
        ]
        if lost:
            taken[cause] = list(dict.fromkeys(lost))
    return taken
