"""Traces as instruments write them: clocks that step back or stand still, glitches, and noise.

Nothing is sorted, averaged or set aside in silence: whatever is done is a finding about the data.
How noisy a sensor is, its traces tell: features are read by thresholds and errors that follow its
uncertainty, and where the noise is far more than stated, slips are seen where none are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.stats import chi2 as chi_square

from slipstitch.base.errors import BadInput
from slipstitch.criticise.causes import DataFinding

# A reading this many noises off what its neighbours on either side lead to is a glitch; of normal
# noise one in ten million is. So are two or three in a row, not more, if they are twice as far
# off: friction itself may change that fast.
GLITCH_NOISES, LONGEST_GLITCH, ROUNDS = 6.0, 3, 3
# At the ends of a recording, and up to so many in a row, only what lies beyond all that the run
# reads otherwise by half as much again is a glitch: there, friction may jump.
LONGEST_BURST, ORDINARY, MARGIN = 30, (0.05, 0.95), 0.5
# Readings over which noise is taken to be the same.
NOISE_READINGS = 128
# More events than this share of the readings, and more than a few a run, are a noise with heavy
# tails, which protocols read as it is.
GLITCHES_AT_MOST, GLITCHES_A_RUN = 0.004, 2.0
# Steps back by less are rows that changed places; more than this share of them, another order.
SWAPPED_STEPS, ANOTHER_ORDER = 2.5, 0.1
# Equal times in at most this share of the readings are averaged; more are a coarse clock.
FEW_EQUAL = 0.05
# The share of |z| of a normal variable below a deviation.
MOST, MOST_DEVIATION = 0.8, 1.2816
# Uncertainties are usually stated this much too small; only more is allowed for before reading.
USUAL_UNDERSTATEMENT = 1.25
FEWEST_READINGS = 30
# Median of |z| of a normal variable; beyond as many deviations a trace bends.
MEDIAN_DEVIATION = 0.6745
BENDS = 4.0


@dataclass(frozen=True)
class Signal:
    """A column that a sensor reads, and the column of the runs with its stated uncertainty."""

    column: str
    sensor: str
    uncertainty: str


def ordinary_range(values: np.ndarray) -> tuple[float, float]:
    """Return what a run's readings reach, zero included, and half of that further on each side."""
    low, high = np.quantile(values, ORDINARY) if len(values) else (0.0, 0.0)
    low, high = min(low, 0.0), max(high, 0.0)
    return low - MARGIN * (high - low), high + MARGIN * (high - low)


def glitches(
    values: np.ndarray, noise: float, ordinary: tuple[float, float] = (-np.inf, np.inf)
) -> np.ndarray:
    """Return which readings (n,) are glitches.

    A glitch lies beyond both neighbours on either side and beyond the lines through them: a drop,
    a corner or a peak between two slopes is none. Beyond the ``ordinary`` range more than three
    readings in a row, or the first or last ones, may be glitches. ``noise`` is as stated; where the
    readings themselves tell more, that counts.
    """
    found = np.zeros(len(values), bool)
    if len(values) < 8:
        return found
    scale = np.maximum(_local_noise(values), noise)
    for _ in range(ROUNDS):  # what a glitch hid
        left = np.flatnonzero(~found)
        threshold = GLITCH_NOISES * scale[left]
        more = _beyond_neighbours(values[left], threshold)
        more |= _bursts(values[left], threshold, ordinary)
        if not more.any():
            break
        found[left[more]] = True
    return found


def _local_noise(values: np.ndarray) -> np.ndarray:
    """Noise by the bends between neighbours (n,), the largest of the stretches around."""
    bends = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    stretches = np.array_split(bends, max(len(bends) // NOISE_READINGS, 1))
    # A quantile that the larger of two noises in a stretch decides, but not a few glitches.
    noise = [np.quantile(stretch, MOST) for stretch in stretches]
    noise = maximum_filter1d(np.array(noise) / MOST_DEVIATION / np.sqrt(1.5), 3)
    return np.pad(np.repeat(noise, [len(stretch) for stretch in stretches]), 1, mode="edge")


def _beyond_neighbours(values: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    found = np.zeros(len(values), bool)
    padded = np.pad(values, 2, mode="reflect")
    for width in range(1, LONGEST_GLITCH + 1):
        count = len(values) - width + 1
        if count < 1:
            break
        l2, l1 = padded[:count], padded[1 : count + 1]
        r1, r2 = padded[width + 2 : count + width + 2], padded[width + 3 : count + width + 3]
        around = np.stack([l1, 2 * l1 - l2, r1, 2 * r1 - r2])
        origin = -(width // 2)  # windows begin at the reading itself
        lowest = minimum_filter1d(values, width, origin=origin)[:count]
        highest = maximum_filter1d(values, width, origin=origin)[:count]
        beyond = np.maximum(lowest - around.max(axis=0), around.min(axis=0) - highest)
        least = threshold[:count] * (1.0 if width == 1 else 2.0)
        least[[0, -1]] = np.inf  # a stroke may begin with its slip
        for start in np.flatnonzero((beyond > least) & (beyond > 2 * np.abs(r1 - l1))):
            found[start : start + width] = True
    return found


def _bursts(values: np.ndarray, threshold: np.ndarray, ordinary: tuple[float, float]) -> np.ndarray:
    """Readings in a row beyond the ordinary that begin and end with a jump, or with the file."""
    found = np.zeros(len(values), bool)
    beyond = (values < ordinary[0]) | (values > ordinary[1])
    for start, end in np.flatnonzero(np.diff(np.pad(beyond, 1).astype(int))).reshape(-1, 2):
        before, after = values[max(start - 2, 0) : start][::-1], values[end : end + 2]
        around = [level for side in (before, after) if len(side) == 2
                  for level in (side[0], 2 * side[0] - side[1])]  # fmt: skip
        if end - start > LONGEST_BURST or not around:
            continue
        least = 2 * threshold[start:end].max()
        if len(before) and len(after):
            least = max(least, 2 * abs(before[0] - after[0]))
        own = values[start:end]
        found[start:end] = np.all((own > max(around) + least) | (own < min(around) - least))
    return found


def _ordered(part: pd.DataFrame, key: np.ndarray, where: str, counts: Counter) -> pd.DataFrame:
    """A part of a run in the order it was recorded in; ``recording`` numbers restarts."""
    steps = np.diff(key)
    back = np.flatnonzero(steps < 0)
    part = part.assign(recording=0)
    if not len(back):
        return part
    usual = float(steps[steps > 0].sum() / len(steps))
    swapped = (key[back] - key[back + 1] <= SWAPPED_STEPS * usual).all()
    if swapped or len(back) > ANOTHER_ORDER * len(key):
        counts["sorted"] += 1
        return part.iloc[np.argsort(key, kind="stable")]
    if "x_stage_mm" in part:
        _refuse_two_strokes(part, where)
    counts["restarts"] += 1
    recording = np.concatenate([[0], np.cumsum(steps < 0)])
    time = key.copy()
    for start in back + 1:
        time[start:] += time[start - 1] + usual - time[start]
    return part.assign(recording=recording, t_s=time)


def _refuse_two_strokes(part: pd.DataFrame, where: str) -> None:
    way = part["x_stage_mm"].to_numpy(float)
    way = way * (1.0 if way[-1] >= way[0] else -1.0)
    if (np.maximum.accumulate(way) - way).max() > SWAPPED_STEPS * np.median(np.abs(np.diff(way))):
        raise BadInput(f"{where}: clock and stage both start again: give each part a run_id")


def _spread_equal(part: pd.DataFrame, where: str, counts: Counter) -> pd.DataFrame:
    """A part whose readings share no time: averaged, or a rounded clock made even again."""
    time = part["t_s"].to_numpy(float)
    equal = np.diff(time) == 0
    if not equal.any():
        return part
    if equal.mean() <= FEW_EQUAL:
        counts["averaged"] += int(equal.sum())
        numbers = part.select_dtypes("number").columns
        group = np.concatenate([[0], np.cumsum(~equal)])
        firsts = part.iloc[np.flatnonzero(np.concatenate([[True], ~equal]))].copy()
        firsts[numbers] = part[numbers].groupby(group).mean().to_numpy()
        return firsts
    parts = []
    for _, one in part.groupby("recording", sort=False):
        own, place = one["t_s"].to_numpy(float), np.arange(len(one))
        tick = np.diff(np.unique(own))
        rate, start = np.polyfit(place, own, 1) if len(tick) else (0.0, 0.0)
        off = own - (start + rate * place)
        if not rate > 0 or np.abs(off).max() > 1.01 * tick.min():
            raise BadInput(
                f"{where}: {int(equal.sum()) + 1} readings share their time with another; a finer "
                "clock or evenly spaced readings are needed"
            )
        parts.append(one.assign(t_s=start + rate * place))
    counts["coarse"] += 1
    return pd.concat(parts)


def _parts(traces: pd.DataFrame) -> Iterator[tuple[tuple, pd.DataFrame]]:
    """Every run, and stroke or phase of it, in the order of the file."""
    names = ["run_id", *(name for name in ("stroke", "phase") if name in traces)]
    return iter(traces.groupby(names, sort=False))


def prepared(
    name: str, runs: pd.DataFrame, traces: pd.DataFrame, signals: tuple[Signal, ...], where: str
) -> tuple[pd.DataFrame, tuple[DataFinding, ...]]:
    """Return traces in order, without glitches, and what was found on the way.

    ``signals`` are looked at for glitches; ``where`` is the file or folder of the traces. Raises
    BadInput if a clock can be understood in two ways.
    """
    counts: Counter = Counter()
    parts = []
    for (run, *_), part in _parts(traces):
        part = part.assign(recording=0)
        at = f"{where}: run '{run}'"
        if "t_s" in part and part["t_s"].notna().all():
            part = _ordered(part, part["t_s"].to_numpy(float), f"{at}: t_s", counts)
            part = _spread_equal(part, f"{at}: t_s", counts)
        elif "stroke" in part:
            way = part["x_stage_mm"] * (1 - 2 * part["stroke"])
            part = _ordered(part, way.to_numpy(float), f"{at}: x_stage_mm", counts)
        parts.append(part)
    findings = list(_of_clock(name, counts))
    for signal in signals:
        stated = runs.set_index("run_id")[signal.uncertainty]
        columns = traces.groupby("run_id")[signal.column]
        ranges = {run: ordinary_range(own.to_numpy(float)) for run, own in columns}
        bad = []
        for part in parts:
            run = part["run_id"].iloc[0]
            bad.append(_bad(part, signal.column, stated[run], ranges[run]))
        count, events = (sum(f(b) for b in bad) for f in (np.sum, _events))
        of = sum(map(len, bad))
        if not count or events > max(GLITCHES_AT_MOST * of, GLITCHES_A_RUN * len(runs)):
            continue
        parts = [_mended(part, signal.column, b) for part, b in zip(parts, bad, strict=True)]
        words = f"of {of} readings set aside as glitches"
        size = int(count)
        findings.append(
            DataFinding(name, signal.sensor, words, "glitches", size, (size, size), "1")
        )
    return pd.concat(parts, ignore_index=True), tuple(findings)


def _bad(
    part: pd.DataFrame, column: str, noise: float, ordinary: tuple[float, float]
) -> np.ndarray:
    """The glitches of a part, (n,)."""
    starts = np.flatnonzero(np.diff(part["recording"].to_numpy())) + 1
    recordings = np.split(part[column].to_numpy(float), starts)
    return np.concatenate([glitches(recording, noise, ordinary) for recording in recordings])


def _events(bad: np.ndarray) -> int:
    return int(np.sum(np.diff(bad.astype(int)) > 0) + bad[:1].sum())


def _mended(part: pd.DataFrame, column: str, bad: np.ndarray) -> pd.DataFrame:
    """A part whose glitches are what their neighbours lead to."""
    if not bad.any():
        return part
    values, place = part[column].to_numpy(float), np.arange(len(part))
    return part.assign(**{column: np.interp(place, place[~bad], values[~bad])})


_CLOCK_WORDS = {
    "restarts": "runs whose clock starts again, read in parts",
    "sorted": "parts of runs not in order of time, sorted",
    "averaged": "readings at the same time as another, averaged",
    "coarse": "parts of runs with a clock coarser than their readings, spaced evenly",
}


def _of_clock(name: str, counts: Counter) -> Iterator[DataFinding]:
    for kind, words in _CLOCK_WORDS.items():
        if count := counts[kind]:
            yield DataFinding(name, "clock", words, "clock", count, (count, count), "1")


@dataclass(frozen=True)
class TraceNoise:
    """Noise of a sensor over what is stated, with its 95 % interval, and its quantity's name."""

    sensor: str
    quantity: str
    factor: float
    ci95: tuple[float, float]

    @property
    def allowance(self) -> float:
        """By what stated uncertainties are multiplied before features are read."""
        return max(self.factor / USUAL_UNDERSTATEMENT, 1.0)


def off_neighbours(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Deviations of readings (n,) from the cubic through two neighbours on each side, (n - 4,).

    They are in units of one reading's noise; places need not be evenly spaced.
    """
    if len(x) < 5:
        return np.zeros(0)
    places = np.stack([x[:-4], x[1:-3], x[3:-1], x[4:]])
    values = np.stack([y[:-4], y[1:-3], y[3:-1], y[4:]])
    middle = x[2:-2]
    weights = np.ones_like(places)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[i] *= (middle - places[j]) / (places[i] - places[j])
        result = (y[2:-2] - (weights * values).sum(axis=0)) / np.sqrt(1 + (weights**2).sum(axis=0))
    return result[np.isfinite(result)]


def noise_of(
    sensor: str, quantity: str, deviations: Iterable[np.ndarray], robust: bool = True
) -> TraceNoise:
    """Noise from deviations in units of what is stated.

    ``robust``: by their median, so that the places where a trace bends do not count.
    """
    z = np.concatenate([np.zeros(0), *deviations])
    if len(z) < FEWEST_READINGS:
        return TraceNoise(sensor, quantity, 1.0, (0.0, np.inf))
    if robust:
        factor = np.median(np.abs(z)) / MEDIAN_DEVIATION
        z = z[np.abs(z) <= BENDS * factor]
        factor = np.median(np.abs(z)) / MEDIAN_DEVIATION
    else:
        factor = np.sqrt(np.mean(z**2))
    # A median tells as much as a mean square of a third of the readings; neighbours share them.
    degrees = len(z) / (7.0 if robust else 1.0)
    low, high = factor * np.sqrt(degrees / chi_square.ppf([0.975, 0.025], degrees))
    return TraceNoise(sensor, quantity, float(factor), (float(low), float(high)))
