"""What a protocol is to the criticism: its tables, its features, and their forward model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pandas as pd

from slipstitch.criticise.causes import Bench
from slipstitch.criticise.traces import Signal, TraceNoise
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact, FrictionLaw


@dataclass(frozen=True)
class Column:
    """One column; a text column has no range, ``choices`` limits it.

    What is ``measured`` may be missing in the run table of a design. ``usual`` is what a design
    has where a case does not say what is usual there.
    """

    name: str
    lower: float = float("-inf")
    upper: float = float("inf")
    may_be_empty: bool = False
    text: bool = False
    choices: tuple[str, ...] = ()
    measured: bool = False
    usual: float | None = None

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        if self.choices:
            return " or ".join(f"'{choice}'" for choice in self.choices)
        return f"a number from {self.lower:g} to {self.upper:g}"


def azimuth(name: str) -> Column:
    """The column of a direction in the lab."""
    return Column(name, *ANGLE_DEG, True, usual=0.0)


ANGLE_DEG = (-360.0, 360.0)
# Samples of a trace further apart, in medians of their distance, hide what happened between them.
GAP = 2.5
RUN_ID = Column("run_id", text=True)
# Of every table of runs.
RUN_COLUMNS = (
    RUN_ID,
    Column("specimen_id", may_be_empty=True, text=True),
    Column("clock_min", -1e6, 1e6, True),
    Column("repeat_index", 0, 1e5, True),
    Column("orientation_deg", *ANGLE_DEG, True),
    Column("dwell_s", 0, 1e7, True),
    Column("rh_pct", 0, 100, True),
    Column("pos_x_mm", -1e5, 1e5, True),
    Column("operator", may_be_empty=True, text=True),
)


USUAL_AREA_M2, USUAL_SESSION_H = 0.01, 2.0  # where they were not recorded


@dataclass
class Block:
    """Features of one protocol; subclasses add :meth:`predict`.

    ``rows`` has one line a feature: run_id, specimen_id, quantity, measured value ``y``, its
    instrument uncertainty ``u``, ``lower_bound`` (the truth is at or above y), ``static`` and the
    covariates of :mod:`slipstitch.criticise.covariates` (NaN or '' where not recorded or not
    meaningful). In ``orientation_deg`` and ``azimuth_deg`` is the direction of the slide itself.
    """

    # What a prediction depends on: the coefficient of its friction law, and fields of the bench.
    COEFFICIENT: ClassVar[str] = "mu_face"
    READS: ClassVar[tuple[str, ...]] = tuple(field.name for field in fields(Bench))
    # Noise of the protocol's sensors as its traces tell it.
    trace_noises: ClassVar[tuple[TraceNoise, ...]] = ()

    protocol: str
    rows: pd.DataFrame

    def hours(self) -> np.ndarray:
        """(features,) time since the middle of the session; 0 where it was not recorded.

        Without any clock, runs stand in the order of the table, in a session of a usual length.
        """
        clock = self.rows["clock_min"].to_numpy(float) / 60.0
        known = np.isfinite(clock)
        if not known.any():
            order = pd.factorize(self.rows["run_id"])[0]
            return USUAL_SESSION_H * (order / max(order.max(), 1) - 0.5)
        return np.where(known, clock - 0.5 * (clock[known].min() + clock[known].max()), 0.0)

    def predict(self, law: FrictionLaw, bench: Bench) -> np.ndarray:
        """What the instrument would read, (features,), in the units of ``y``."""
        raise NotImplementedError


def covariates_of(table: pd.DataFrame, azimuth: str) -> pd.DataFrame:
    """The common covariates of a run table, in the columns of a block."""
    rows = table[["run_id", "specimen_id"]].copy()
    rows["specimen_id"] = rows["specimen_id"].where(
        rows["specimen_id"] != "", rows["run_id"].map("(run {})".format)
    )
    for name in ("pos_x_mm", "clock_min", "rh_pct", "repeat_index", "dwell_s", "orientation_deg"):
        rows[name] = table[name].to_numpy(float)
    rows["azimuth_deg"] = table[azimuth].to_numpy(float)
    rows["operator"] = table["operator"]
    rows["support"] = table.get("support", "")
    rows["speed_mm_s"] = table.get("speed_mm_s", np.nan) * 1.0
    for name in ("load_ratio", "length_mm", "height_mm"):
        rows[name] = np.nan
    return rows


def downhill_rad(bench: Bench, azimuth_deg: np.ndarray) -> np.ndarray:
    """Slope of the floor along lab azimuths; 0 where the azimuth is not recorded."""
    azimuth = np.radians(azimuth_deg)
    slope = bench.tilt_along_rad * np.cos(azimuth) + bench.tilt_across_rad * np.sin(azimuth)
    return np.where(np.isnan(azimuth), 0.0, slope)


def feature_rows(common: pd.DataFrame, lines: list[tuple]) -> tuple[np.ndarray, pd.DataFrame]:
    """Runs' numbers and rows of features from lines (number of the run, quantity, y, u).

    ``common`` has the columns that the features of a run share.
    """
    run = np.array([line[0] for line in lines])
    rows = common.iloc[run].reset_index(drop=True)
    rows["quantity"] = [line[1] for line in lines]
    rows["y"], rows["u"] = [line[2] for line in lines], [line[3] for line in lines]
    rows["lower_bound"] = False
    return run, rows


def conditions_of(rows: pd.DataFrame) -> dict[str, np.ndarray]:
    """Fields of a contact that every protocol's rows tell."""
    return {
        "direction_rad": np.radians(rows["orientation_deg"].to_numpy(float)),
        "repeats": rows["repeat_index"].to_numpy(float),
        "relative_humidity_pct": rows["rh_pct"].to_numpy(float),
    }


@dataclass
class LoadedBlock(Block):
    """Features of a cloth that slides under a mass, with its contacts at rest and in motion."""

    at_rest: Contact
    in_motion: Contact
    cloth_mass_kg: np.ndarray
    added_mass_kg: np.ndarray

    def mass_kg(self, bench: Bench) -> np.ndarray:
        """Mass of cloth and load, (features,)."""
        return self.cloth_mass_kg * (1 + bench.mass_error) + self.added_mass_kg

    def pressed(self, bench: Bench) -> tuple[np.ndarray, Contact, Contact]:
        """The load in N, (features,), and the contacts under that load."""
        load = self.mass_kg(bench) * GRAVITY_M_S2
        return load, self.at_rest.with_load(load), self.in_motion.with_load(load)


def masses_of(runs: pd.DataFrame, nominal: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Masses of the cloth and of what lies on it, by run, kg.

    Where the area was not recorded, the mass given is that of the whole slider.
    """
    area_m2 = np.nan_to_num(runs["area_cm2"].to_numpy(float)) * 1e-4
    cloth = nominal.get("rho_kg_m2", 0.0) * area_m2
    return cloth, runs["added_mass_g"].to_numpy(float) * 1e-3


def weights_of(runs: pd.DataFrame, nominal: Mapping[str, float]) -> np.ndarray:
    """Weights of cloth and what lies on it, by run, N."""
    return GRAVITY_M_S2 * sum(masses_of(runs, nominal))


def loaded(
    runs: pd.DataFrame, nominal: Mapping[str, float], index, rows: pd.DataFrame, static: np.ndarray
) -> tuple[Contact, Contact, np.ndarray, np.ndarray]:
    """Contacts of features at rest and in motion, and their masses as :func:`masses_of`, (n,) each.

    ``index`` are the features' runs. ``static`` (n,) features tell of friction at rest; ``rows``
    have the rest before the pull and the speed of every run, and keep those of their own kind.
    """
    cloth, added = (mass[index] for mass in masses_of(runs, nominal))
    area = runs["area_cm2"].to_numpy(float)[index] * 1e-4
    shared = {
        "normal_force_N": (cloth + added) * GRAVITY_M_S2,
        "area_m2": np.where(np.isnan(area), USUAL_AREA_M2, area),
        **conditions_of(rows),
    }
    dwell, speed = (rows[name].to_numpy(float) for name in ("dwell_s", "speed_mm_s"))
    at_rest, in_motion = Contact(dwell_s=dwell, **shared), Contact(speed_m_s=1e-3 * speed, **shared)
    told_by(rows, static)
    rows["load_ratio"] = np.where(np.isnan(area), np.nan, at_rest.load_ratio())
    return at_rest, in_motion, cloth, added


def told_by(rows: pd.DataFrame, static: np.ndarray) -> None:
    """Mark the features of friction at rest; rests and speeds stay where they act."""
    rows["static"] = static
    rows["dwell_s"] = np.where(static, rows["dwell_s"], np.nan)
    rows["speed_mm_s"] = np.where(static, np.nan, rows["speed_mm_s"])


def sampled(value: np.ndarray, grid_step: np.ndarray, grid_point: np.ndarray) -> np.ndarray:
    """Mean reading of a slip at ``value`` that sampling puts in the middle of its grid cell.

    A saw tooth, smoothed by the scatter of slips (taken as 5 %): cells repeat from run to run.
    """
    step = np.where(grid_step > 0, grid_step, 1.0)
    blur = np.maximum(0.05 * np.abs(value) / step, 0.2)
    phase = 2 * np.pi * (value - grid_point) / step
    tooth = sum(
        np.exp(-2 * (np.pi * k * blur) ** 2) * np.sin(k * phase) / (np.pi * k) for k in range(1, 4)
    )
    return value + np.where(grid_step > 0, step * tooth, 0.0)


Features = Callable[[Mapping[str, pd.DataFrame], Mapping[str, float], bool], Block | None]


@dataclass(frozen=True)
class Quantity:
    """A kind of feature: its name in tables (with the unit), its title in pictures.

    ``instrument``: it tells of the instrument alone; no friction acts on it.
    """

    name: str
    title: str
    instrument: bool = False


@dataclass(frozen=True)
class Protocol:
    """One protocol of measurement.

    Attributes
    ----------
    name, letter : name in files and its letter in docs/criticise-your-data.md.
    tables : file (without its ending) -> columns; the first has a row a run, a second one the
        runs' traces.
    nominal : keys of ``meta.json``'s ``nominal`` that it cannot do without.
    quantities : its features, in the order in which they are drawn.
    features : (tables, nominal values, measured) -> features with their forward model, None if no
        run gives any. With ``measured`` False, what a design is predicted for: traces may be absent
        and measured values are not looked at.
    varied : columns, and levels of them, among which a measurement that separates rivals is sought.
    signals : columns of the traces in which glitches are looked for.
    """

    name: str
    letter: str
    tables: Mapping[str, tuple[Column, ...]]
    nominal: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    features: Features
    varied: tuple[tuple[str, tuple[float, ...]], ...] = ()
    signals: tuple[Signal, ...] = ()

    @property
    def runs_table(self) -> str:
        """The table with a row a run."""
        return next(iter(self.tables))

    @property
    def usual_settings(self) -> dict[str, float]:
        """What the columns of a run usually hold, where a case does not say it."""
        columns = self.tables[self.runs_table]
        return {column.name: column.usual for column in columns if column.usual is not None}
