"""Paper on paper, pulled by a spring (Colas et al. 2019): events, rivals, held-out gain."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import find_peaks
from scipy.stats import t as student

from slipstitch.bench.gravity import GRAVITY_M_S2
from slipstitch.criticise.protocols.stick_slip import Slider, StickSlip, run, swing
from slipstitch.errors import BadInput

BLOCK_M = 1.0e-3
SMALLEST_DROP = 0.02


@dataclass(frozen=True)
class Run:
    """One run: its slider, weight and measured events (forces in units of the weight)."""

    name: str
    slider: Slider
    weight_N: float
    trace_place_m: np.ndarray
    trace: np.ndarray
    events: StickSlip


def read_runs(folder: Path) -> list[Run]:
    """Runs of the data set, with impulsive spikes removed by a 5-sample median.

    Raises
    ------
    BadInput
        If a file of the data set is missing.
    """
    table, traces = folder / "runs.csv", folder / "traces.npz"
    for path in (table, traces):
        if not path.exists():
            raise BadInput(f"{path}: missing; the stick-slip data set has runs.csv and traces.npz")
    arrays = np.load(traces)
    runs = []
    for row in csv.DictReader(table.open(encoding="utf-8")):
        slider = Slider(
            float(row["slider_mass_kg"]),
            float(row["spring_N_per_m"]),
            float(row["drive_um_per_s"]) * 1e-6,
        )
        rate = float(row["rate_Hz"])
        weight = slider.mass_kg * GRAVITY_M_S2
        force = median_filter(arrays[row["array"]].astype(float), 5)
        period = 2 * np.pi * np.sqrt(slider.mass_kg / slider.spring_N_m) * rate
        force = uniform_filter1d(force, max(int(period / 8), 3))
        time = float(row["t0_s"]) + np.arange(len(force)) / rate
        place = slider.speed_m_s * time - force * weight / slider.spring_N_m
        runs.append(
            Run(row["array"], slider, weight, place, force, measured_events(force, place, rate))
        )
    return runs


def measured_events(force: np.ndarray, place: np.ndarray, rate_Hz: float) -> StickSlip:
    """Peaks and the troughs that follow; the stick time is from the trough before to the peak."""
    fine = force - uniform_filter1d(force, 9)
    noise = 1.4826 * np.median(np.abs(fine - np.median(fine)))
    prominence = max(SMALLEST_DROP, 6 * noise)
    peaks, _ = find_peaks(force, prominence=prominence)
    troughs, _ = find_peaks(-force, prominence=prominence)
    rows = []
    for peak in peaks:
        before = troughs[troughs < peak]
        after = troughs[troughs > peak]
        if len(before) and len(after):
            rows.append((place[peak], (peak - before[-1]) / rate_Hz, force[peak], force[after[0]]))
    table = np.array(rows).reshape(-1, 4)
    return StickSlip(*table.T)


@dataclass(frozen=True)
class Answer:
    """One question put to the runs: what was found, in words and numbers."""

    question: str
    verdict: str
    words: str
    numbers: dict[str, float | list]


def drops_against_speed(runs: list[Run]) -> Answer:
    """Are the growing drops more than inertia? The excess is fitted to the slow runs only."""
    slow = [r for r in runs if r.slider.speed_m_s < 1e-4]
    excess = {r.slider.spring_N_m: np.median(r.events.peak_N - r.events.trough_N) / 2 for r in slow}
    rows, errors, plain = [], [], []
    for r in runs:
        seen = float(np.median(r.events.peak_N - r.events.trough_N))
        fixed = float(excess[r.slider.spring_N_m])
        expected = 2 * float(swing(r.slider, fixed * r.weight_N)) / r.weight_N
        rows.append([r.name, r.slider.spring_N_m, 1e3 * r.slider.speed_m_s, seen, expected])
        if r.slider.speed_m_s > 1e-4:
            errors.append(np.log(seen / expected))
            plain.append(np.log(seen / (2 * fixed)))
    with_inertia = float(np.sqrt(np.mean(np.square(errors))))
    without = float(np.sqrt(np.mean(np.square(plain))))
    good = with_inertia < 0.6 * without
    words = (
        "The drops of the fast runs are predicted, with no parameter fitted to them, from the "
        "static excess of the slow runs and the slider's inertia "
        f"(error {100 * with_inertia:.0f} %, against {100 * without:.0f} % without inertia): "
        "no change of friction with speed is needed for them."
        if good
        else "Inertia improves the drops of the fast runs from an error of "
        f"{100 * without:.0f} % to {100 * with_inertia:.0f} %, which leaves something over."
    )
    return Answer(
        "Do drops that grow with speed need a rate-dependent friction?",
        "inertia suffices" if good else "inertia is a part",
        words,
        {"rms_log_error_inertia": with_inertia, "rms_log_error_plain": without, "rows": rows},
    )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    x = x - x.mean()
    return float(x @ (y - y.mean()) / (x @ x)) if len(x) > 2 and np.ptp(x) > 0 else np.nan


def ageing(runs: list[Run], rng: np.random.Generator, simulations: int = 40) -> Answer:
    """Do peaks grow with stick time more than loading at constant speed makes them?

    A peak takes longer to reach the higher it is, so peak and stick time are tied without any
    ageing. The rival is simulated: the same slider and excess over a friction that varies along
    the track as the run's own troughs do.
    """
    rows, z = [], []
    for r in runs:
        e = r.events
        keep = e.stick_s > 0
        half_swing = float(np.median(e.peak_N - e.trough_N)) / 2
        swung = r.slider.inertial_force / r.weight_N > 0.5 * half_swing
        if keep.sum() < 30 or swung:  # a slider that swings does not stick
            continue
        seen = _slope(np.log10(e.stick_s[keep]), e.peak_N[keep])
        simulated = []
        for _ in range(simulations):
            s = _rival(r, rng)
            good = s.stick_s > 1e-9
            if good.sum() > 10:
                slope = _slope(np.log10(s.stick_s[good]), s.peak_N[good] / r.weight_N)
                simulated.append(slope)
        if len(simulated) < simulations // 2:
            continue
        mean, sd = float(np.mean(simulated)), float(np.std(simulated, ddof=1))
        rows.append([r.name, seen, mean, sd])
        # The rival's own make-up is known to perhaps a quarter of its slope.
        z.append((seen - mean) / np.hypot(sd, 0.25 * abs(mean)))
    z = np.array(z)
    total = float(z.sum() / np.sqrt(len(z))) if len(z) else 0.0
    clear = abs(total) > 2.6 and np.mean(np.sign(z) == np.sign(total)) > 0.8
    seen = ", ".join(f"{row[1]:.3f}" for row in rows)
    simulated = ", ".join(f"{row[2]:.3f} ± {row[3]:.3f}" for row in rows)
    slopes = (
        f"Slope of peak against log10 of stick time in the {len(rows)} runs that stick: {seen}; "
        f"in simulated sliders without ageing on tracks as uneven: {simulated} "
        f"(combined z = {total:.1f}). "
    )
    if clear and total > 0:
        words = slopes + "Peaks grow with stick time beyond what loading alone ties them to."
        verdict = "ageing is suggested"
    else:
        words = slopes + (
            "Loading at constant speed ties high peaks to long sticks by itself: nothing here is "
            "evidence for ageing."
        )
        verdict = "not shown"
    numbers = {"combined_z": total, "rows": rows}
    return Answer("Does static friction age with the stick time?", verdict, words, numbers)


def _rival(r: Run, rng: np.random.Generator) -> StickSlip:
    """The run without ageing: friction along the track resampled from the run's own."""
    e = r.events
    level = 0.5 * (e.peak_N + e.trough_N)
    reach = float(np.ptp(e.place_m)) or 1e-3
    start, end = float(e.place_m.min()), float(e.place_m.max())
    order = np.argsort(e.place_m)
    shift = rng.uniform(0, reach)
    flip = rng.choice([-1.0, 1.0])
    place, track = e.place_m[order], level[order]
    half_swing = 0.5 * (e.peak_N - e.trough_N)
    inertia = r.slider.inertial_force / r.weight_N
    excesses = np.sqrt(np.maximum(half_swing**2 - inertia**2, 1e-6))

    def kinetic(x: float) -> float:
        at = start + (flip * (x - start) + shift) % reach
        return r.weight_N * float(np.interp(at, place, track))

    state = {"x": None, "excess": 0.0}

    def static(x: float, _: float) -> float:
        if state["x"] != x:
            state["x"], state["excess"] = x, float(rng.choice(excesses))
        return kinetic(x) + r.weight_N * state["excess"]

    length = min(end - start, 6e-3)
    return run(r.slider, static, kinetic, start, start + length, most=1500)


def held_out(runs: list[Run]) -> list[dict]:
    """Log score an event on held-out millimetres of track, model by model.

    Every second block of 1 mm is held out; peaks and troughs of its events are predicted from the
    rest of the same run (from the other runs, for the models that have no level of their own).
    """
    models = (
        "plain Coulomb: one coefficient",
        "a coefficient for each run",
        "with a static excess",
        "with inertia as well",
        "with friction along the track",
    )
    sums = {name: [] for name in models}
    squares = {name: [] for name in models}
    for r in runs:
        e = r.events
        block = np.floor((e.place_m - e.place_m.min()) / BLOCK_M).astype(int)
        level = 0.5 * (e.peak_N + e.trough_N)
        half = 0.5 * (e.peak_N - e.trough_N)
        others = [o for o in runs if o is not r]
        common = np.concatenate([0.5 * (o.events.peak_N + o.events.trough_N) for o in others])
        weights = np.concatenate(
            [
                np.full(len(o.events.peak_N), 1 / len(o.events.peak_N))
                for o in others
                if len(o.events.peak_N)
            ]
        )
        mean_common = float(np.sum(weights * common) / weights.sum())
        both_common = np.concatenate(
            [np.concatenate([o.events.peak_N, o.events.trough_N]) for o in others]
        )
        sd_common = float(np.std(both_common - mean_common))
        slow = [o for o in others if o.slider.speed_m_s <= r.slider.speed_m_s] or others
        excess = float(
            np.median(
                [
                    np.sqrt(
                        max(
                            np.median(0.5 * (o.events.peak_N - o.events.trough_N)) ** 2
                            - (o.slider.inertial_force / o.weight_N) ** 2,
                            1e-5,
                        )
                    )
                    for o in slow
                ]
            )
        )
        for parity in (0, 1):
            test = block % 2 == parity
            train = ~test
            if test.sum() < 5 or train.sum() < 5:
                continue
            mean = level[train].mean()
            spread = np.sqrt(np.mean(half[train] ** 2) + level[train].var())
            inertial = swing(r.slider, excess * r.weight_N) / r.weight_N
            sd_level = max(level[train].std(), 5e-3)
            sd_excess = np.sqrt(sd_level**2 + np.mean((half[train] - excess) ** 2))
            sd_inertial = np.sqrt(sd_level**2 + np.mean((half[train] - inertial) ** 2))
            track, sd_track = _along_track(e.place_m, level, train)
            sd_swing = np.sqrt(np.mean((half[train] - inertial) ** 2))
            n = test.sum()
            predictions = {
                models[0]: (np.full(n, mean_common), 0.0, np.full(n, sd_common)),
                models[1]: (np.full(n, mean), 0.0, np.full(n, spread)),
                models[2]: (np.full(n, mean), excess, np.full(n, sd_excess)),
                models[3]: (np.full(n, mean), inertial, np.full(n, sd_inertial)),
                models[4]: (track[test], inertial, np.hypot(sd_track[test], sd_swing)),
            }
            for name, (centre, shift, sd) in predictions.items():
                score = np.zeros(n)
                error = np.zeros(n)
                for sign, seen in ((1, e.peak_N[test]), (-1, e.trough_N[test])):
                    miss = seen - centre - sign * shift
                    score += -np.log(sd) - 0.5 * (miss / sd) ** 2 - 0.5 * np.log(2 * np.pi)
                    error += miss**2
                for b in np.unique(block[test]):
                    mine = block[test] == b
                    sums[name].append(score[mine].mean() / 2)
                    squares[name].append(error[mine].mean() / 2)
    reference = np.array(sums[models[0]])
    result, before = [], None
    for name in models:
        score = np.array(sums[name])
        step = score - (before if before is not None else reference)
        reach = student.ppf(0.975, len(step) - 1) * step.std(ddof=1) / np.sqrt(len(step))
        result.append(
            {
                "model": name,
                "log_score": float(score.mean()),
                "step": float(step.mean()),
                "step_ci95": [float(step.mean() - reach), float(step.mean() + reach)],
                "rmse": float(np.sqrt(np.mean(squares[name]))),
                "blocks": len(score),
            }
        )
        before = score
    return result


def _along_track(place: np.ndarray, level: np.ndarray, train: np.ndarray):
    """Kriging of the level along the track from the training events (exponential covariance)."""
    mean = level[train].mean()
    variance = max(level[train].var(), 1e-6)
    index = np.flatnonzero(train)
    if len(index) > 400:
        index = index[np.linspace(0, len(index) - 1, 400).astype(int)]
    best = None
    gaps = np.abs(place[index][:, None] - place[index][None, :])
    for length in (0.2e-3, 0.5e-3, 1e-3, 2e-3, 4e-3):
        for nugget in (0.1, 0.3, 0.6):
            matrix = variance * (
                (1 - nugget) * np.exp(-gaps / length) + nugget * np.eye(len(index))
            )
            factor = np.linalg.cholesky(matrix)
            white = np.linalg.solve(factor, level[index] - mean)
            value = -0.5 * white @ white - np.log(np.diag(factor)).sum()
            if best is None or value > best[0]:
                best = (value, length, nugget, matrix)
    _, length, nugget, matrix = best
    cross = variance * (1 - nugget) * np.exp(-np.abs(place[:, None] - place[index]) / length)
    solved = np.linalg.solve(matrix, cross.T)
    prediction = mean + cross @ np.linalg.solve(matrix, level[index] - mean)
    left = variance - np.sum(cross * solved.T, axis=1)
    return prediction, np.sqrt(np.maximum(left, 1e-8))


def same_track(runs: list[Run]) -> Answer:
    """Do all runs see the same track? Correlation of their levels place by place."""
    edges = np.arange(4.5e-3, 18.6e-3, 0.25e-3)
    profiles = []
    for r in runs:
        which = np.digitize(r.trace_place_m, edges)
        profile = np.array(
            [
                r.trace[which == i].mean() if np.any(which == i) else np.nan
                for i in range(1, len(edges))
            ]
        )
        profiles.append(profile - np.nanmean(profile))
    values = []
    for i in range(len(profiles)):
        for j in range(i):
            good = np.isfinite(profiles[i]) & np.isfinite(profiles[j])
            values.append(float(np.corrcoef(profiles[i][good], profiles[j][good])[0, 1]))
    mean = float(np.mean(values))
    return Answer(
        "Is the variation along the track a property of the place?",
        "no" if abs(mean) < 0.2 else "partly",
        f"The levels of different runs at the same place correlate by {mean:.2f} on average: each "
        "run sees a track of its own, so the variation cannot be carried over from run to run.",
        {"mean_correlation": mean},
    )


def level_against_speed(runs: list[Run]) -> Answer:
    """Mean level against speed and stiffness: one run a cell, so its scatter is unknown."""
    y = np.array([np.mean(r.trace) for r in runs])
    x = np.array([np.log10(r.slider.speed_m_s) for r in runs])
    design = np.column_stack([np.ones(len(runs)), x - x.mean()])
    size, *_ = np.linalg.lstsq(design, y, rcond=None)
    residual = y - design @ size
    free = len(y) - 2
    error = float(np.sqrt(residual @ residual / free / ((x - x.mean()) ** 2).sum()))
    reach = float(student.ppf(0.975, free)) * error
    low, high = float(size[1] - reach), float(size[1] + reach)
    decided = low > 0 or high < 0
    return Answer(
        "Does the level of kinetic friction change with speed?",
        "yes" if decided else "not decided",
        f"Slope {size[1]:.3f} [{low:.3f}, {high:.3f}] a decade of speed. With one run a cell the "
        "scatter between runs and an effect of the cell are one and the same; "
        f"a single run ({runs[int(np.argmax(y))].name}) lies at {y.max():.2f} where the others "
        f"average {np.delete(y, np.argmax(y)).mean():.2f}, and no repeat says why.",
        {"slope": float(size[1]), "ci95": [low, high]},
    )
