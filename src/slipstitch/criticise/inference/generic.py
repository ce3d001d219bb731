"""Shapes that are in no library: bumps, waves and steps in every recorded covariate.

Each is a factor on the friction, so its column is d(feature)/d(ln mu) times the shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

FEWEST_RUNS = 4
LOGARITHMIC = ("dwell_s", "load_ratio", "speed_mm_s")
LABELS = {
    "pos_x_mm": "place on the substrate",
    "clock_min": "time in the session",
    "rh_pct": "relative humidity",
    "repeat_index": "earlier slides",
    "dwell_s": "rest before the pull",
    "orientation_deg": "direction to the warp",
    "azimuth_deg": "lab direction",
    "load_ratio": "load",
    "speed_mm_s": "speed",
    "operator": "operator",
    "length_mm": "strip length",
    "height_mm": "clamp height",
}


@dataclass(frozen=True)
class Shape:
    """Columns (n, k) that friction may follow, with the covariate and the form in words."""

    covariate: str
    form: str
    columns: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.covariate}: {self.form}"


def covariate_values(rows: pd.DataFrame, name: str) -> np.ndarray:
    """A covariate as the shapes see it: logarithms of dwell, load and speed, NaN where missing."""
    values = rows[name].to_numpy(float)
    if name == "dwell_s":
        return np.log10(1.0 + values)
    if name in LOGARITHMIC:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log10(values)
    return values


def _levels(values: np.ndarray) -> np.ndarray:
    return np.unique(np.round(values[np.isfinite(values)], 6))


def generic_shapes(rows: pd.DataFrame, usable: np.ndarray) -> list[Shape]:
    """The bank of shapes that a case's covariates allow.

    Parameters
    ----------
    rows : one line a feature.
    usable : (n,) features that friction acts on and that are kept.
    """
    shapes: list[Shape] = []
    for name in ("pos_x_mm", "clock_min", "rh_pct", "dwell_s", "load_ratio", "speed_mm_s"):
        shapes += _along(rows, name, usable)
    shapes += _along(rows, "repeat_index", usable, bumps=False)
    shapes += _waves(rows, "orientation_deg", usable, (1, 2, 3, 4))
    shapes += _waves(rows, "azimuth_deg", usable, (1, 2, 3))
    shapes += _period(rows, usable)
    operators = [o for o in pd.unique(rows["operator"]) if o]
    if len(operators) > 1:
        recorded = rows["operator"].to_numpy() != ""
        columns = [(rows["operator"] == o).to_numpy(float) for o in operators[1:]]
        block = np.column_stack(columns) * recorded[:, None]
        if len(operators) <= 6:
            shapes.append(Shape("operator", "a step between operators", block))
    return shapes


def _along(rows, name, usable, bumps=True) -> list[Shape]:
    values = covariate_values(rows, name)
    known = np.isfinite(values)
    levels = _levels(values[known & usable])
    if len(levels) < 2:
        return []
    runs = (rows["protocol"] + "/" + rows["run_id"]).to_numpy()
    low, high = np.quantile(values[known & usable], [0.0, 1.0])
    z = np.where(known, (values - low) / max(high - low, 1e-12), 0.5)
    shapes = []
    centred = np.where(known, z - 0.5, 0.0)
    shapes.append(Shape(name, "a trend", centred[:, None]))
    if len(levels) >= 4:
        bow = np.where(known, (2 * z - 1) ** 2, 0.0)
        shapes.append(Shape(name, "a bow", bow[:, None]))
        if len(levels) >= 5:
            cubic = np.where(known, (2 * z - 1) ** 3, 0.0)
            shapes.append(Shape(name, "an S-shaped curve", np.column_stack([centred, bow, cubic])))
        if bumps:
            for width in (0.09, 0.18):
                for centre in np.linspace(0, 1, 11 if width < 0.1 else 7):
                    bump = np.where(known, np.exp(-0.5 * ((z - centre) / width) ** 2), 0.0)
                    # A bump over one or two runs is an outlier, not a shape.
                    if len(set(runs[usable & (bump > 0.5)])) >= FEWEST_RUNS:
                        at = low + centre * (high - low)
                        form = f"a bump at {_plain(name, at)}"
                        shapes.append(Shape(name, form, bump[:, None]))
    elif len(levels) == 3:
        step = np.where(known, values == levels[1], 0.0).astype(float)
        shapes.append(Shape(name, f"a bump at {_plain(name, levels[1])}", step[:, None]))
    return shapes


def _plain(name: str, value: float) -> str:
    if name == "dwell_s":
        value = 10**value - 1
    elif name in LOGARITHMIC:
        value = 10**value
    return f"{value:.3g}"


def _waves(rows, name, usable, orders) -> list[Shape]:
    values = np.radians(rows[name].to_numpy(float))
    known = np.isfinite(values)
    if len(_levels(values[known & usable])) < 2:
        return []
    names = {1: "a onefold", 2: "a twofold", 3: "a threefold", 4: "a fourfold"}
    shapes = []
    for order in orders:
        wave = np.column_stack([np.cos(order * values), np.sin(order * values)])
        wave = np.where(known[:, None], wave, 0.0)
        shapes.append(Shape(name, f"{names[order]} direction", wave))
    return shapes


def _period(rows, usable) -> list[Shape]:
    values = rows["clock_min"].to_numpy(float)
    known = np.isfinite(values)
    if len(_levels(values[known & usable])) < 8:
        return []
    span = np.ptp(values[known & usable])
    shapes = []
    for cycles in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5):
        period = span / cycles
        phase = 2 * np.pi * np.where(known, values, 0.0) / period
        wave = np.where(known[:, None], np.column_stack([np.cos(phase), np.sin(phase)]), 0.0)
        shapes.append(Shape("clock_min", f"a cycle of {period:.3g} min", wave))
    return shapes
