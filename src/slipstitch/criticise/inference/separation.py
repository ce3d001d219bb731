"""What to measure next to tell rivals apart, with the expected gain in log-likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.candidates import Candidate
from slipstitch.criticise.inference.fit import Fit, jacobian
from slipstitch.criticise.inference.mixed_model import Scatter, make_groups
from slipstitch.criticise.measurements import Measurements, measurements_of
from slipstitch.criticise.protocols import PROTOCOLS
from slipstitch.criticise.protocols.protocol import Protocol
from slipstitch.criticise.verdict import Analysis

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
class Separation:
    """A measurement that separates two rivals."""

    between: tuple[tuple[str, ...], tuple[str, ...]]
    measure: str
    expected_delta_loglik: float


def _design(
    case: Case, protocol: Protocol, column: str, levels: tuple[float, ...]
) -> Measurements | None:
    rows = []
    settings = {k: _usual(case, protocol, k, v) for k, v in protocol.usual_settings.items()}
    for trial in range(TRIALS):
        for level in levels:
            row = {**COMMON, **settings, column: float(level)}
            row["run_id"] = f"n{len(rows)}"
            row["specimen_id"] = f"N{trial}"
            rows.append(row)
    try:
        tables = {protocol.runs_table: pd.DataFrame(rows)}
        block = protocol.features(tables, case.nominal, False)
    except KeyError:  # a nominal value that this protocol needs is not given
        return None
    block.rows.insert(0, "protocol", protocol.name)
    return measurements_of([block])


def _usual(case: Case, protocol: Protocol, column: str, otherwise: float) -> float:
    table = case.tables.get(protocol.runs_table)
    if table is None or column not in table or not table[column].notna().any():
        return otherwise
    values = table[column].dropna()
    return float(values.median() if column.startswith("u_") else values.mode().iloc[0])


def _direct_checks() -> dict[str, dict[str, float]]:
    """Measurements of a mechanism itself, and to what standard deviation they tell parameters."""
    checks: dict[str, dict[str, float]] = {}
    for mechanism in MECHANISMS.values():
        if mechanism.direct_check is not None:
            measure, readings = mechanism.direct_check
            checks.setdefault(measure, {}).update(readings)
    return checks


def separations(case: Case, analysis: Analysis, most_pairs: int = 3) -> list[Separation]:
    """The best measurement for each of the closest pairs of rivals.

    The expected gain is half the squared distance of the two predictions in units of scatter,
    noise and both fits' uncertainty: ``1/2 d' (V + J_A S_A J_A' + J_B S_B J_B')^-1 d``.
    """
    by_causes = {c.causes: c for c in analysis.ranking}
    rivals = [by_causes[c] for c in analysis.alternatives if c in by_causes]
    designs = []
    for protocol in PROTOCOLS.values():
        for column, levels in protocol.varied:
            design = _design(case, protocol, column, levels)
            if design is not None:
                text = ",".join(f"{level:g}" for level in levels)
                measure = f"{protocol.name}, {column} in {{{text}}}, {TRIALS} trials each"
                designs.append((measure, design))
    cache: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}
    result = []
    for a, b in list(combinations(rivals, 2))[:most_pairs]:
        options = [
            (_expected(analysis, a, b, design, i, cache), text)
            for i, (text, design) in enumerate(designs)
        ]
        options += [(_direct(a, b, readings), text) for text, readings in _direct_checks().items()]
        value, text = max(options)
        result.append(Separation((a.causes, b.causes), text, round(value, 2)))
    return result


def _expected(analysis, a: Candidate, b: Candidate, design, number, cache) -> float:
    parts = []
    for c in (a, b):
        key = (c.causes, number)
        if key not in cache:
            cache[key] = _predicted(c.fitted, design)
        parts.append(cache[key])
    (f_a, s_a), (f_b, s_b) = parts
    protocol = design.protocol[0]
    scatter = analysis.state.scatters.get(protocol) or Scatter(0.04, 0.03, 1.2)
    values = a.fitted.as_dict()
    values = {p.name: values.get(p.name, p.null) for p in design.null_parameters}
    group = make_groups(design, design.sensitivity(values))[0]
    variance = group.variance(scatter) + s_a + s_b
    difference = f_a - f_b
    return float(0.5 * difference @ np.linalg.solve(variance, difference))


def _predicted(fitted: Fit, design: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and the variance that the fit's parameters give it; an unknown mu is as the
    other one, with a wide prior."""
    parameters = [*design.null_parameters]
    names = {p.name for p in parameters}
    own = [p for p in fitted.parameters if not p.coefficient or p.name in names]
    missing = [p for p in parameters if p.name not in {q.name for q in own}]
    known = fitted.as_dict()
    ordered = own + missing
    values = np.array([known.get(p.name, p.null) for p in ordered])
    covariance = np.zeros((len(ordered), len(ordered)))
    position = {p.name: j for j, p in enumerate(fitted.parameters)}
    index = [position[p.name] for p in own]
    covariance[: len(own), : len(own)] = fitted.covariance[np.ix_(index, index)]
    for j in range(len(own), len(ordered)):
        covariance[j, j] = 1.0
    prediction = design.predict(
        {p.name: float(v) for p, v in zip(ordered, values, strict=True)}, fitted.causes
    )
    columns = jacobian(design, fitted.causes, ordered, values, prediction)
    return prediction, columns @ covariance @ columns.T


def _direct(a: Candidate, b: Candidate, readings: dict[str, float]) -> float:
    total, seen = 0.0, False
    for name, sd in readings.items():
        values, variances = [], []
        for c in (a, b):
            names = [p.name for p in c.fitted.parameters]
            if name in names:
                j = names.index(name)
                values.append(c.fitted.values[j] - c.fitted.parameters[j].null)
                variances.append(c.fitted.covariance[j, j])
                seen = True
            else:
                values.append(0.0)
                variances.append(0.0)
        total += 0.5 * (values[0] - values[1]) ** 2 / (sd**2 + sum(variances))
    return float(total) if seen else 0.0
