"""What a design could have seen, and named; and what to measure next to tell rivals apart.

An effect is seen where its likelihood ratio is beyond what the maxima simulated for this design and
noise leave at the limit of the family-wise p, which a non-central chi-squared gives. An effect is
named where the part of it that no other mechanism can imitate tells it from the closest one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.special import chdtri
from scipy.stats import ncx2, norm

from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference import mixed_model
from slipstitch.criticise.inference.candidates import TIE_BIC, Candidate
from slipstitch.criticise.inference.fit import Fit, carried_over, jacobian, named
from slipstitch.criticise.inference.mixed_model import Scatter
from slipstitch.criticise.inference.state import State, alternatives
from slipstitch.criticise.inference.structure import ERROR_WEIGHTS, SIGNIFICANCE, Outcome
from slipstitch.criticise.measurements import Measurements, measurements_of
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.protocols.protocol import Protocol

POWER = 0.8
# Logarithm of the largest change of friction for which an effect counts as one that could be seen:
# none is known to change it tenfold, and tests that are linear in the effect say nothing there.
LARGEST_CHANGE = np.log(10.0)
# Columns of laws that have a kink are secants: less than this is no difference between two.
LEAST_SHARE = 0.1
# Noncentrality beside the closest rival from where on an effect is named at that power.
NAMED_FROM = (np.sqrt(TIE_BIC) + norm.ppf(POWER)) ** 2
TRIALS = 5
COMMON = {
    "clock_min": 30.0,
    "repeat_index": 0.0,
    "orientation_deg": 0.0,
    "dwell_s": 10.0,
    "rh_pct": 50.0,
    "pos_x_mm": 50.0,
    "operator": "",
}


@dataclass(frozen=True)
class Detectable:
    """The smallest effect of a mechanism that is seen at :data:`POWER`.

    ``size`` in ``unit`` of the mechanism's ``parameter``; infinite where nothing would show it.
    ``on_friction`` is the largest change of a feature's friction that it makes, as a logarithm.
    From the size ``named`` on it is told from ``rival``, the mechanism that is most like it ('' if
    none is); infinite where it would only be noticed.
    """

    parameter: str
    size: float
    unit: str
    on_friction: float
    named: float = np.inf
    rival: str = ""


def smallest_detectable(state: State, outcome: Outcome) -> dict[str, Detectable]:
    """The smallest effect of every mechanism beside a fitted model, by its tests' outcome."""
    sensitivity = state.sensitivity
    acting = sensitivity != 0
    found: dict[str, Detectable] = {}
    largest = outcome.largest.get("mechanism")
    if largest is None or outcome.information is None:
        return found
    rivals = closest_rivals(state)
    critical = float(np.quantile(largest, 1.0 - SIGNIFICANCE * ERROR_WEIGHTS["mechanism"]))
    noncentrality: dict[tuple[int, float], float] = {}
    for i, test in enumerate(outcome.tests):
        information, degrees = outcome.information[i], int(outcome.degrees[i])
        if test.mechanism is None:
            continue
        parameter = MECHANISMS[test.mechanism].tested_parameters()[0]
        size, change, named = np.inf, np.inf, np.inf
        own, rival = rivals.get(test.mechanism, (0.0, ""))
        if information > 1e-12:  # less is the rounding of a derivative that is zero
            threshold = float(chdtri(degrees, 10.0**-critical) * outcome.inflation[i])
            key = (degrees, round(threshold, 3))
            if key not in noncentrality:
                noncentrality[key] = _needed(threshold, degrees)
            steps = np.sqrt(noncentrality[key] / information)
            size = float(steps * parameter.scale)
            relative = np.abs(test.columns[acting]) / np.abs(sensitivity[acting])[:, None]
            change = float(steps * relative.max(initial=0.0))
            size = size if change < LARGEST_CHANGE else np.inf
            further = np.sqrt(NAMED_FROM / max(own * noncentrality[key], 1e-12))
            if change * max(further, 1.0) < LARGEST_CHANGE:
                named = size * max(further, 1.0)
        known = found.get(test.mechanism)
        if known is None or size < known.size:
            found[test.mechanism] = Detectable(
                parameter.name, size, parameter.unit, change, named, rival
            )
    return found


def closest_rivals(state: State) -> dict[str, tuple[float, str]]:
    """The share of every mechanism's information that its closest rival leaves, and that rival."""
    mechanisms = [test for test in state.tests if test.mechanism is not None]
    base, zeros = state.fitted.jacobian, state.measurements.zero_columns
    columns = np.column_stack([base, zeros, *(test.columns for test in mechanisms)])
    gram = mixed_model.gram_of(state.groups, state.scatters, columns)
    fixed = base.shape[1] + zeros.shape[1]
    size = np.sqrt(np.maximum(gram.diagonal(), 1e-300))
    gram = gram / size / size[:, None]
    ridge = np.where(np.arange(fixed) < base.shape[1], 1e-9, size[:fixed] ** -2)
    carried = np.linalg.solve(gram[:fixed, :fixed] + np.diag(ridge), gram[:fixed])
    left = (gram - gram[:fixed].T @ carried)[fixed:, fixed:]
    ends = np.cumsum([0, *(test.columns.shape[1] for test in mechanisms)])
    places = [np.arange(*pair) for pair in pairwise(ends)]
    found: dict[str, tuple[float, str]] = {}
    for test, own in zip(mechanisms, places, strict=True):
        inner = left[np.ix_(own, own)]
        share, rival = 1.0, ""
        for other, rest in zip(mechanisms, places, strict=True):
            if other.mechanism == test.mechanism or inner[0, 0] < 1e-9:
                continue
            cross = left[np.ix_(own, rest)]
            both = np.linalg.pinv(left[np.ix_(rest, rest)], 1e-6, hermitian=True)
            apart = np.linalg.pinv(inner, 1e-6, hermitian=True) @ (inner - cross @ both @ cross.T)
            least = float(np.clip(np.linalg.eigvals(apart).real.min(), 0.0, 1.0))
            if least < share:
                share, rival = least, other.mechanism
        share = share if share > LEAST_SHARE else 0.0
        if share > found.get(test.mechanism, (-1.0, ""))[0]:
            found[test.mechanism] = share, rival
    return found


def _needed(threshold: float, degrees: int) -> float:
    """Noncentrality that exceeds a threshold of chi squared at :data:`POWER`."""

    def missing(value):
        return ncx2.sf(threshold, degrees, value) - POWER

    return float(brentq(missing, 1e-9, 50.0 + 4.0 * threshold))


def plain_model(design: Measurements, assumed: Mapping[str, float]) -> State:
    """Plain friction in a campaign that is still to be made, and the scatter of each protocol.

    ``assumed``: the coefficients, ``scatter_specimen``, ``scatter_run`` and ``noise_factor``.
    """
    parameters = list(design.null_parameters)
    values = np.array([np.log(assumed[p.name]) for p in parameters])
    prediction = design.predict(named(parameters, values), ())
    columns = jacobian(design, (), values)
    scatters = {}
    for block in design.blocks:
        # What the traces themselves tell of the noise is in the features' uncertainties already.
        told = max((noise.allowance for noise in block.trace_noises), default=1.0)
        factor = float(np.clip(assumed["noise_factor"] / told, *mixed_model.KAPPA_LIMITS))
        scatters[block.protocol] = Scatter(
            assumed["scatter_specimen"], assumed["scatter_run"], factor
        )
    plain = Fit((), parameters, values, 0.0, prediction, columns, np.zeros((0, 0)))
    return State(design, plain, scatters, *alternatives(design, plain))


def of_design(plain: State, seed: int, replicates: int) -> dict[str, Detectable]:
    """The same for a campaign that is still to be made, at its plain model."""
    exact = replace(plain.measurements, y=plain.fitted.prediction)
    outcome = replace(plain, measurements=exact).outcome(np.random.default_rng(seed), replicates)
    return smallest_detectable(plain, outcome)


def certificate(detectable: dict[str, Detectable]) -> dict:
    """What this design could have seen and named; None where nothing would show the mechanism."""

    def rounded(size: float) -> float | None:
        return float(f"{size:.3g}") if np.isfinite(size) else None

    return {
        "false_alarm_limit": SIGNIFICANCE,
        "false_alarm_rate": None,
        "power": POWER,
        "smallest_detectable": {
            name: {
                "parameter": found.parameter,
                "size": rounded(found.size),
                "named_from": rounded(found.named),
                "most_alike": found.rival or None,
                "unit": found.unit,
            }
            for name, found in sorted(detectable.items())
        },
    }


def separations(case: Case, rivals: list[Candidate], scatters: dict[str, Scatter]) -> list[dict]:
    """The best measurement for each of the closest pairs of rivals, as it stands in the verdict.

    The expected gain is half the squared distance of the two predictions in units of scatter,
    noise and both fits' uncertainty: ``1/2 d' (V + J_A S_A J_A' + J_B S_B J_B')^-1 d``.
    """
    designs = []
    for protocol in PROTOCOLS.values():
        for column, levels in protocol.varied:
            design = _design(case, protocol, column, levels)
            if design is not None:
                text = ",".join(f"{level:g}" for level in levels)
                measure = f"{protocol.name}, {column} in {{{text}}}, {TRIALS} trials each"
                designs.append((measure, design))
    checks: dict[str, dict[str, float]] = {}
    for mechanism in MECHANISMS.values():
        if mechanism.direct_check is not None:
            measure, readings = mechanism.direct_check
            checks.setdefault(measure, {}).update(readings)
    pairs = list(combinations(rivals, 2))[:3]
    predicted = {
        c.causes: [_predicted(c.fitted, design) for _, design in designs]
        for c in {c.causes: c for pair in pairs for c in pair}.values()
    }
    found = []
    for a, b in pairs:
        one, other = a.fitted, b.fitted
        options = [(_direct(one, other, readings), text) for text, readings in checks.items()]
        of_both = zip(designs, predicted[a.causes], predicted[b.causes], strict=True)
        for (text, design), *both in of_both:
            options.append((_expected(one, design, both, scatters), text))
        value, measure = max(options)
        between = [list(a.causes), list(b.causes)]
        entry = {"between": between, "measure": measure, "expected_delta_loglik": round(value, 2)}
        found.append(entry)
    return found


def _design(
    case: Case, protocol: Protocol, column: str, levels: tuple[float, ...]
) -> Measurements | None:
    """Trials at levels of a column, all else as is usual in the case."""
    settings, table = dict(COMMON), case.tables.get(protocol.runs_table)
    for name, value in protocol.usual_settings.items():
        own = table[name].dropna() if table is not None and name in table else ()
        if len(own):
            value = float(own.median() if name.startswith("u_") else own.mode().iloc[0])
        settings[name] = value
    rows = [
        settings | {column: float(level), "specimen_id": f"N{trial}"}
        for trial in range(TRIALS)
        for level in levels
    ]
    runs = pd.DataFrame(rows).assign(run_id=[f"n{i}" for i in range(len(rows))])
    try:
        block = protocol.features({protocol.runs_table: runs}, case.nominal, False)
    except KeyError:  # a nominal value that this protocol needs is not given
        return None
    return measurements_of([block])


def _predicted(fitted: Fit, design: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and the variance that the fit's parameters give it."""
    known, causes = fitted.as_dict(), fitted.causes
    values, columns, covariance = carried_over(design, causes, known, fitted.covariance)
    return design.predict(values, causes), columns @ covariance @ columns.T


def _expected(fitted: Fit, design: Measurements, both, scatters: dict[str, Scatter]) -> float:
    """Gain of a design: ``both`` are prediction and variance of two rivals, one of them fitted."""
    (one, of_one), (other, of_other) = both
    scatter = scatters.get(design.protocol[0]) or Scatter(0.04, 0.03, 1.2)
    known = fitted.as_dict()
    values = {p.name: known.get(p.name, p.null) for p in design.null_parameters}
    group = mixed_model.make_groups(design, design.sensitivity(values))[0]
    variance = group.variance(scatter) + of_one + of_other
    return float(0.5 * (one - other) @ np.linalg.solve(variance, one - other))


def _direct(one: Fit, other: Fit, readings: dict[str, float]) -> float:
    """Gain of measuring mechanisms themselves: standard deviations by parameter."""
    total = 0.0
    for name, sd in readings.items():
        values, variances = [], []
        for fitted in (one, other):
            own = [j for j, p in enumerate(fitted.parameters) if p.name == name]
            values.append(sum(fitted.values[j] - fitted.parameters[j].null for j in own))
            variances.append(sum(fitted.covariance[j, j] for j in own))
        total += 0.5 * (values[0] - values[1]) ** 2 / (sd**2 + sum(variances))
    return float(total)
