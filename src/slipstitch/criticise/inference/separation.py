"""What to measure next to tell rivals apart, with the expected gain in log-likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from slipstitch.criticise.case import Case
from slipstitch.criticise.features import Measurements
from slipstitch.criticise.features.drag import drag_block
from slipstitch.criticise.features.drop_drag import drop_drag_block
from slipstitch.criticise.features.incline import incline_block
from slipstitch.criticise.features.spring_slider import spring_slider_block
from slipstitch.criticise.features.strip import strip_block
from slipstitch.criticise.inference.analysis import Analysis, Candidate
from slipstitch.criticise.inference.covariance import Scatter, make_groups
from slipstitch.criticise.inference.fit import Fit, jacobian

TRIALS = 5
BUILDERS = {
    "incline": incline_block,
    "strip": strip_block,
    "drag": lambda table, nominal, measured: drag_block(table, None, nominal),
    "drop_drag": lambda table, nominal, measured: drop_drag_block(table, None, nominal),
    "spring_slider": lambda table, nominal, measured: spring_slider_block(table, None, nominal),
}
COMMON = {
    "clock_min": 30.0,
    "repeat_index": 0.0,
    "orientation_deg": 0.0,
    "dwell_s": 10.0,
    "rh_pct": 50.0,
    "pos_x_mm": 50.0,
    "operator": "",
}
SETTINGS = {
    "incline": {
        "azimuth_deg": 0.0,
        "area_cm2": 50.0,
        "added_mass_g": 20.0,
        "u_angle_deg": 0.3,
    },
    "strip": {
        "azimuth_deg": 0.0,
        "length_mm": 45.0,
        "width_mm": 12.0,
        "ply": 1.0,
        "push_speed_mm_s": 0.5,
        "u_eps": 0.004,
    },
    "drag": {
        "stage_azimuth_deg": 0.0,
        "area_cm2": 100.0,
        "added_mass_g": 20.0,
        "speed_mm_s": 10.0,
        "u_force_mN": 0.3,
    },
    "drop_drag": {
        "stage_azimuth_deg": 0.0,
        "height_mm": 100.0,
        "speed_mm_s": 10.0,
        "u_pos_mm": 0.3,
    },
    "spring_slider": {
        "stage_azimuth_deg": 0.0,
        "area_cm2": 50.0,
        "added_mass_g": 50.0,
        "spring_N_m": 200.0,
        "speed_mm_s": 1.0,
        "u_force_mN": 0.5,
    },
}
VARIED = (
    ("incline", "added_mass_g", (0, 5, 20, 50, 200)),
    ("incline", "area_cm2", (12.5, 25, 50, 100)),
    ("incline", "dwell_s", (1, 10, 100, 1000)),
    ("incline", "orientation_deg", (0, 45, 90, 135, 180)),
    ("incline", "repeat_index", (0, 1, 2, 4, 8, 16)),
    ("incline", "rh_pct", (35, 50, 65)),
    ("incline", "azimuth_deg", (0, 90, 180, 270)),
    ("strip", "length_mm", (30, 45, 60)),
    ("drag", "speed_mm_s", (1, 3, 10, 30)),
    ("drag", "added_mass_g", (0, 10, 30, 100)),
    ("drag", "area_cm2", (25, 50, 100, 200)),
    ("drag", "dwell_s", (1, 10, 100, 1000)),
    ("drag", "orientation_deg", (0, 45, 90, 135, 180)),
    ("drag", "stage_azimuth_deg", (0, 90, 180, 270)),
    ("drag", "repeat_index", (0, 1, 2, 4, 8, 16)),
    ("drop_drag", "height_mm", (70, 100, 130)),
    ("drop_drag", "speed_mm_s", (3, 10, 30)),
    ("spring_slider", "speed_mm_s", (0.03, 0.3, 3)),
    ("spring_slider", "added_mass_g", (20, 50, 150)),
)
# Direct checks of bench and fabric: what to do, the parameters it reads, how well.
DIRECT = (
    ("weigh a cut of known area", {"mass_error": 0.01}),
    ("cantilever test of the fabric's stiffness", {"bending_error": 0.05}),
    ("a level on the floor along azimuths 0 and 90", {"tilt_along": 0.05, "tilt_across": 0.05}),
    ("known weights on the force cell", {"force_offset": 0.1, "force_gain": 0.005}),
    ("a ruler in the camera's view", {"camera_scale": 0.002}),
    ("a dial gauge on the stage at the reversal", {"backlash": 0.02}),
    ("a flash seen by camera and stage clock", {"time_lag": 0.02}),
)


@dataclass(frozen=True)
class Separation:
    """A measurement that separates two rivals."""

    between: tuple[tuple[str, ...], tuple[str, ...]]
    measure: str
    expected_delta_loglik: float


def _design(case: Case, protocol: str, column: str, levels) -> Measurements | None:
    rows = []
    settings = {k: _usual(case, protocol, k, v) for k, v in SETTINGS[protocol].items()}
    for trial in range(TRIALS):
        for level in levels:
            row = {**COMMON, **settings, column: float(level)}
            row["run_id"] = f"n{len(rows)}"
            row["specimen_id"] = f"N{trial}"
            rows.append(row)
    try:
        block = BUILDERS[protocol](pd.DataFrame(rows), case.nominal, False)
    except KeyError:  # a nominal value that this protocol needs is not given
        return None
    block.rows.insert(0, "protocol", protocol)
    n = len(block.rows)
    return Measurements(
        [block],
        block.rows,
        np.zeros(n),
        block.rows["u"].to_numpy(float),
        pd.factorize(block.rows["run_id"])[0],
        pd.factorize(block.rows["specimen_id"])[0],
        np.full(n, protocol),
        np.zeros(n, bool),
    )


def _usual(case: Case, protocol: str, column: str, otherwise: float) -> float:
    for name in (protocol, f"{protocol}_runs"):
        table = case.tables.get(name)
        if table is not None and column in table and table[column].notna().any():
            values = table[column].dropna()
            if column.startswith("u_"):
                return float(values.median())
            return float(values.mode().iloc[0])
    return otherwise


def separations(case: Case, analysis: Analysis, most_pairs: int = 3) -> list[Separation]:
    """The best measurement for each of the closest pairs of rivals.

    The expected gain is half the squared distance of the two predictions in units of scatter,
    noise and both fits' uncertainty: ``1/2 d' (V + J_A S_A J_A' + J_B S_B J_B')^-1 d``.
    """
    by_causes = {c.causes: c for c in analysis.ranking}
    rivals = [by_causes[c] for c in analysis.alternatives if c in by_causes]
    designs = []
    for protocol, column, levels in VARIED:
        design = _design(case, protocol, column, levels)
        if design is not None:
            text = ",".join(f"{level:g}" for level in levels)
            designs.append((f"{protocol}, {column} in {{{text}}}, {TRIALS} trials each", design))
    cache: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}
    result = []
    for a, b in list(combinations(rivals, 2))[:most_pairs]:
        options = [
            (_expected(analysis, a, b, design, i, cache), text)
            for i, (text, design) in enumerate(designs)
        ]
        options += [(_direct(a, b, readings), text) for text, readings in DIRECT]
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
    base = design.predict(values, ())
    moved = design.predict({k: v + 0.01 for k, v in values.items()}, ())
    group = make_groups(
        design.protocol,
        design.run,
        design.specimen,
        design.u,
        (moved - base) / 0.01,
        np.ones(len(base), bool),
    )[0]
    variance = group.variance(scatter) + s_a + s_b
    difference = f_a - f_b
    return float(0.5 * difference @ np.linalg.solve(variance, difference))


def _predicted(fitted: Fit, design: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and the variance that the fit's parameters give it; an unknown mu is as the
    other one, with a wide prior."""
    parameters = [*design.null_parameters]
    names = {p.name for p in parameters}
    own = [p for p in fitted.parameters if not p.name.startswith("mu_") or p.name in names]
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
