"""(c) Features of drag traces: offset, stiffness, slips, plateaus and lost motion of each run.

Slips are read where the trace leaves the line of the loading spring, not as a maximum: the maximum
of a noisy, textured trace is biased, the departure is not (its small threshold is modelled).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.features.block import Block, covariates_of, downhill_rad
from slipstitch.criticise.forward.bench import STANDARD_GRAVITY_M_S2
from slipstitch.criticise.forward.drag import cell_reading
from slipstitch.friction_law import Contact

STROKE_OF = {
    "relaxed_mN": 0,
    "stiffness": 0,
    "force_first_slip_mN": 0,
    "force_plateau_mN": 0,
    "lost_motion_mm": 1,
    "force_reversal_slip_mN": 1,
    "force_back_plateau_mN": 1,
}
DEPARTURE_NOISES = 4.0


@dataclass
class DragBlock(Block):
    """Drag features; contacts at rest and in motion per row."""

    READS = (
        "mass_error",
        "tilt_along_rad",
        "tilt_across_rad",
        "backlash_m",
        "force_offset_N",
        "force_gain",
    )

    at_rest: Contact
    in_motion: Contact
    areal_mass_kg_m2: float
    area_m2: np.ndarray
    added_mass_kg: np.ndarray
    threshold_N: np.ndarray
    grid_step: np.ndarray
    grid_point: np.ndarray
    ramp_mN: np.ndarray

    def predict(self, face, edge, bench):
        quantity = self.rows["quantity"].to_numpy()
        mass = self.areal_mass_kg_m2 * (1 + bench.mass_error) * self.area_m2 + self.added_mass_kg
        load = mass * STANDARD_GRAVITY_M_S2
        tilt = downhill_rad(bench, self.rows["stage_azimuth_deg"].to_numpy(float))
        rest, motion = self.at_rest.with_load(load), self.in_motion.with_load(load)
        direction = np.where(np.isin(quantity, BACK), -1.0, 1.0)
        moving = 1e3 * cell_reading(face, motion, False, direction, tilt, bench)
        slipping = 1e3 * cell_reading(face, rest, True, direction, tilt, bench)
        # A slider that starts below its kinetic friction is pulled on to it; a departure is seen
        # once the trace is the threshold below the line.
        slipping = direction * np.maximum(direction * slipping, direction * moving)
        drop = direction * (slipping - moving)
        seen = slipping + direction * np.maximum(1e3 * self.threshold_N - drop, 0)
        seen = sampled(seen, self.grid_step, self.grid_point)
        result = np.where(np.isin(quantity, PLATEAUS), moving, seen)
        relaxed = 1e3 * bench.force_offset_N + bench.force_gain * self.ramp_mN
        result = np.where(quantity == "relaxed_mN", relaxed, result)
        result = np.where(quantity == "stiffness", 1.0 + bench.force_gain, result)
        return np.where(quantity == "lost_motion_mm", 1e3 * bench.backlash_m, result)


PLATEAUS = ("force_plateau_mN", "force_back_plateau_mN")
BACK = ("force_reversal_slip_mN", "force_back_plateau_mN")


@dataclass(frozen=True)
class Texture:
    """Pooled autocovariance of the plateaus, relative to the force: sd^2 rho^|distance|."""

    relative_sd: float
    length_mm: float

    def mean_sd(self, force_mN: float, span_mm: float) -> float:
        """Standard deviation of a plateau's mean over a span."""
        if self.relative_sd == 0:
            return 0.0
        r = max(span_mm / self.length_mm, 1e-6)
        reduction = 2.0 * (r - 1.0 + np.exp(-r)) / r**2
        return abs(force_mN) * self.relative_sd * np.sqrt(reduction)


def pooled_texture(plateaus: list[tuple[np.ndarray, float, float]], step_mm: float) -> Texture:
    """Texture from all runs' plateaus: (readings, uncertainty, level) of each.

    Raw autocovariances are summed and divided by the summed squares of the levels, so that weak
    runs, all noise, do not count. The white part (instrument noise) is left out: the lags from 1
    on are fitted by an exponential. The mean's own variance is given back.
    """
    longest = max((len(readings) for readings, _, _ in plateaus), default=0)
    lags = int(min(max(longest // 3, 2), 80))
    total, weight, span = np.zeros(lags), np.zeros(lags), 0.0
    white = 0.0
    for readings, u, level in plateaus:
        count = len(readings)
        if count < 3 * 4:
            continue
        residual = readings - readings.mean()
        for lag in range(min(lags, count // 2)):
            total[lag] += residual[: count - lag] @ residual[lag:]
            weight[lag] += (count - lag) * level**2
        white += count * (1.5 * u) ** 4
        span = max(span, count * step_mm)
    if weight[0] == 0 or lags < 3:
        return Texture(0.0, 1.0)
    covariance = np.divide(total, weight, out=np.zeros(lags), where=weight > 0)
    doubt = 3.0 * np.sqrt(white) / weight[0]
    if covariance[1] <= doubt:
        return Texture(0.0, 1.0)
    below = np.flatnonzero(covariance[1:] < max(0.25 * covariance[1], doubt))
    last = int(below[0]) + 1 if len(below) else lags
    used = np.arange(1, max(last, 3))
    used = used[covariance[used] > 0]
    if len(used) >= 2:
        slope, intercept = np.polyfit(used, np.log(covariance[used]), 1)
        slope = min(slope, -1e-3)
    else:  # gone within two samples
        slope, intercept = -1.5, np.log(covariance[1]) + 1.5
    length = float(-step_mm / slope)
    variance = np.exp(intercept) * (1.0 + 2.0 * length / max(span, length))
    return Texture(float(np.sqrt(min(variance, 2.0 * covariance[0]))), length)


@dataclass(frozen=True)
class Feature:
    """A value with its uncertainty, and the grid that sampling laid under it (0: none)."""

    value: float
    uncertainty: float
    grid_step: float = 0.0
    grid_point: float = 0.0
    ramp_mN: float = 0.0


def trace_features(
    out: pd.DataFrame, back: pd.DataFrame, spring_mN_mm: float, u: float, texture: Texture
) -> dict[str, Feature]:
    """Features of one run by quantity.

    Parameters
    ----------
    out, back
        Strokes 0 and 1, in order of time: x_stage_mm, force_mN.
    """
    features: dict[str, Feature] = {}
    x, force = out["x_stage_mm"].to_numpy(), out["force_mN"].to_numpy()
    if len(x) < 8:
        return features
    x = np.abs(x - x[0])
    step = float(np.median(np.abs(np.diff(x)))) or 1e-6
    threshold = DEPARTURE_NOISES * u
    level = float(np.median(force[len(force) // 2 :]))
    slope, offset = spring_mN_mm, 0.0
    ramp = x < 0.6 * max(level, 2 * threshold) / spring_mN_mm
    ramp &= np.arange(len(x)) < max(2 * ramp.sum(), 2)
    excess = force[ramp] - spring_mN_mm * x[ramp]
    centre = x[ramp].mean()
    spread = float(((x[ramp] - centre) ** 2).sum())
    offset = float(excess.mean())
    # At the middle of the ramp the offset is independent of the slope.
    features["relaxed_mN"] = Feature(
        offset, u / np.sqrt(len(excess)), ramp_mN=spring_mN_mm * centre
    )
    if len(excess) >= 4:
        gain = float(((x[ramp] - centre) * excess).sum() / spread)
        if gain > -0.8 * spring_mN_mm:
            error = np.hypot(u / np.sqrt(spread) / spring_mN_mm, 1e-3)
            features["stiffness"] = Feature(1 + gain / spring_mN_mm, float(error))
            slope, offset = spring_mN_mm + gain, offset - gain * centre
    first = _first_lasting(offset + slope * x - force > threshold)
    if first is None or first == 0:
        return features
    if first > 6:  # once more, with all of the line: a long line needs a good slope
        line = np.flatnonzero(np.abs(offset + slope * x - force)[: first - 1] < threshold)
        if len(line) > 4:
            slope, offset = np.polyfit(x[line], force[line], 1)
        first = _first_lasting(offset + slope * x - force > threshold)
        if first is None or first == 0:
            return features
    grid = slope * (x[first] - x[first - 1])
    error = np.sqrt(grid**2 / 12 + 0.5 * u**2 + (texture.relative_sd * level) ** 2)
    features["force_first_slip_mN"] = Feature(
        float(force[first - 1] + 0.5 * grid),
        float(error),
        float(grid),
        float(offset + slope * x[first]),
    )
    reach = x[-1] - x[first]
    settled = x > x[first] + max(2 * texture.length_mm, 3 * step, 0.1 * reach)
    if settled.sum() >= 5:
        features["force_plateau_mN"] = _plateau(x[settled], force[settled], u, texture)
    if len(back) >= 8 and "force_plateau_mN" in features:
        features |= _reversal(out, back, slope, u, texture, level)
    return features


def _plateau(x, force, u, texture) -> Feature:
    level = float(force.mean())
    error = np.hypot(u / np.sqrt(len(force)), texture.mean_sd(level, float(np.ptp(x))))
    return Feature(level, float(error))


def _first_lasting(flags: np.ndarray) -> int | None:
    lasting = flags[:-1] & flags[1:]
    return int(np.argmax(lasting)) if lasting.any() else None


def _reversal(out, back, slope, u, texture, level) -> dict[str, Feature]:
    features: dict[str, Feature] = {}
    turn = max(float(out["x_stage_mm"].max()), float(back["x_stage_mm"].max()))
    travel = turn - back["x_stage_mm"].to_numpy()
    force = back["force_mN"].to_numpy()
    step = float(np.median(np.abs(np.diff(travel)))) or 1e-6
    tail = out["force_mN"].to_numpy()[-2:]
    start = float(tail.mean())
    start_error = np.hypot(u, texture.relative_sd * level * np.sqrt(step / texture.length_mm))
    late = float(np.median(force[len(force) // 2 :]))
    middle, half = 0.5 * (start + late), 0.5 * (start - late)
    crossing = _first_lasting(force < middle)
    if crossing is None or half <= 0:
        return features
    reach = travel[-1] - travel[crossing]
    settled = travel > travel[crossing] + 2 * half / slope + max(
        2 * texture.length_mm, 3 * step, 0.1 * reach
    )
    if settled.sum() >= 5:
        features["force_back_plateau_mN"] = _plateau(travel[settled], force[settled], u, texture)
    samples = 2 * half / (slope * step)
    falling = np.abs(force - middle) < 0.75 * half
    falling &= np.abs(np.arange(len(force)) - crossing) <= samples
    if samples < 5 or falling.sum() < 3:
        return features
    along, drop = travel[falling], force[falling]
    centre, spread = along.mean(), float(((along - along.mean()) ** 2).sum())
    if len(along) >= 5:  # the fall's own slope: over its length a small error of it adds up
        slope = -float(((along - centre) * drop).sum() / spread)
    lost = float(centre + (drop.mean() - start) / slope)
    own = 1.0 / len(along) + ((centre - lost) ** 2 / spread if len(along) >= 5 else 0.0)
    error = np.sqrt(u**2 * own + start_error**2) / slope
    features["lost_motion_mm"] = Feature(lost, float(np.hypot(error, 0.003)))
    line = start - slope * (travel - lost)
    away = (force - line > DEPARTURE_NOISES * u) & (np.arange(len(force)) > crossing)
    first = _first_lasting(away)
    if first is not None and first > 0:
        grid = slope * (travel[first] - travel[first - 1])
        error = np.sqrt(grid**2 / 12 + 0.5 * u**2 + (texture.relative_sd * late) ** 2)
        features["force_reversal_slip_mN"] = Feature(
            float(force[first - 1] - 0.5 * grid), float(error), float(grid), float(line[first])
        )
    return features


def sampled(value: np.ndarray, grid_step: np.ndarray, grid_point: np.ndarray) -> np.ndarray:
    """Mean reading of a slip at ``value`` that sampling puts in the middle of its grid cell.

    A saw tooth, smoothed by the scatter of slips (taken as 5 %); cells repeat from run to run, so
    without it the error would not average out.
    """
    step = np.where(grid_step > 0, grid_step, 1.0)
    blur = np.maximum(0.05 * np.abs(value) / step, 0.2)
    phase = 2 * np.pi * (value - grid_point) / step
    tooth = sum(
        np.exp(-2 * (np.pi * k * blur) ** 2) * np.sin(k * phase) / (np.pi * k) for k in range(1, 4)
    )
    return value + np.where(grid_step > 0, step * tooth, 0.0)


DESIGN_QUANTITIES = ("force_plateau_mN", "force_first_slip_mN")


def drag_block(runs: pd.DataFrame, traces: pd.DataFrame | None, nominal: dict) -> DragBlock | None:
    """Features of ``drag_runs`` and ``drag``; without traces, the quantities of the design."""
    common = covariates_of(runs, "stage_azimuth_deg")
    common["stage_azimuth_deg"] = runs["stage_azimuth_deg"].to_numpy(float)
    common["speed_mm_s"] = runs["speed_mm_s"].to_numpy(float)
    common["area_m2"] = runs["area_cm2"].to_numpy(float) * 1e-4
    common["added_kg"] = runs["added_mass_g"].to_numpy(float) * 1e-3
    common["u_mN"] = runs["u_force_mN"].to_numpy(float)
    lines = []
    if traces is None:
        for i in range(len(runs)):
            for quantity in DESIGN_QUANTITIES:
                lines.append((i, quantity, Feature(np.nan, common["u_mN"].iloc[i])))
    else:
        spring = nominal["k_tether_N_m"]
        strokes = {
            (run, int(stroke)): part
            for (run, stroke), part in traces.groupby(["run_id", "stroke"], sort=False)
        }
        none = traces.iloc[:0]
        pairs = [
            (strokes.get((run, 0), none), strokes.get((run, 1), none)) for run in runs["run_id"]
        ]
        plateaus, steps = [], []
        for (out, _), u in zip(pairs, common["u_mN"], strict=True):
            force = out["force_mN"].to_numpy()[len(out) // 3 :]
            if len(force):
                plateaus.append((force, u, float(np.median(force))))
                steps.append(np.median(np.abs(np.diff(out["x_stage_mm"]))) if len(out) > 1 else 1)
        texture = pooled_texture(plateaus, float(np.median(steps)) if steps else 1.0)
        for i, (out, back) in enumerate(pairs):
            found = trace_features(out, back, spring, common["u_mN"].iloc[i], texture)
            lines += [(i, quantity, feature) for quantity, feature in found.items()]
    if not lines:
        return None
    index = np.array([line[0] for line in lines])
    rows = common.iloc[index].reset_index(drop=True)
    rows["quantity"] = [line[1] for line in lines]
    rows["y"] = [line[2].value for line in lines]
    rows["u"] = [line[2].uncertainty for line in lines]
    rows["lower_bound"] = False
    returning = np.array([STROKE_OF[line[1]] == 1 for line in lines])
    slipping = rows["quantity"].isin(["force_first_slip_mN", "force_reversal_slip_mN"]).to_numpy()
    rows["static"] = slipping
    rows["orientation_deg"] = rows["orientation_deg"] + np.where(returning, 180.0, 0.0)
    rows["azimuth_deg"] = rows["azimuth_deg"] + np.where(returning, 180.0, 0.0)
    reversal_dwell = nominal.get("reversal_dwell_s", np.nan)
    dwell = np.where(returning, reversal_dwell, rows["dwell_s"])
    rows["dwell_s"] = np.where(slipping, dwell, np.nan)
    speed = rows["speed_mm_s"].to_numpy(float)
    rows["speed_mm_s"] = np.where(slipping, np.nan, speed)
    load = nominal["rho_kg_m2"] * rows["area_m2"] + rows["added_kg"]
    contact = {
        "normal_force_N": load.to_numpy(float) * STANDARD_GRAVITY_M_S2,
        "area_m2": rows["area_m2"].to_numpy(float),
        "direction_rad": np.radians(rows["orientation_deg"].to_numpy(float)),
        "repeats": rows["repeat_index"].to_numpy(float),
        "relative_humidity_pct": rows["rh_pct"].to_numpy(float),
    }
    at_rest = Contact(dwell_s=dwell.astype(float), **contact)
    in_motion = Contact(speed_m_s=speed * 1e-3, **contact)
    rows["load_ratio"] = at_rest.load_ratio()
    return DragBlock(
        "drag",
        rows,
        at_rest,
        in_motion,
        nominal["rho_kg_m2"],
        rows["area_m2"].to_numpy(float),
        rows["added_kg"].to_numpy(float),
        DEPARTURE_NOISES * 1e-3 * rows["u_mN"].to_numpy(float) * (0.0 if traces is None else 1.0),
        np.array([line[2].grid_step for line in lines]),
        np.array([line[2].grid_point for line in lines]),
        np.array([line[2].ramp_mN for line in lines]),
    )
