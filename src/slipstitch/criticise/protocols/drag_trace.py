"""Features of one drag trace: offset, stiffness, slips, plateaus and lost motion.

Slips are read where the trace leaves the line of the loading spring, not as a maximum: the maximum
of a noisy, textured trace is biased, the departure is not (its small threshold is modelled).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.protocols.protocol import GAP

DEPARTURE_NOISES = 4.0
TEXTURE_ROUNDS = 4
FEWEST_OF_FALL = 5
# Of the way left after the slip, which the force takes to settle.
SETTLED_SHARE = 0.1
# Places at which the start of a fall is tried.
FALL_PLACES = 201
# Relative error of a slope that is not seen: of the nominal spring, and of the cell's gain.
USUAL_SLOPE_ERROR = 0.1


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

    def change_sd(self, distance_mm: float) -> float:
        """Standard deviation of the relative change from a place to one at a distance."""
        return self.relative_sd * float(np.sqrt(-2.0 * np.expm1(-distance_mm / self.length_mm)))


def pooled_texture(plateaus: list[tuple[np.ndarray, float, float]], step_mm: float) -> Texture:
    """Texture from all runs' plateaus: (readings, uncertainty, level) of each.

    Raw autocovariances are summed, weak runs count little. The white part (instrument noise) is
    left out: the lags from 1 on are fitted by an exponential. About each plateau's own mean they
    are too small by its variance, which the texture tells: it is given back until both agree.
    """
    longest = max((len(readings) for readings, _, _ in plateaus), default=0)
    lags = int(min(max(longest // 3, 2), 80))
    total, weight = np.zeros(lags), np.zeros(lags)
    white = 0.0
    spans: list[tuple[float, float]] = []
    for readings, u, level in plateaus:
        count = len(readings)
        if count < 3 * 4:
            continue
        residual = readings - readings.mean()
        for lag in range(min(lags, count // 2)):
            total[lag] += residual[: count - lag] @ residual[lag:]
            weight[lag] += (count - lag) * level**2
        white += count * (1.5 * u) ** 4
        spans.append((count * step_mm, count * level**2))
    if not spans or weight[0] == 0 or lags < 3:
        return Texture(0.0, 1.0)
    biased = np.divide(total, weight, out=np.zeros(lags), where=weight > 0)
    doubt = 3.0 * np.sqrt(white) / weight[0]
    if biased[1] <= doubt:
        return Texture(0.0, 1.0)
    texture, span, share = Texture(0.0, 1.0), *np.array(spans).T
    for _ in range(TEXTURE_ROUNDS):
        of_means = [texture.mean_sd(1.0, length) ** 2 for length in span]
        covariance = biased + np.average(of_means, weights=share)
        texture = _exponential(covariance, doubt, step_mm, float(span.max()))
    return texture


def _exponential(covariance: np.ndarray, doubt: float, step_mm: float, span_mm: float) -> Texture:
    """The exponential through the lags from 1 on, to where they fall below a quarter."""
    below = np.flatnonzero(covariance[1:] < max(0.25 * covariance[1], doubt))
    last = int(below[0]) + 1 if len(below) else len(covariance)
    used = np.arange(1, max(last, 3))
    used = used[covariance[used] > 0]
    if len(used) >= 2:
        slope, intercept = np.polyfit(used, np.log(covariance[used]), 1)
        slope = min(slope, -step_mm / span_mm)
    else:  # gone within two samples
        slope, intercept = -1.5, np.log(covariance[1]) + 1.5
    variance = min(np.exp(intercept), 2.0 * covariance[0])
    return Texture(float(np.sqrt(variance)), float(-step_mm / slope))


@dataclass(frozen=True)
class Feature:
    """A value with its uncertainty, and the grid that sampling laid under it (0: none)."""

    value: float
    uncertainty: float
    grid_step: float = 0.0
    grid_point: float = 0.0
    ramp_mN: float = 0.0


def sliding(x_mm: np.ndarray, force_mN: np.ndarray, spring_mN_mm: float) -> np.ndarray:
    """(n,) True well after the slip: the ramp of the loading spring is no texture."""
    x = np.abs(x_mm - x_mm[0])
    level = float(np.median(force_mN[len(force_mN) // 2 :]))
    slipped = max(level, 0.0) / spring_mN_mm
    return x > slipped + SETTLED_SHARE * max(x[-1] - slipped, 0.0)


def off_ramps(out: pd.DataFrame, back: pd.DataFrame) -> np.ndarray:
    """Deviations of both strokes' ramps from their lines, (n,), each worth one reading's noise."""
    found = []
    for stroke in (out, back):
        x, force = stroke["x_stage_mm"].to_numpy(), stroke["force_mN"].to_numpy()
        if len(x) < 8:
            continue
        risen = np.abs(force - force[0])
        # Between a late start and the slip, for which the force is taken at its least.
        level = float(np.median(risen[len(risen) // 2 :]))
        low, high = (_first_lasting(risen > share * level) for share in (0.15, 0.6))
        if low is None or high is None or high - low < 4:
            continue
        line = np.polynomial.Polynomial.fit(x[low:high], force[low:high], 1)
        off = force[low:high] - line(x[low:high])
        found.append(off * np.sqrt(len(off) / (len(off) - 2)))
    return np.concatenate([np.zeros(0), *found])


@dataclass(frozen=True)
class _Ramp:
    """Readings that lie on the loading spring's line; with none, where it must have passed.

    The line is ``offset + spring x`` at the readings' mean; ``doubt_mN`` of it remains.
    """

    readings: np.ndarray
    offset_mN: float
    doubt_mN: float = 0.0


def _ramp(x, force, level, threshold, spring_mN_mm) -> _Ramp:
    """The ramp of a run's first stroke.

    A reading that has not risen tells the cell's zero, not where the ramp starts: a stage or a
    cell that is late leaves it flat.
    """

    def on_line(readings: np.ndarray) -> _Ramp:
        return _Ramp(readings, float(np.mean(force[readings] - spring_mN_mm * x[readings])))

    # One reading alone may be far off.
    rest = float(np.median(force[: _first_lasting(force > 0.15 * level) or 1]))
    low = _first_lasting(force > rest + threshold)
    high = _first_lasting(force > rest + 0.6 * (level - rest))
    if low is None or high is None or not low or (force[:low] > 0.6 * level).any():
        readings = np.flatnonzero(x < 0.6 * max(level, 2 * threshold) / spring_mN_mm)
        readings = readings[readings < max(2 * len(readings), 2)]
        if not len(readings):  # the first reading slides already
            passed = spring_mN_mm * x[0]
            return _Ramp(np.array([0]), float(force[0] - 0.5 * passed), passed / np.sqrt(12))
        return on_line(readings)
    if high > low:
        return on_line(np.arange(low, high))
    before = low - 1
    left = max(spring_mN_mm * (x[low] - x[before]) - (force[low] - force[before]), 0.0)
    offset = float(force[before] - spring_mN_mm * x[before])
    # Between two readings, anywhere; but a start that is not late is where it should be.
    if before:
        return _Ramp(np.array([before]), offset - 0.5 * left, left / np.sqrt(12))
    return _Ramp(np.array([before]), offset, left / np.sqrt(3))


def trace_features(
    out: pd.DataFrame,
    back: pd.DataFrame,
    spring_mN_mm: float,
    u: float,
    texture: Texture,
    start_mm: float | None = None,
    turn_mm: float | None = None,
) -> dict[str, Feature]:
    """Features of one run by quantity; ``out`` and ``back`` are strokes 0 and 1 in order of time.

    Parameters
    ----------
    start_mm : where the stage of all runs starts; a run that was first read further off than a
        sample started at its own first reading.
    turn_mm : where it turns, if that is the same in all runs.
    """
    features: dict[str, Feature] = {}
    x, force = out["x_stage_mm"].to_numpy(), out["force_mN"].to_numpy()
    if len(x) < 8:
        return features
    step = float(np.median(np.abs(np.diff(x)))) or 1e-6
    late = start_mm is not None and abs(x[0] - start_mm) < step
    x = np.abs(x - (start_mm if late else x[0]))
    threshold = DEPARTURE_NOISES * u
    level = float(np.median(force[len(force) // 2 :]))
    ramp = _ramp(x, force, level, threshold, spring_mN_mm)
    on = ramp.readings
    excess = force[on] - spring_mN_mm * x[on]
    centre = x[on].mean()
    spread = float(((x[on] - centre) ** 2).sum())
    slope, offset, fitted = spring_mN_mm, float(excess.mean()), False
    slope_error = USUAL_SLOPE_ERROR * spring_mN_mm
    # At the middle of the ramp the offset is independent of the slope.
    features["relaxed_mN"] = Feature(
        ramp.offset_mN,
        float(np.hypot(u / np.sqrt(len(excess)), ramp.doubt_mN)),
        ramp_mN=spring_mN_mm * centre,
    )
    if len(excess) >= 4:
        gain = float(((x[on] - centre) * excess).sum() / spread)
        if gain > -0.8 * spring_mN_mm:
            error = np.hypot(u / np.sqrt(spread) / spring_mN_mm, 1e-3)
            features["stiffness"] = Feature(1 + gain / spring_mN_mm, float(error))
            slope, offset, fitted = spring_mN_mm + gain, offset - gain * centre, True
            slope_error = u / np.sqrt(spread)
    first = _first_lasting(offset + slope * x - force > threshold)
    if first is None or first == 0:
        return features
    if first > 6:  # once more, with all of the line: a long line needs a good slope
        line = np.flatnonzero(np.abs(offset + slope * x - force)[: first - 1] < threshold)
        if len(line) > 4:
            (slope, offset), fitted = np.polyfit(x[line], force[line], 1), True
            slope_error = u / (np.sqrt(len(line)) * x[line].std())
        first = _first_lasting(offset + slope * x - force > threshold)
        if first is None or first == 0:
            return features
    grid = slope * (x[first] - x[first - 1])
    error = np.sqrt(grid**2 / 12 + 0.5 * u**2 + (texture.relative_sd * level) ** 2)
    # The reading before may be past the slip, its departure not yet seen: a line fitted to
    # readings says where it passed; one of the nominal spring may be of another slope.
    passed = offset + slope * x[first] - grid if fitted else force[first - 1]
    if x[first] - x[first - 1] < GAP * step:
        features["force_first_slip_mN"] = Feature(
            float(passed + 0.5 * grid), float(error), float(grid), float(offset + slope * x[first])
        )
    reach = x[-1] - x[first]
    settled = x > x[first] + max(2 * texture.length_mm, 3 * step, SETTLED_SHARE * reach)
    if settled.sum() >= 5:
        features["force_plateau_mN"] = _plateau(x[settled], force[settled], u, texture)
    if len(back) >= 8 and "force_plateau_mN" in features:
        features |= _reversal(out, back, (slope, slope_error), u, texture, level, turn_mm)
    return features


def _plateau(x, force, u, texture) -> Feature:
    level = float(force.mean())
    error = np.hypot(u / np.sqrt(len(force)), texture.mean_sd(level, float(np.ptp(x))))
    return Feature(level, float(error))


def _first_lasting(flags: np.ndarray) -> int | None:
    lasting = flags[:-1] & flags[1:]
    return int(np.argmax(lasting)) if lasting.any() else None


def _start_of_fall(travel, force, start, late, slope, u) -> tuple[float, float]:
    """Where the force begins to fall from ``start`` to ``late``, and its standard deviation.

    Of the two readings on either side of the middle, by their likelihood: one that is not on the
    fall says only that it has not begun, or has ended.
    """
    half = 0.5 * (start - late)
    fall = 2 * half / slope
    places = np.linspace(travel[0] - 0.5 * fall, travel[1] - 0.5 * fall, FALL_PLACES)
    expected = start - np.clip(slope * (travel - places[:, None]), 0.0, 2 * half)
    badness = 0.5 * (((force - expected) / u) ** 2).sum(axis=1)
    weights = np.exp(badness.min() - badness)
    mean = np.average(places, weights=weights)
    return float(mean), float(np.sqrt(np.average((places - mean) ** 2, weights=weights)))


def _reversal(out, back, spring, u, texture, level, turn_mm) -> dict[str, Feature]:
    features: dict[str, Feature] = {}
    slope, slope_error = spring
    last, first = float(out["x_stage_mm"].iloc[-1]), float(back["x_stage_mm"].iloc[0])
    turn = max(float(out["x_stage_mm"].max()), float(back["x_stage_mm"].max()))
    step = float(np.median(np.abs(np.diff(back["x_stage_mm"])))) or 1e-6
    seen = abs(last - first) < GAP * step
    if turn_mm is not None:
        turn, seen = turn_mm, turn_mm - turn < GAP * step
    travel = turn - back["x_stage_mm"].to_numpy()
    force = back["force_mN"].to_numpy()
    tail = out["force_mN"].to_numpy()[-2:]
    start = float(tail.mean())
    # The fall begins at the turn itself, up to which the texture changes.
    left = max(turn - float(out["x_stage_mm"].iloc[-2:].mean()) - 0.25 * step, 0.0)
    start_error = np.hypot(u / np.sqrt(2.0), level * texture.change_sd(left))
    late = float(np.median(force[len(force) // 2 :]))
    middle, half = 0.5 * (start + late), 0.5 * (start - late)
    crossing = _first_lasting(force < middle)
    if crossing is None or half <= 0:
        return features
    reach = travel[-1] - travel[crossing]
    settled = travel > travel[crossing] + 2 * half / slope + max(
        2 * texture.length_mm, 3 * step, SETTLED_SHARE * reach
    )
    if settled.sum() >= 5:
        features["force_back_plateau_mN"] = _plateau(travel[settled], force[settled], u, texture)
    samples = 2 * half / (slope * step)
    falling = np.abs(force - middle) < 0.75 * half
    falling &= np.abs(np.arange(len(force)) - crossing) <= samples
    few = samples < FEWEST_OF_FALL or falling.sum() < 3
    if few:
        if crossing and seen:
            two = slice(crossing - 1, crossing + 1)
            lost, error = _start_of_fall(travel[two], force[two], start, late, slope, u)
            error = np.hypot(error, start_error / slope)
            error = np.hypot(error, half * slope_error / slope**2)
            features["lost_motion_mm"] = Feature(lost, float(np.hypot(error, 0.003)))
        return features
    along, drop = travel[falling], force[falling]
    centre, spread = along.mean(), float(((along - along.mean()) ** 2).sum())
    if len(along) >= 5:  # the fall's own slope: over its length a small error of it adds up
        slope, slope_error = -float(((along - centre) * drop).sum() / spread), u / np.sqrt(spread)
    lost = float(centre + (drop.mean() - start) / slope)
    of_slope = (centre - lost) * slope_error
    error = np.sqrt(u**2 / len(along) + of_slope**2 + start_error**2) / slope
    if seen:
        features["lost_motion_mm"] = Feature(lost, float(np.hypot(error, 0.003)))
    line = start - slope * (travel - lost)
    away = (force - line > DEPARTURE_NOISES * u) & (np.arange(len(force)) > crossing)
    first = _first_lasting(away)
    if first is not None and first > 0:
        grid = slope * (travel[first] - travel[first - 1])
        error = np.sqrt(grid**2 / 12 + 0.5 * u**2 + (texture.relative_sd * late) ** 2)
        features["force_reversal_slip_mN"] = Feature(
            float(line[first] + 0.5 * grid), float(error), float(grid), float(line[first])
        )
    return features
