"""(e) A slider pulled by a spring: level, half drop of the slips and of the first one.

Level and half drop are the middle and half the range of the force's swing from stick to slip.
What extraction does to the half drop (noise raises peaks, smoothing lowers them) is found by
putting steady stick-slip of the same size, sampling and noise through the same extraction.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
import pandas as pd
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import find_peaks

from slipstitch.criticise.protocols import protocol
from slipstitch.criticise.protocols.stick_slip import Slider, steady_cycle, steady_force
from slipstitch.criticise.traces import Signal, TraceNoise, noise_of, off_neighbours
from slipstitch.physics import GRAVITY_M_S2

LEVEL, SWING, FIRST_SWING = "slider_level_mN", "slider_swing_mN", "slider_first_swing_mN"
DESIGN_QUANTITIES = (LEVEL, SWING)
DROP_NOISES = 6.0
# A slider that sticks loads its spring at k V; one that follows an uneven track, far slower.
STICKING_FRACTION = 0.5
# Of the line of the loading spring: below it, the slider has moved before its first drop.
UNMOVED_FRACTION = 0.95
SPIKE_SAMPLES = 5
SMOOTHINGS_A_PERIOD = 8
MOST_BLOCKS = 10
SYNTHETIC_TRACES = 4
USUAL_EXCESS = 0.1
# No track is known to be more even than this.
EVENEST = 0.003
# Fewer slips of a run do not tell their scatter, but have that of single ones.
FEWEST_SLIPS = 3
# Scatter of a single slip and of a block's mean where too few slips tell.
USUAL_SINGLE, USUAL_BLOCK = 0.1, 0.03
# Of the swing that inertia makes, what more than linear damping takes; and of it, the excess up to
# which damping may let the swing die out.
INERTIAL_ERROR, DAMPED_EXCESS = 0.1, 0.5


@dataclass
class SpringSliderBlock(protocol.LoadedBlock):
    """Spring-slider features."""

    READS = (
        "mass_error",
        "tilt_along_rad",
        "tilt_across_rad",
        "force_offset_N",
        "force_gain",
        "force_drift_N_h",
        "track_drop",
        "damping",
    )

    spring_N_m: np.ndarray
    speed_m_s: np.ndarray
    track_drop_mN: np.ndarray
    unseen_mN: np.ndarray

    def predict(self, law, bench):
        quantity = self.rows["quantity"].to_numpy()
        load, rest, motion = self.pressed(bench)
        tilt = protocol.downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float))
        slider = Slider(self.mass_kg(bench), self.spring_N_m, self.speed_m_s)
        cycle = steady_cycle(slider, law, rest, motion)
        level = cycle.level_N - load * np.sin(tilt)
        gain = 1e3 * (1 + bench.force_gain)
        # Viscous damping pulls at the mean speed, and at every swing until the trough.
        inertial = slider.inertial_force
        level = level + 2 * bench.damping * inertial
        swing = np.where(quantity == SWING, cycle.swing_N, cycle.first_swing_N)
        excess = np.sqrt(np.maximum(swing**2 - inertial**2, 0.0))
        result = gain * swing * (1 - bench.damping * (np.pi - np.arctan2(excess, inertial)))
        # Without an excess it lets the swing die out below what would be seen.
        quiet = np.hypot(gain * excess, np.minimum(gain * inertial, self.unseen_mN))
        result = np.where(self.unseen_mN > 0, quiet, result)
        result = result + bench.track_drop * self.track_drop_mN
        offset = 1e3 * (bench.force_offset_N + bench.force_drift_N_h * self.hours())
        return np.where(quantity == LEVEL, gain * level + offset, result)


@dataclass(frozen=True)
class Slips:
    """Slips of a trace in order: middle and half of each drop (mN), time of its peak (s)."""

    time_s: np.ndarray
    middle_mN: np.ndarray
    half_mN: np.ndarray


def slips_of(time_s: np.ndarray, force_mN: np.ndarray, slider: Slider, u_mN: float) -> Slips:
    """Drops after the slider stuck, within a natural period; the rest follows an uneven track."""
    step = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    width = int(slider.period_s / SMOOTHINGS_A_PERIOD / step)
    if width > SPIKE_SAMPLES:
        force_mN = median_filter(force_mN, SPIKE_SAMPLES)
    if width > 1:
        force_mN = uniform_filter1d(force_mN, width)
    peaks, _ = find_peaks(force_mN, prominence=DROP_NOISES * u_mN)
    troughs, _ = find_peaks(-force_mN, prominence=DROP_NOISES * u_mN)
    loading = 1e3 * slider.spring_N_m * slider.speed_m_s
    longest = max(int(np.ceil(slider.period_s / step)), 3)
    found = []
    for peak in peaks:
        after = troughs[troughs > peak]
        before = troughs[troughs < peak]
        start = before[-1] if len(before) else 0
        rise = (force_mN[peak] - force_mN[start]) / max(time_s[peak] - time_s[start], 1e-12)
        if len(after) and rise > STICKING_FRACTION * loading:
            high, low = force_mN[peak], force_mN[peak : min(after[0], peak + longest) + 1].min()
            if high - low < DROP_NOISES * u_mN:
                continue
            found.append((time_s[peak], 0.5 * (high + low), 0.5 * (high - low)))
    return Slips(*np.array(found).reshape(-1, 3).T)


def slips_of_trace(trace: pd.DataFrame, slider: Slider, u_mN: float) -> Slips:
    """Find the slips of a run, part by part: nothing is known of what is between recordings.

    Nor of what a gap hides that is longer than what is smoothed over.
    """
    steps = np.diff(trace["t_s"].to_numpy(float), prepend=trace["t_s"].iloc[0])
    hides = max(protocol.GAP * np.median(steps), slider.period_s / SMOOTHINGS_A_PERIOD)
    recording = trace["recording"].to_numpy() if "recording" in trace else np.zeros(len(trace))
    new = (np.diff(recording, prepend=recording[0]) != 0) | (steps > hides)
    parts = trace.groupby(np.cumsum(new), sort=False)
    found = [
        astuple(
            slips_of(part["t_s"].to_numpy(float), part["force_mN"].to_numpy(float), slider, u_mN)
        )
        for _, part in parts
        if len(part) > 2
    ]
    return Slips(*map(np.concatenate, zip(*found, strict=True)))


def of_extraction(
    time_s: np.ndarray, slider: Slider, level_mN: float, half_mN: float, u_mN: float
) -> tuple[float, float]:
    """What extraction adds to the half drop, and by how much it scatters the slips' middles, mN.

    From synthetic traces of steady stick-slip on an even track.
    """
    random = np.random.default_rng(1)
    clean = 1e3 * steady_force(slider, 1e-3 * level_mN, 1e-3 * half_mN, time_s - time_s[0])
    found = []
    for _ in range(SYNTHETIC_TRACES):
        noisy = clean + u_mN * random.standard_normal(len(clean))
        trace = pd.DataFrame({"t_s": time_s, "force_mN": noisy})
        slips = slips_of_trace(trace, slider, u_mN)
        found.append((slips.half_mN[1:], slips.middle_mN[1:]))
    halves, middles = map(np.concatenate, zip(*found, strict=True))
    return (float(halves.mean() - half_mN), float(middles.std())) if len(halves) else (0.0, 0.0)


@dataclass(frozen=True)
class _Reading:
    """A run's slips after the first, its steady force, and the first slip if it began relaxed.

    ``quiet``: it slid on with few slips or none. ``middles_mN`` are those of its slips, or means of
    its force where it is quiet. ``bias_mN`` is what extraction adds to half drops, ``noise_mN`` how
    much it scatters the middles.
    """

    slips: Slips
    steady_mN: np.ndarray
    quiet: bool
    middles_mN: np.ndarray
    first_half_mN: float | None
    first_unseen: bool
    bias_mN: float
    noise_mN: float


def _unmoved(time: np.ndarray, force: np.ndarray, peak_s: float, slider: Slider) -> bool:
    """Did the spring load along one line until the slip, at most a quarter period before a peak?"""
    before = time <= peak_s
    start = peak_s - 0.5 * np.pi * np.sqrt(slider.mass_kg / slider.spring_N_m)
    line = before & (force < 0.5 * force[before][-1])
    if line.sum() < 4:
        return True
    slope, zero = np.polyfit(time[line], force[line], 1)
    return bool(force[before][-1] > UNMOVED_FRACTION * (zero + slope * start))


def _read(trace: pd.DataFrame, slider: Slider, u_mN: float) -> _Reading | None:
    time, force = trace["t_s"].to_numpy(float), trace["force_mN"].to_numpy(float)
    if len(time) < 20 or time[-1] <= time[0]:
        return None
    slips = slips_of_trace(trace, slider, u_mN)
    late = float(np.median(force[len(force) // 2 :]))
    relaxed = bool(np.mean(force[:3]) < 0.5 * late)
    loading = 1e3 * slider.spring_N_m * slider.speed_m_s
    settled = time > time[0] + (2 * late / loading if relaxed else 0.0)
    first = None
    if relaxed and len(slips.time_s) and _unmoved(time, force, slips.time_s[0], slider):
        first = float(slips.half_mN[0])
    keep = settled[np.minimum(np.searchsorted(time, slips.time_s), len(time) - 1)]
    # A stick whose end the record does not reach tells neither of drops nor of the track.
    sticks = len(slips.time_s) and (time[-1] - slips.time_s[-1]) * loading < 4 * slips.half_mN[-1]
    if keep.sum() < FEWEST_SLIPS and sticks and relaxed:
        keep = np.arange(len(slips.time_s)) > 0
    kept = Slips(slips.time_s[keep], slips.middle_mN[keep], slips.half_mN[keep])
    if settled.sum() < 10:
        return None
    quiet = len(kept.time_s) < FEWEST_SLIPS and not sticks
    middles = kept.middle_mN if len(kept.time_s) else slips.middle_mN
    if quiet:
        middles = _block_means(force[settled])
    bias, noise = 0.0, u_mN / np.sqrt(settled.sum() / MOST_BLOCKS)
    if len(kept.half_mN) >= FEWEST_SLIPS:
        half = float(kept.half_mN.mean())
        short = time <= time[0] + 30 * (np.diff(kept.time_s).mean())
        bias, noise = of_extraction(time[short], slider, late, half, u_mN)
    unseen = relaxed and not len(slips.time_s)
    return _Reading(kept, force[settled], bool(quiet), middles, first, unseen, bias, float(noise))


def _block_means(values: np.ndarray) -> np.ndarray:
    blocks = min(MOST_BLOCKS, len(values) // 2)
    return np.array([part.mean() for part in np.array_split(values, max(blocks, 1))])


def _pooled(series: list[np.ndarray], otherwise: float, noises: list[float] | None = None) -> float:
    """Relative sd within a run, pooled over runs, beyond what noise of a known sd makes."""
    total = degrees = 0.0
    for values, noise in zip(series, noises or [0.0] * len(series), strict=True):
        if len(values) >= 2:
            mean, own = values.mean(), len(values) - 1
            total += float(np.sum((values / mean - 1) ** 2)) - own * (noise / mean) ** 2
            degrees += own
    return float(np.sqrt(max(total, 0.0) / degrees)) if degrees >= 3 else otherwise


def _features(
    readings: list[_Reading | None], u_mN: np.ndarray, inertial_mN: np.ndarray
) -> tuple[list[tuple], np.ndarray]:
    """(run, quantity, value, uncertainty) of every run; uncertainties are pooled over runs.

    Drops that were not seen have as a fifth what they are taken for. And by run the half drops
    (mN) that a track as uneven as the force makes.

    The less a slider sticks between its slips, the more damping changes its swing.
    """
    good = [r for r in readings if r is not None]
    slipping = [r for r in good if len(r.slips.half_mN) >= FEWEST_SLIPS]
    levels = {id(r): _block_means(r.middles_mN) for r in slipping + [r for r in good if r.quiet]}
    halves = {id(r): _block_means(r.slips.half_mN) for r in slipping}
    level_sd = _pooled(list(levels.values()), USUAL_BLOCK)
    half_sd = _pooled(list(halves.values()), USUAL_BLOCK)
    # A slider that slides on shows the track in its force, one that slips in the slips' middles.
    middles = [r.middles_mN for r in good]
    uneven = max(_pooled(middles, USUAL_BLOCK, [r.noise_mN for r in good]), EVENEST)
    middle_sd = _pooled(middles, USUAL_BLOCK)
    single_sd = _pooled([r.slips.half_mN for r in slipping], USUAL_SINGLE)
    lines, of_tracks = [], np.zeros(len(readings))
    for i, reading in enumerate(readings):
        if reading is None:
            continue
        u = u_mN[i]
        blocks, sd = reading.middles_mN, middle_sd
        if id(reading) in levels:
            blocks, sd = levels[id(reading)], level_sd
        level = float(blocks.mean())
        # A track as uneven as the slips' middles makes drops of its own, at no excess at rest.
        of_track = of_tracks[i] = uneven * level
        inertial = INERTIAL_ERROR * inertial_mN[i]
        doubt = np.hypot(inertial, of_track)
        # The blocks' scatter has the noise of the readings in it.
        error = np.hypot(level * sd / np.sqrt(len(blocks)), u / np.sqrt(len(reading.steady_mN)))
        lines.append((i, LEVEL, level, float(error)))
        # Unseen drops lie below twice the threshold's half: between 0 and 3 noises.
        unseen = (0.25 * DROP_NOISES * u, float(np.hypot(0.25 * DROP_NOISES * u, doubt)))

        def seen(quantity, half, error, i=i, inertial=inertial, of_track=of_track):
            """A drop whose error is also that of its inertia and of the track."""
            error = np.hypot(error, inertial * min(inertial_mN[i] / max(half, 1e-9), 1.0))
            lines.append((i, quantity, half, float(np.hypot(error, of_track))))

        if id(reading) in halves:
            of_mean = 1.0 / np.sqrt(len(halves[id(reading)]))
            half = float(reading.slips.half_mN.mean() - reading.bias_mN)
            of_noise = 0.3 * abs(reading.bias_mN) + 0.2 * u * of_mean
            seen(SWING, half, np.hypot(half * half_sd * of_mean, of_noise))
        elif len(reading.slips.half_mN) and not reading.quiet:
            half, number = float(reading.slips.half_mN.mean()), len(reading.slips.half_mN)
            seen(SWING, half, np.hypot(single_sd * half, u / np.sqrt(2)) / np.sqrt(number))
        elif reading.quiet and not len(reading.slips.half_mN):
            quiet = float(np.hypot(unseen[1], DAMPED_EXCESS * inertial_mN[i]))
            lines.append((i, SWING, unseen[0], quiet, unseen[0]))
        if reading.first_half_mN is not None:
            first = float(reading.first_half_mN - reading.bias_mN)
            # The noise is that of half a difference.
            seen(FIRST_SWING, first, np.hypot(single_sd * first, u / np.sqrt(2)))
        elif reading.first_unseen:
            lines.append((i, FIRST_SWING, *unseen, unseen[0]))
    return lines, of_tracks


def features(tables, nominal, measured) -> SpringSliderBlock | None:
    """Features of every run; without traces, the quantities of the design."""
    runs = tables["spring_slider_runs"]
    traces = tables.get("spring_slider") if measured else None
    mass = sum(protocol.masses_of(runs, nominal))
    spring = runs["spring_N_m"].to_numpy(float)
    speed = runs["speed_mm_s"].to_numpy(float) * 1e-3
    u = runs["u_force_mN"].to_numpy(float)
    noises: tuple[TraceNoise, ...] = ()
    of_tracks = np.zeros(len(runs))
    if traces is None:
        lines = [(i, q, np.nan, u[i]) for i in range(len(runs)) for q in DESIGN_QUANTITIES]
    else:
        parts = dict(list(traces.groupby("run_id", sort=False)))
        own = [parts[run] for run in runs["run_id"]]
        of_traces = (
            off_neighbours(*trace[["t_s", "force_mN"]].to_numpy(float).T) / u[i]
            for i, trace in enumerate(own)
        )
        noises = (noise_of("force cell", "force_mN", of_traces),)
        u = u * noises[0].allowance
        sliders = map(Slider, mass, spring, speed)
        readings = list(map(_read, own, sliders, u))
        # What is stated may be less than the noise that the traces have.
        louder = noises[0].factor / noises[0].allowance
        readings = [r and replace(r, noise_mN=louder * r.noise_mN) for r in readings]
        lines, of_tracks = _features(readings, u, 1e3 * speed * np.sqrt(spring * mass))
    if not lines:
        return None
    index, rows = protocol.feature_rows(protocol.covariates_of(runs, "stage_azimuth_deg"), lines)
    static = (rows["quantity"] != LEVEL).to_numpy()
    under_load = protocol.loaded(runs, nominal, index, rows, static)
    # The stick that a usual excess would make: the measured one grows with the drop itself.
    stick = (2 * USUAL_EXCESS * mass * GRAVITY_M_S2 / (spring * speed))[index]
    rows["dwell_s"] = np.where(rows["quantity"] == SWING, stick, rows["dwell_s"])
    block = SpringSliderBlock(
        "spring_slider",
        rows,
        *under_load,
        spring[index],
        speed[index],
        np.where(static, of_tracks[index], 0.0),
        np.array([line[4] if len(line) > 4 else 0.0 for line in lines]),
    )
    block.trace_noises = noises
    return block


SPRING_SLIDER = protocol.Protocol(
    "spring_slider",
    "e",
    {
        "spring_slider_runs": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("stage_azimuth_deg"),
            protocol.Column("area_cm2", 1e-3, 1e5, True, usual=50.0),
            protocol.Column("added_mass_g", 0, 1e5, usual=50.0),
            protocol.Column("spring_N_m", 1e-3, 1e7, usual=200.0),
            protocol.Column("speed_mm_s", 1e-6, 1e4, usual=1.0),
            protocol.Column("u_force_mN", 1e-6, 1e5, usual=0.5),
        ),
        "spring_slider": (
            protocol.RUN_ID,
            protocol.Column("t_s", -1e7, 1e7),
            protocol.Column("force_mN", -1e7, 1e7),
        ),
    },
    nominal=(),
    quantities=(
        protocol.Quantity(LEVEL, "level"),
        protocol.Quantity(SWING, "half drop"),
        protocol.Quantity(FIRST_SWING, "half of the first drop"),
    ),
    features=features,
    signals=(Signal("force_mN", "force cell", "u_force_mN"),),
    varied=(("speed_mm_s", (0.03, 0.3, 3)), ("added_mass_g", (20, 50, 150))),
)
