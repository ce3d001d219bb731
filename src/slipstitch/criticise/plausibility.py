"""Readings and sizes that no bench gives: most likely another unit, or a sign the other way round.

Each protocol's readings are turned into a rough friction coefficient by the simplest formula there
is, straight from the tables: features may already be spoilt by a wrong unit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from slipstitch.base.tables import directions_in_radians, in_radians
from slipstitch.criticise.case import Case
from slipstitch.criticise.force_cells import (
    FORCE_SLIPS,
    is_usual,
    levels_of,
    refuted_clock,
    refuted_units,
    strokes,
)
from slipstitch.criticise.protocols.protocol import weights_of
from slipstitch.criticise.protocols.strip import foot, largest_weight_number
from slipstitch.physics import GRAVITY_M_S2

FORCED = ("drag", "spring_slider", "push", "drop_drag")
SMALLEST_COEFFICIENT, LARGEST_COEFFICIENT = 0.01, 5.0
# Gauze to heavy coated cloth; loose fleece to densely woven or coated cloth.
AREAL_MASS_KG_M2 = (0.01, 2.0)
DENSITY_KG_M3 = (60.0, 2500.0)

Tables = Mapping[str, pd.DataFrame]
Nominal = Mapping[str, float]


def _of_angles(tables: Tables, nominal: Nominal) -> np.ndarray:
    table = tables["incline"]
    return np.tan(np.radians(table["angle_deg"][~(table["censored"] > 0.5)].to_numpy(float)))


def _of_strains(tables: Tables, nominal: Nominal) -> np.ndarray:
    table = tables["strip"]
    strain = table["eps_slip"][table["regime"] == "slipped"].to_numpy(float)
    ratio = np.linspace(0.0, 2.0, 2001)
    known = foot(np.zeros(len(ratio)), ratio)[0]
    return np.where(strain < 0, -1.0, np.interp(strain, known, ratio, left=0.0, right=np.inf))


def _weights(runs: pd.DataFrame, nominal: Nominal) -> pd.Series:
    """Weights in newtons by run."""
    return pd.Series(weights_of(runs, nominal), index=runs["run_id"])


def _of_forces(name: str) -> Callable[[Tables, Nominal], np.ndarray]:
    def coefficients(tables: Tables, nominal: Nominal) -> np.ndarray:
        late = pd.Series({run: levels_of(trace)[1] for run, trace in strokes(tables[name])})
        weight = _weights(tables[f"{name}_runs"], nominal).reindex(late.index)
        return (1e-3 * late / weight).to_numpy(float)

    return coefficients


def _of_pushes(tables: Tables, nominal: Nominal) -> np.ndarray:
    traces = tables["push"]
    runs = tables["push_runs"]
    quiet = runs["quiet_s"].fillna(0.0).set_axis(runs["run_id"])
    start = traces.groupby("run_id")["t_s"].transform("min")
    still = traces["t_s"] - start < quiet.reindex(traces["run_id"]).to_numpy()
    columns = ["force_x_mN", "force_y_mN"]
    zero = traces[still].groupby("run_id")[columns].mean().reindex(traces["run_id"]).fillna(0.0)
    size = np.hypot(*(traces[columns].to_numpy() - zero.to_numpy()).T)
    level = pd.Series(size[~still]).groupby(traces["run_id"].to_numpy()[~still]).median()
    return (1e-3 * level / _weights(runs, nominal).reindex(level.index)).to_numpy(float)


def _of_shapes(tables: Tables, nominal: Nominal) -> np.ndarray:
    """Flexible sheet: (l - c)^2 = h^2 + 2 h mu c."""
    frames = tables["drop_drag"]
    frames = frames[frames["phase"] == "fwd"]
    furthest = frames.groupby("run_id")["x_stage_mm"].transform("max")
    late = frames[frames["x_stage_mm"] > 0.5 * furthest].groupby("run_id")["contact_len_mm"]
    c = late.median()
    h = tables["drop_drag_runs"].set_index("run_id")["height_mm"].reindex(c.index)
    lifted = 1e3 * nominal["cloth_length_m"] - c
    return ((np.sign(lifted) * lifted**2 - h**2) / (2 * h * c.clip(lower=1e-3))).to_numpy(float)


_MASSES_AND_FORCES = (
    *((1 / unit, words) for unit, _, words in FORCE_SLIPS if unit < 1),
    (1e-3, "masses in kg, not g"),
)
# Protocol: what is read, its rough coefficients, and what the factor that mends them would mean.
READINGS: Mapping[str, tuple[str, Callable, tuple[tuple[float, str], ...]]] = {
    "incline": ("the slip angle", _of_angles, ()),
    "strip": ("the strain at slip", _of_strains, ()),
    "drag": (
        "the force",
        _of_forces("drag"),
        (
            (1e3, "forces in N, not mN"),
            (1e-3, "masses in kg, not g"),
            (10.0, "a mass or an area ten times too large"),
            (0.1, "a mass or an area ten times too small"),
        ),
    ),
    "drop_drag": ("the length on the floor", _of_shapes, ()),
    "push": ("the force", _of_pushes, _MASSES_AND_FORCES),
    "spring_slider": ("the force", _of_forces("spring_slider"), _MASSES_AND_FORCES),
}


def implausible(case: Case) -> list[str]:
    """One line for each implausible table or nominal size, with the likely unit."""
    found = _nominal_sizes(case) + _directions(case)
    for name in (name for name in case.protocols if name in READINGS):
        what, rough, slips = READINGS[name]
        values = rough(case.tables, case.nominal)
        values = values[~np.isnan(values)]
        if not len(values):
            continue
        middle = float(np.median(values))
        small_angles = name == "incline" and in_radians(case.tables[name]["angle_deg"])
        refuted = []
        if name in FORCED:
            refuted = refuted_units(case, name, middle) or refuted_clock(case, name)
        found += refuted
        usual = SMALLEST_COEFFICIENT <= middle <= LARGEST_COEFFICIENT and not small_angles
        if not refuted and not usual:
            likely = _likely(name, middle, slips)
            found.append(
                f"{name}: {what} would be that of a friction coefficient of {middle:.2g}; {likely}?"
            )
    return found


def _directions(case: Case) -> list[str]:
    """Directions of a table of runs that are all quarters or eighths of a turn in radians."""
    return [
        f"{name}: {column}: angles in radians?"
        for name, table in case.tables.items()
        for column in ("orientation_deg", "azimuth_deg", "stage_azimuth_deg", "push_azimuth_deg")
        if column in table and directions_in_radians(table[column])
    ]


def _likely(name: str, middle: float, slips: tuple[tuple[float, str], ...]) -> str:
    if middle == 0:
        return "nothing but zeros"
    if middle < 0:
        below = name in ("drag", "spring_slider", "incline")
        return "signs the other way round" if below else "lengths in another unit, or below zero"
    if name == "incline":
        if is_usual(np.tan(np.degrees(np.arctan(middle)))):
            return "angles in radians"
        return (
            "angles to the vertical" if middle > LARGEST_COEFFICIENT else "angles in another unit"
        )
    for factor, words in slips:
        if is_usual(middle * factor):
            return words
    return "lengths in another unit" if name == "drop_drag" else "readings in another unit"


def _nominal_sizes(case: Case) -> list[str]:
    nominal, found = case.nominal, []
    mass, thickness = nominal.get("rho_kg_m2"), nominal.get("thickness_m")
    low, high = AREAL_MASS_KG_M2
    if mass is not None and not low <= mass <= high:
        found.append(f"nominal rho_kg_m2 {mass:g}: cloth has {low:g} to {high:g}; in g/m²?")
    elif mass is not None and thickness:
        density = mass / thickness
        low, high = DENSITY_KG_M3
        if not low <= density <= high:
            found.append(
                f"nominal thickness_m {thickness:g} makes a cloth of {density:.3g} kg/m³ (usual: "
                f"{low:g} to {high:g}); in another unit or ten times off?"
            )
    if "drop_drag" in case.protocols:
        found += _length(case)
    if "strip" in case.protocols:
        table = case.tables["strip"]
        bending = nominal["B_strip_Nm"] * table["ply"] ** (nominal["ply_exponent"] - 1)
        weight = nominal["rho_kg_m2"] * GRAVITY_M_S2
        number = float((weight * (1e-3 * table["length_mm"]) ** 3 / bending).median())
        if number > 10 * largest_weight_number():
            found.append(
                f"strip: its weight would be {number:.3g} times its stiffness (ρ g L³/B); "
                "length_mm in another unit, or B_strip_Nm?"
            )
    return found


def _length(case: Case) -> list[str]:
    """The cloth against what of it was seen on the floor and hanging."""
    frames, runs = case.tables["drop_drag"], case.tables["drop_drag_runs"]
    length = 1e3 * case.nominal["cloth_length_m"]
    seen = float(frames["contact_len_mm"].quantile(0.95))
    height = float(runs["height_mm"].median())
    if 0.3 * length < seen + height and max(seen, height) < 1.5 * length:
        return []
    return [
        f"nominal cloth_length_m {1e-3 * length:g}: {seen:.3g} mm of it lie on the floor below a "
        f"clamp at {height:.3g} mm; a length in another unit or ten times off?"
    ]
