"""Every covariate of a feature: how it is called and drawn, and the shapes sought along it.

A shape is in no library: bumps, patches, waves and steps. Each is a factor on the friction, so its
column is d(feature)/d(ln mu) times the shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.inference.structure import Test

FEWEST_RUNS = 4
MOST_PARTS, MOST_CYCLES = 16, 20.0
# A session is cut between so many stretches of equally many runs, in case it changed for good
# there (benchmark seeds 320071 and 320072).
STRETCHES = 48


@dataclass(frozen=True)
class Covariate:
    """A column of the features along which friction may change.

    Attributes
    ----------
    name : the column; empty cells (NaN, or '' of a text) were not recorded.
    title, unit : as they are drawn and said.
    sought : shapes that are looked for: trends (a trend, a bow and an S-shaped curve), bumps at
        every place, patches with sharp edges of every width, changes for good, cycles of several
        periods.
    logarithmic : drawn, and searched, along its logarithm.
    from_zero : its logarithm is that of 1 + value, since it may be zero.
    waves : orders of the waves that are looked for in an angle.
    text : it names something; its values have no order.
    """

    name: str
    title: str
    unit: str = ""
    sought: tuple[str, ...] = ()
    logarithmic: bool = False
    from_zero: bool = False
    waves: tuple[int, ...] = ()
    text: bool = False

    @property
    def periodic(self) -> bool:
        """An angle in degrees."""
        return self.unit == "°"

    @property
    def axis_label(self) -> str:
        """The label of its axis."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{'log₁₀ ' if self.logarithmic else ''}{self.title}{unit}"

    def searched(self, values: np.ndarray) -> np.ndarray:
        """Values as the shapes see them, NaN where missing."""
        if self.from_zero:
            return np.log10(1.0 + values)
        if self.logarithmic:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.log10(values)
        return values

    def plain(self, searched: float) -> str:
        """A value as it was recorded, in words, from the one that shapes see."""
        if self.from_zero:
            return f"{10**searched - 1:.3g}"
        return f"{10**searched if self.logarithmic else searched:.3g}"


_TRENDS, _BUMPS = ("trends",), ("trends", "bumps")
_EVERY = ("trends", "bumps", "patches", "cycles")
_ENTRIES = (
    Covariate("pos_x_mm", "position on the substrate", "mm", _EVERY),
    Covariate("clock_min", "time in the session", "min", (*_EVERY, "changes")),
    Covariate("rh_pct", "relative humidity", "%", _BUMPS),
    Covariate("repeat_index", "earlier slides", "", _TRENDS),
    Covariate("dwell_s", "rest before the pull", "s", _BUMPS, logarithmic=True, from_zero=True),
    Covariate("orientation_deg", "direction to the warp", "°", waves=(1, 2, 3, 4)),
    Covariate("azimuth_deg", "lab direction", "°", waves=(1, 2, 3)),
    Covariate("load_ratio", "load", "p/p₀", _BUMPS, logarithmic=True),
    Covariate("load_before", "load of the run before", "own loads", _TRENDS, logarithmic=True),
    Covariate("speed_mm_s", "speed", "mm/s", _BUMPS, logarithmic=True),
    Covariate("operator", "operator", text=True),
    Covariate("support", "support", text=True),
    Covariate("length_mm", "strip length", "mm"),
    Covariate("height_mm", "clamp height", "mm"),
)
COVARIATES: Mapping[str, Covariate] = {covariate.name: covariate for covariate in _ENTRIES}


def load_before(rows: pd.DataFrame) -> np.ndarray:
    """Load of the protocol's run before over a feature's own, NaN where no load is varied.

    Runs stand in the order of their clock, or of the table where no clock was recorded.
    """
    found = np.full(len(rows), np.nan)
    for _, part in rows.groupby("protocol", sort=False):
        runs = part.groupby("run_id", sort=False)[["clock_min", "load_ratio"]].first()
        if runs["clock_min"].notna().all():
            runs = runs.sort_values("clock_min", kind="stable")
        if runs["load_ratio"].nunique() > 1:
            ratio = runs["load_ratio"].shift() / runs["load_ratio"]
            found[rows.index.get_indexer(part.index)] = part["run_id"].map(ratio)
    return found


def _shape(
    covariate: Covariate, form: str, columns: np.ndarray, scanned=False, spanned=False
) -> Test:
    return Test(columns, covariate=covariate.name, shape=form, scanned=scanned, spanned=spanned)


def _levels(values: np.ndarray) -> np.ndarray:
    return np.unique(np.round(values[np.isfinite(values)], 6))


def generic_shapes(rows: pd.DataFrame, usable: np.ndarray) -> list[Test]:
    """The bank of shapes (factors on friction) that a case's covariates allow.

    Parameters
    ----------
    rows : one line a feature.
    usable : (n,) features that friction acts on and that are kept.
    """
    every = COVARIATES.values()
    with_bumps_first = sorted(every, key=lambda covariate: "bumps" not in covariate.sought)
    shapes = [shape for one in with_bumps_first for shape in _along(rows, one, usable)]
    for found in (_waves, _cycles, _steps):
        shapes += [shape for one in every for shape in found(rows, one, usable)]
    return shapes


def _steps(rows, covariate: Covariate, usable) -> list[Test]:
    if not covariate.text:
        return []
    labels = rows[covariate.name]
    names = [name for name in pd.unique(labels) if name]
    if not 1 < len(names) <= 6:
        return []
    columns = np.column_stack([(labels == name).to_numpy(float) for name in names[1:]])
    return [_shape(covariate, f"a step between {covariate.title}s", columns)]


def _along(rows, covariate: Covariate, usable) -> list[Test]:
    if "trends" not in covariate.sought:
        return []
    name = covariate.name
    values = covariate.searched(rows[name].to_numpy(float))
    known = np.isfinite(values)
    levels = _levels(values[known & usable])
    if len(levels) < 2:
        return []
    runs = (rows["protocol"] + "/" + rows["run_id"]).to_numpy()
    low, high = np.quantile(values[known & usable], [0.0, 1.0])
    z = np.where(known, (values - low) / max(high - low, 1e-12), 0.5)
    centred = np.where(known, z - 0.5, 0.0)
    shapes = [_shape(covariate, "a trend", centred[:, None])]
    if len(levels) >= 4:
        bow = np.where(known, (2 * z - 1) ** 2, 0.0)
        shapes.append(_shape(covariate, "a bow", bow[:, None]))
        if len(levels) >= 5:
            cubic = np.where(known, (2 * z - 1) ** 3, 0.0)
            both = np.column_stack([centred, bow, cubic])
            shapes.append(_shape(covariate, "an S-shaped curve", both, spanned=True))
        if "bumps" in covariate.sought:
            for width in (0.09, 0.18):
                for centre in np.linspace(0, 1, 11 if width < 0.1 else 7):
                    bump = np.where(known, np.exp(-0.5 * ((z - centre) / width) ** 2), 0.0)
                    # A bump over one or two runs is an outlier, not a shape.
                    if len(set(runs[usable & (bump > 0.5)])) >= FEWEST_RUNS:
                        at = low + centre * (high - low)
                        form = f"a bump at {covariate.plain(at)}"
                        shapes.append(_shape(covariate, form, bump[:, None], scanned=True))
        if "patches" in covariate.sought:
            shapes += _patches(covariate, z, known, usable, runs, low, high)
        if "changes" in covariate.sought:
            shapes += _changes(covariate, values, known, usable, runs)
    elif len(levels) == 3:
        step = np.where(known, values == levels[1], 0.0).astype(float)
        form = f"a bump at {covariate.plain(levels[1])}"
        shapes.append(_shape(covariate, form, step[:, None], scanned=True))
    return shapes


def _patches(covariate: Covariate, z, known, usable, runs, low, high) -> list[Test]:
    """Top hats of every width that the design resolves, half overlapping."""
    shapes, parts = [], 2
    while parts <= MOST_PARTS:
        width, found = 1.0 / parts, []
        for left in np.arange(2 * parts - 1) * 0.5 * width:
            inside = known & (z >= left) & (z <= left + width)
            if len(set(runs[usable & inside])) >= FEWEST_RUNS:
                ends = [covariate.plain(low + e * (high - low)) for e in (left, left + width)]
                form = f"a patch from {ends[0]} to {ends[1]}"
                column = inside.astype(float)[:, None]
                found.append(_shape(covariate, form, column, scanned=True))
        if not found:
            break
        shapes += found
        parts *= 2
    return shapes


def _changes(covariate: Covariate, values, known, usable, runs) -> list[Test]:
    """Changes for good, between stretches of equally many runs."""
    _, first = np.unique(runs[known & usable], return_index=True)
    of_runs = np.sort(values[known & usable][first])
    shapes = []
    for after in np.unique(np.arange(1, STRETCHES) * len(of_runs) // STRETCHES):
        if FEWEST_RUNS <= after <= len(of_runs) - FEWEST_RUNS:
            at = 0.5 * (of_runs[after - 1] + of_runs[after])
            later = np.where(known & (values > at), 1.0, 0.0)
            form = f"a change for good at {covariate.plain(at)}"
            shapes.append(_shape(covariate, form, later[:, None], scanned=True))
    return shapes


def _waves(rows, covariate: Covariate, usable) -> list[Test]:
    if not covariate.waves:
        return []
    name = covariate.name
    values = np.radians(rows[name].to_numpy(float))
    known = np.isfinite(values)
    if len(_levels(values[known & usable])) < 2:
        return []
    names = {1: "a onefold", 2: "a twofold", 3: "a threefold", 4: "a fourfold"}
    shapes = []
    for order in covariate.waves:
        wave = np.column_stack([np.cos(order * values), np.sin(order * values)])
        wave = np.where(known[:, None], wave, 0.0)
        shapes.append(_shape(covariate, f"{names[order]} direction", wave))
    return shapes


def _cycles(rows, covariate: Covariate, usable) -> list[Test]:
    if "cycles" not in covariate.sought:
        return []
    values = rows[covariate.name].to_numpy(float)
    known = np.isfinite(values)
    if len(_levels(values[known & usable])) < 8:
        return []
    span = np.ptp(values[known & usable])
    shapes = []
    # Beyond half as many cycles as places, waves are alike at places that are evenly spread;
    # a little less, because places are not.
    most = min(0.4 * len(_levels(values[known & usable])), MOST_CYCLES)
    for cycles in np.arange(1.0, max(most, 2.5) + 0.25, 0.5):
        period = span / cycles
        phase = 2 * np.pi * np.where(known, values, 0.0) / period
        wave = np.where(known[:, None], np.column_stack([np.cos(phase), np.sin(phase)]), 0.0)
        form = f"a cycle of {period:.3g} {covariate.unit}"
        shapes.append(_shape(covariate, form, wave, scanned=True))
    return shapes
