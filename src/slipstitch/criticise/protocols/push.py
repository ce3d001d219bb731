"""(f) A block pushed by a finger at constant speed: level of the force, and its first peak.

A finger of stiffness k that moves at speed V has a block of mass m slip at the static friction and
overshoots by inertia: the first peak lies sqrt((F_s - F_k)^2 + V^2 k m) above the level, as the
half drop of a slider on a spring (:mod:`stick_slip`). k is read off each run's own loading, so
that a peak is a sign of a static excess only where the impact does not account for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.causes import Bench
from slipstitch.criticise.protocols import protocol
from slipstitch.criticise.traces import Signal

LEVEL, PEAK = "push_level_mN", "push_peak_mN"
# A block that turns needs less force: only near-translations are read.
LARGEST_TURN_DEG, LEAST_WAY_MM = 4.0, 4.0
LOADING = (0.2, 0.8)  # of the level, between which the finger's stiffness is read
FEWEST_LOADING = 3
FEWEST_WINDOWS = 10
LEVEL_BLOCKS = 5
USUAL_STIFFNESS_N_M = 2.0e4
# Of the overshoot: damping, which the model has not, and a peak between two samples.
INERTIAL_ERROR = 0.3


@dataclass
class PushBlock(protocol.LoadedBlock):
    """Push features."""

    READS = ("mass_error", "tilt_along_rad", "tilt_across_rad", "force_gain")

    stiffness_N_m: np.ndarray
    speed_m_s: np.ndarray

    def impact_force(self, bench: Bench) -> np.ndarray:
        """First peak (features,), N, that the finger makes without a static excess."""
        return self.speed_m_s * np.sqrt(self.stiffness_N_m * self.mass_kg(bench))

    def predict(self, law, bench):
        load, rest, motion = self.pressed(bench)
        moving = law.force_limit(motion, static=False)
        resting = law.force_limit(rest, static=True)
        tilt = protocol.downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float))
        peak = np.hypot(np.maximum(resting - moving, 0.0), self.impact_force(bench))
        is_level = (self.rows["quantity"] == LEVEL).to_numpy()
        return 1e3 * (1 + bench.force_gain) * np.where(is_level, moving - load * np.sin(tilt), peak)


@dataclass(frozen=True)
class _Reading:
    """A run's level in blocks, and its first peak with the finger's stiffness (mN, N/m)."""

    blocks_mN: np.ndarray
    peak_mN: float = np.nan
    peak_sd_mN: float = np.nan
    stiffness_N_m: float = USUAL_STIFFNESS_N_M


def _read(trace: pd.DataFrame, quiet_s: float, mass_kg: float, speed_m_s: float) -> _Reading | None:
    time = trace["t_s"].to_numpy(float)
    force = trace[["force_x_mN", "force_y_mN"]].to_numpy(float)
    quiet = time - time[0] < quiet_s
    if quiet.any():
        force = force - force[quiet].mean(axis=0)
    size = np.hypot(*force.T)
    late = time > 0.5 * (time[0] + time[-1])
    if late.sum() < 4 * LEVEL_BLOCKS:
        return None
    blocks = np.array([part.mean() for part in np.array_split(size[late], LEVEL_BLOCKS)])
    low, high = (share * blocks.mean() for share in LOADING)
    above = size > high
    lasting = above[:-1] & above[1:]
    if not lasting.any():
        return _Reading(blocks)
    up = int(np.argmax(lasting))
    below = np.flatnonzero(size[:up] < low)
    on = int(below[-1]) if len(below) else up
    if up - on + 1 < FEWEST_LOADING:
        return _Reading(blocks)
    stiffness = 1e-3 * float(np.polyfit(time[on : up + 1], size[on : up + 1], 1)[0]) / speed_m_s
    step = (time[-1] - time[0]) / (len(time) - 1)
    window = max(int(2 * np.pi * np.sqrt(mass_kg / max(stiffness, 1e-9)) / step), 5)
    later = size[up + window :]
    count = len(later) // window
    if stiffness <= 0 or count < FEWEST_WINDOWS:
        return _Reading(blocks)
    means = later[: count * window].reshape(count, window).mean(axis=1)
    peak = float(size[up : up + window].max() - means.mean())
    return _Reading(blocks, peak, float(means.std(ddof=1)), stiffness)


def features(tables, nominal, measured) -> PushBlock | None:
    """Level and first peak of every near-translation; without traces, the levels of a design."""
    runs = tables["push_runs"]
    straight = (runs["turned_deg"].abs() < LARGEST_TURN_DEG) | runs["turned_deg"].isna()
    straight &= (runs["moved_mm"] > LEAST_WAY_MM) | runs["moved_mm"].isna()
    runs = runs[straight].reset_index(drop=True)
    if not len(runs):
        return None
    mass, speed = sum(protocol.masses_of(runs, nominal)), runs["speed_mm_s"].to_numpy(float) * 1e-3
    u = runs["u_force_mN"].to_numpy(float)
    stiffness = np.full(len(runs), USUAL_STIFFNESS_N_M)
    if measured:
        parts = dict(list(tables["push"].groupby("run_id", sort=False)))
        traces = [parts[run] for run in runs["run_id"]]
        readings = list(map(_read, traces, runs["quiet_s"].fillna(0.0), mass, speed))
        lines = _features(readings, u, mass, speed, stiffness)
    else:
        lines = [(i, LEVEL, np.nan, u[i]) for i in range(len(runs))]
    if not lines:
        return None
    index, rows = protocol.feature_rows(protocol.covariates_of(runs, "push_azimuth_deg"), lines)
    static = (rows["quantity"] == PEAK).to_numpy()
    under_load = protocol.loaded(runs, nominal, index, rows, static)
    return PushBlock("push", rows, *under_load, stiffness[index], speed[index])


def _features(readings, u, mass, speed, stiffness) -> list[tuple]:
    """(run, quantity, value, uncertainty) of every run; writes what ``stiffness`` was read."""
    lines = []
    within = [r.blocks_mN / r.blocks_mN.mean() - 1 for r in readings if r is not None]
    uneven = np.sqrt(np.mean(np.square(within)) * LEVEL_BLOCKS / (LEVEL_BLOCKS - 1))
    spread = [r.peak_sd_mN / r.blocks_mN.mean() for r in readings if r and r.peak_sd_mN > 0]
    single = np.sqrt(np.mean(np.square(spread))) if spread else 0.0
    for i, reading in enumerate(readings):
        if reading is None:
            continue
        level = float(reading.blocks_mN.mean())
        lines.append((i, LEVEL, level, float(np.hypot(u[i], uneven * level / LEVEL_BLOCKS**0.5))))
        if np.isfinite(reading.peak_mN):
            stiffness[i] = reading.stiffness_N_m
            overshoot = 1e3 * speed[i] * np.sqrt(stiffness[i] * mass[i])
            error = np.hypot(single * level, INERTIAL_ERROR * overshoot)
            lines.append((i, PEAK, reading.peak_mN, float(np.hypot(u[i], error))))
    return lines


PUSH = protocol.Protocol(
    "push",
    "f",
    {
        "push_runs": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("push_azimuth_deg"),
            protocol.Column("support", may_be_empty=True, text=True),
            protocol.Column("area_cm2", 1e-3, 1e5, True, usual=50.0),
            protocol.Column("added_mass_g", 0, 1e5, usual=500.0),
            protocol.Column("speed_mm_s", 1e-6, 1e4, usual=3.0),
            protocol.Column("turned_deg", *protocol.ANGLE_DEG, True),
            protocol.Column("moved_mm", 0, 1e5, True),
            protocol.Column("quiet_s", 0, 1e4, True),
            protocol.Column("u_force_mN", 1e-6, 1e5, usual=5.0),
        ),
        "push": (
            protocol.RUN_ID,
            protocol.Column("t_s", -1e7, 1e7),
            protocol.Column("force_x_mN", -1e7, 1e7),
            protocol.Column("force_y_mN", -1e7, 1e7),
        ),
    },
    nominal=(),
    quantities=(
        protocol.Quantity(LEVEL, "push, level"),
        protocol.Quantity(PEAK, "push, first peak"),
    ),
    features=features,
    signals=tuple(
        Signal(column, "force cell", "u_force_mN") for column in ("force_x_mN", "force_y_mN")
    ),
    varied=(("speed_mm_s", (0.3, 3, 30)), ("added_mass_g", (200, 500, 1500))),
)
