"""What traces of a force cell refute: units, clocks, a cell that is clipped, tared or drifts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.signal import find_peaks

from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import Bench, DataFinding
from slipstitch.criticise.protocols import push
from slipstitch.physics import GRAVITY_M_S2

CELLS = {
    "drag": ("force_mN",),
    "spring_slider": ("force_mN",),
    "push": ("force_x_mN", "force_y_mN"),
}
USUAL_COEFFICIENT = (0.05, 2.0)  # a slip of units is named if it brings the readings here
# What a slip of units makes of a loading slope and of the coefficient, and what it would be.
FORCE_SLIPS = (
    (1e-3, 1e-3, "forces in N, not mN"),
    (0.1, 0.1, "forces in cN, not mN"),
    (1 / GRAVITY_M_S2, 1 / GRAVITY_M_S2, "forces in gf, not mN"),
    (1e3, 1e3, "forces in µN, not mN"),
)
SLIPS = {
    "spring_slider": (
        *FORCE_SLIPS,
        (1e-3, 1.0, "times in ms"),
        (60.0, 1.0, "times in minutes"),
        (1 / 60, 1.0, "speed_mm_s in mm/min"),
        (10.0, 1.0, "speed_mm_s in cm/s"),
        (1e3, 1.0, "speed_mm_s in m/s"),
        (1e3, 1.0, "spring_N_m in N/mm"),
        (100.0, 1.0, "spring_N_m in N/cm"),
    ),
    "drag": (*FORCE_SLIPS, (1e3, 1.0, "x_stage_mm in m"), (10.0, 1.0, "x_stage_mm in cm")),
}
# Of a clock beside the speed of a stage.
CLOCK_SLIPS = ((1e-3, "times in ms"), (60.0, "times in minutes"), (1 / 60, "speeds in mm/min"))
# Nearer to what it should be, a slope is an error of the spring or of the cell's gain.
LARGEST_SLOPE_FACTOR = 3.0
NAMED_WITHIN, FEWEST_LOADING, FEWEST_RISES, ALIKE = 0.15, 4, 5, 0.2
# A block's first peak refutes a unit where the coefficient is as small as this, too.
SMALL_COEFFICIENT, PEAK_WITHIN = 0.1, 0.7
# Equal extreme readings, and how many times the next value's: a cell at the end of its range.
CLIPPED_READINGS, CLIPPED_FACTOR = 10, 5.0
TARED_SHARE, MAGNITUDE_SHARE = 0.3, 0.3
# Of the level, and in standard errors over the runs.
DRIFT_SHARE, DRIFT_ERRORS, DRIFT_RUNS = 0.1, 8.0, 5


def is_usual(coefficient: float) -> bool:
    """Say whether a friction coefficient is one of cloth."""
    return USUAL_COEFFICIENT[0] <= coefficient <= USUAL_COEFFICIENT[1]


def strokes(traces: pd.DataFrame, stroke: int = 0) -> Iterator[tuple[str, pd.DataFrame]]:
    """One stroke of every run, or all of a run that has none."""
    if "stroke" in traces:
        traces = traces[traces["stroke"] == stroke]
    return iter(traces.groupby("run_id", sort=False))


def _slope(x: np.ndarray, force: np.ndarray) -> float | None:
    """Slope of a rising force; None from too few readings."""
    if len(x) < FEWEST_LOADING or np.ptp(x) <= 0:
        return None
    return float(np.polyfit(x, force, 1)[0])


def loading_slopes(case: Case, name: str) -> tuple[list[float], int]:
    """Read how steep the force rises while the spring loads, over what the bench says.

    The first rise of a relaxed spring counts, else those between slips; only readings on the rise
    are used. One ratio a run that shows it, and how many runs have too few readings on a rise.
    """
    runs = case.tables[f"{name}_runs"].set_index("run_id")
    axis = "x_stage_mm" if name == "drag" else "t_s"
    ratios = []
    for run, trace in strokes(case.tables[name]):
        x, force = trace[axis].to_numpy(float), trace["force_mN"].to_numpy(float)
        if name == "drag":
            expected = case.nominal["k_tether_N_m"]
        else:
            expected = float(runs["spring_N_m"][run] * runs["speed_mm_s"][run])
        level = levels_of(trace)[1]
        slope = None
        if len(force) > 8 and np.mean(force[:3]) < 0.5 * level:
            top = int(np.argmax(force >= 0.8 * level))
            first = max(np.flatnonzero(force[:top] <= 0.2 * level), default=0)
            slope = _slope(x[first : top + 1], force[first : top + 1])
        elif name == "spring_slider" and len(force) > 8:
            slope = _between_slips(x, force)
        ratios.append(None if slope is None else slope / expected)
    found = [ratio for ratio in ratios if ratio is not None]
    return found, len(ratios) - len(found)


def levels_of(trace: pd.DataFrame) -> tuple[float, float]:
    """The force at the start of a stroke, and late in it."""
    force = trace["force_mN"].to_numpy(float)
    return float(np.median(force[:3])), float(np.median(force[len(force) // 2 :]))


def _between_slips(time: np.ndarray, force: np.ndarray) -> float | None:
    """Median slope of the rises between slips, if they are alike."""
    swing = float(np.subtract(*np.quantile(force, [0.95, 0.05])))
    peaks, troughs = (find_peaks(side, prominence=0.5 * swing)[0] for side in (force, -force))
    slopes = []
    for trough in troughs[troughs < max(peaks, default=0)]:
        peak = peaks[peaks > trough][0]
        risen = (force[trough : peak + 1] - force[trough]) / (force[peak] - force[trough])
        rise = slice(trough + np.argmax(risen > 0.2), trough + np.argmax(risen > 0.8))
        slope = _slope(time[rise], force[rise])
        slopes += [] if slope is None else [slope]
    if len(slopes) < FEWEST_RISES:
        return None
    middle = float(np.median(slopes))
    alike = np.median(np.abs(np.array(slopes) - middle)) < ALIKE * middle
    return middle if alike else None


def refuted_by_impact(case: Case, coefficient: float) -> list[str]:
    """Name the unit of a pushed block's force that its first peak refutes, in one line."""
    block = push.features(case.tables, case.nominal, True)
    if block is None or coefficient > SMALL_COEFFICIENT:
        return []
    peaks = (block.rows["quantity"] == push.PEAK).to_numpy()
    impact_mN = 1e3 * block.impact_force(Bench())[peaks]
    if not peaks.any():
        return []
    share = float(np.median(block.rows["y"].to_numpy(float)[peaks] / impact_mN))
    likely = [
        words
        for unit, of_friction, words in FORCE_SLIPS
        if share > 0 and unit < 1 and abs(np.log(share**2 / unit)) < PEAK_WITHIN
        if is_usual(coefficient / of_friction)
    ]
    if not likely:
        return []
    return [
        f"push: a friction coefficient of {coefficient:.2g}, and a first peak of {share:.2g} times "
        f"the impact: {' or '.join(likely)}?"
    ]


def refuted_units(case: Case, name: str, coefficient: float) -> list[str]:
    """Name the units that the loading slope refutes, in one line, if there are any."""
    if name == "push":
        return refuted_by_impact(case, coefficient)
    if name not in SLIPS:
        return []
    ratios, _ = loading_slopes(case, name)
    if not ratios:
        return []
    ratio = float(np.median(ratios))
    error = 3 * float(np.std(ratios)) / np.sqrt(len(ratios)) if len(ratios) > 2 else np.inf
    if 1 / LARGEST_SLOPE_FACTOR <= ratio <= LARGEST_SLOPE_FACTOR:
        return []
    slips = [
        (abs(np.log(abs(ratio) / slope)), words)
        for slope, of_friction, words in SLIPS[name]
        if ratio > 0 and is_usual(coefficient / of_friction)
    ]
    slips = sorted(slip for slip in slips if slip[0] < NAMED_WITHIN)
    # Two units as near as the slopes scatter, both.
    likely = [words for off, words in slips if off < slips[0][0] + min(error / ratio, 0.03)]
    spring = "spring_N_m and speed_mm_s say"
    if name == "drag":
        spring = f"nominal k_tether_N_m {case.nominal['k_tether_N_m']:g} says"
        if is_usual(coefficient):
            likely.append("k_tether_N_m in another unit or ten times off")
    likely = likely or ["one of them in another unit or ten times off"]
    return [
        f"{name}: the force rises {ratio:.3g} times as fast as {spring}: {' or '.join(likely)}?"
    ]


def refuted_clock(case: Case, name: str) -> list[str]:
    """Name a clock that the way and the speed refute, in one line."""
    if name == "spring_slider":  # its loading slope has told
        return []
    runs, ratios = case.tables[f"{name}_runs"].set_index("run_id"), []
    for run, trace in case.tables[name].groupby("run_id", sort=False):
        time, speed = trace["t_s"].to_numpy(float), float(runs["speed_mm_s"][run])
        if name == "push":
            took = np.ptp(time) - runs["quiet_s"].fillna(0.0)[run]
            ratios.append(float(runs["moved_mm"][run]) / (speed * max(took, 1e-9)))
            continue
        step, took = np.abs(np.diff(trace["x_stage_mm"].to_numpy(float))), np.diff(time)
        moving = (took > 0) & (step > 0)
        if moving.any():
            ratios.append(float(np.median(step[moving] / took[moving])) / speed)
    ratio = float(np.nanmedian(ratios)) if np.isfinite(ratios).any() else 1.0
    what, within = ("way", np.log(2.0)) if name == "push" else ("stage", NAMED_WITHIN)
    for slip, words in CLOCK_SLIPS:
        if ratio > 0 and abs(np.log(ratio / slip)) < within:
            return [
                f"{name}: the {what} goes {ratio:.3g} times as fast as speed_mm_s says: {words}?"
            ]
    return []


def _finding(name: str, words: str, size: float, unit: str = "1") -> DataFinding:
    return DataFinding(name, "force cell", words, "cell", float(size), (float(size),) * 2, unit)


def clipped(case: Case, name: str) -> DataFinding | None:
    """Find readings that are many and equal at an end of the range."""
    for column in CELLS[name]:
        values = case.tables[name][column].to_numpy(float)
        if np.median(np.abs(np.diff(values))) == 0:
            continue
        found, counts = np.unique(values, return_counts=True)
        for end, beside in ((-1, -2), (0, 1)):
            enough = len(found) > 20 and counts[end] >= CLIPPED_READINGS
            if enough and counts[end] > CLIPPED_FACTOR * counts[beside]:
                words = f"readings at exactly {found[end]:g} mN: clipped"
                return _finding(name, words, counts[end])
    return None


def tared(case: Case, name: str) -> DataFinding | None:
    """Find a zero that was taken while the spring was loaded."""
    backs = dict(strokes(case.tables[name], 1)) if name == "drag" else {}
    starts, halves = [], []
    for run, trace in strokes(case.tables[name]):
        start, late = levels_of(trace)
        half = late - start
        if run in backs:
            back = levels_of(backs[run])[1]
            half = 0.5 * (late - back)
            if abs(start - 0.5 * (late + back)) > 0.5 * abs(start):
                continue
        starts.append(start)
        halves.append(half)
    if len(starts) < 0.5 * len(case.tables[f"{name}_runs"]) or not starts:
        return None
    zero, half = float(np.median(starts)), float(np.median(halves))
    if half > 0 and zero < -TARED_SHARE * half:
        return _finding(name, "reading of the relaxed spring: tared under load", zero, "mN")
    return None


def only_magnitudes(case: Case) -> DataFinding | None:
    """Find return strokes of a drag that read as positive as the strokes out."""
    outs, backs = (
        {run: levels_of(trace)[1] for run, trace in strokes(case.tables["drag"], stroke)}
        for stroke in (0, 1)
    )
    share = [backs[run] / outs[run] for run in backs if outs.get(run, 0.0) > 0]
    if not share or np.median(share) < MAGNITUDE_SHARE:
        return None
    return _finding("drag", "return strokes read as magnitudes, not used", len(share))


def drifting(case: Case, name: str) -> DataFinding | None:
    """Find a force that drifts within the runs, alike in all."""
    rates, shares = [], []
    for _, trace in strokes(case.tables[name]):
        time = trace["t_s"].to_numpy(float)
        columns = trace[list(CELLS[name])].to_numpy(float).T
        force = np.hypot(*columns) if name == "push" else columns[0]
        late = time > time[0] + 0.4 * (time[-1] - time[0])
        if late.sum() < 20 or np.ptp(time[late]) <= 0:
            continue
        rate = float(np.polyfit(time[late], force[late], 1)[0])
        rates.append(rate)
        size = max(abs(np.median(force[late])), np.ptp(np.quantile(force, [0.05, 0.95])))
        shares.append(rate * np.ptp(time) / max(size, 1e-9))
    if len(rates) < DRIFT_RUNS:
        return None
    error = np.std(rates, ddof=1) / np.sqrt(len(rates))
    if abs(np.mean(rates)) < DRIFT_ERRORS * error or abs(np.median(shares)) < DRIFT_SHARE:
        return None
    return _finding(name, "drift of the force within the runs", float(np.mean(rates)), "mN/s")


def cell_faults(case: Case) -> tuple[Case, tuple[DataFinding, ...], list[str]]:
    """Return a case without what a force cell cannot have read, the findings, and what is fatal."""
    findings: list[DataFinding] = []
    fatal: list[str] = []
    for name in (name for name in case.protocols if name in CELLS):
        for finding in (clipped(case, name), tared(case, name) if name != "push" else None):
            if finding:
                findings.append(finding)
                fatal.append(f"{name}: the force cell: {finding.quantity} ({finding.size:.4g})")
        if name == "drag" and (finding := only_magnitudes(case)):
            findings.append(finding)
            traces = case.tables["drag"]
            out = traces[traces["stroke"] == 0].reset_index(drop=True)
            case = replace(case, tables=case.tables | {"drag": out})
        if name == "spring_slider":
            ratios, hidden = loading_slopes(case, name)
            if not ratios:
                words = "runs, all with too few readings in a stick to tell the slope of loading"
                findings.append(_finding(name, f"{words} (gain, units)", hidden))
        if case.tables[name]["t_s"].notna().all() and (finding := drifting(case, name)):
            findings.append(finding)
    return case, tuple(findings), fatal
