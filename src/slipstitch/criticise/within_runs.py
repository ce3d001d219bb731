"""What single runs show that no feature carries: an uneven track, and impacts at the start.

The features of a run are means along its track. Whether friction changes along it is judged on
held-out pieces of track: every second sixteenth of a run's way is left out, and its peaks and
troughs are predicted from the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from operator import itemgetter

import numpy as np
import pandas as pd
from scipy.stats import norm
from scipy.stats import t as student

from slipstitch.base.page.wording import with_interval
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import Bench
from slipstitch.criticise.measurements import Measurements
from slipstitch.criticise.protocols.protocol import masses_of
from slipstitch.criticise.protocols.push import LEVEL, PEAK, PushBlock
from slipstitch.criticise.protocols.spring_slider import slips_of_trace
from slipstitch.criticise.protocols.stick_slip import Slider, swing
from slipstitch.physics import GRAVITY_M_S2

PIECES = 16
FEWEST_SLIPS, FEWEST_RUNS = 5, 2  # of a run's pieces that are kept and left out; with as many
LENGTHS = (0.0125, 0.03, 0.06, 0.125, 0.25)  # of a run's way, tried for the track
NUGGETS = (0.1, 0.3, 0.6)
MOST_SLIPS = 400
SMALLEST_EXCESS, SMALLEST_SD = 3e-3, 5e-3  # of the weight
# In this order; what each adds.
LADDER = (
    ("common", "one coefficient"),
    ("run", "a coefficient for each run"),
    ("static", "a static excess"),
    ("inertia", "the slider's inertia"),
    ("track", "friction along the track"),
)


@dataclass(frozen=True)
class _Run:
    """Slips of a run: place (m), middle and half of the drop, over the weight."""

    slider: Slider
    place_m: np.ndarray
    level: np.ndarray
    half: np.ndarray

    @property
    def weight(self) -> float:
        return self.slider.mass_kg * GRAVITY_M_S2

    def half_with(self, excess: float) -> float:
        """Half drop of a static excess with inertia."""
        return float(swing(self.slider, excess * self.weight) / self.weight)

    @property
    def excess(self) -> float:
        """The static excess that its half drop leaves beside inertia."""
        left = np.median(self.half) ** 2 - self.half_with(0.0) ** 2
        return float(np.sqrt(max(left, SMALLEST_EXCESS**2)))


def within_runs(case: Case, measurements: Measurements) -> dict:
    """Findings by protocol, plain data; empty where single runs tell nothing more."""
    found = {}
    if "spring_slider" in case.protocols:
        found["spring_slider"] = _uneven_track(_runs(case))
    for block in measurements.blocks:
        if isinstance(block, PushBlock):
            found["push"] = _impact(block)
    return {name: finding for name, finding in found.items() if finding}


def _runs(case: Case) -> list[_Run]:
    runs = case.tables["spring_slider_runs"]
    parts = dict(list(case.tables["spring_slider"].groupby("run_id", sort=False)))
    found = []
    cloth, added = masses_of(runs, case.nominal)
    for (_, run), mass_kg in zip(runs.iterrows(), cloth + added, strict=True):
        slider = Slider(float(mass_kg), run["spring_N_m"], 1e-3 * run["speed_mm_s"])
        trace = parts[run["run_id"]]
        if len(trace) < 20 or not np.ptp(trace["t_s"]) > 0 or slider.mass_kg <= 0:
            continue
        slips = slips_of_trace(trace, slider, run["u_force_mN"])
        weight_mN = 1e3 * slider.mass_kg * GRAVITY_M_S2
        place = slider.speed_m_s * slips.time_s - 1e-3 * slips.middle_mN / slider.spring_N_m
        found.append(_Run(slider, place, slips.middle_mN / weight_mN, slips.half_mN / weight_mN))
    return [run for run in found if len(run.place_m) >= 2 * FEWEST_SLIPS]


def _left_out(runs: list[_Run]) -> tuple[pd.DataFrame, list[float], int]:
    """Score and squared error of every model by piece of track left out.

    And the lengths of the track, and how many runs were used.
    """
    parts, lengths, used = [], [], 0
    for run in runs:
        others = [other for other in runs if other is not run]
        way = float(np.ptp(run.place_m))
        if not others or way <= 0:
            continue
        piece = np.floor((run.place_m - run.place_m.min()) / way * PIECES).astype(int)
        used += 1
        for test in (piece % 2 == 0, piece % 2 == 1):
            if min(test.sum(), (~test).sum()) < FEWEST_SLIPS:
                continue
            forecasts, length = _forecasts(run, others, test, way)
            lengths.append(length)
            for name, (centre, half, sd) in forecasts.items():
                off, more = run.level[test] - centre, run.half[test] - half
                misses = np.stack([off + more, off - more])
                score = norm.logpdf(misses, scale=sd).mean(axis=0)
                table = pd.DataFrame({"score": score, "error": (misses**2).mean(axis=0)})
                parts.append(table.groupby(piece[test]).mean().assign(model=name))
    return pd.concat(parts or [pd.DataFrame()]), lengths, used


def _uneven_track(runs: list[_Run]) -> dict | None:
    found, lengths, used = _left_out(runs)
    if used < FEWEST_RUNS or len(lengths) < 2:
        return None
    of_model = dict(list(found.groupby("model")))
    ladder, before = [], of_model["common"]["score"].to_numpy()
    for name, title in LADDER:
        score = of_model[name]["score"].to_numpy()
        step = score - before
        half = student.ppf(0.975, len(step) - 1) * step.std(ddof=1) / np.sqrt(len(step))
        ladder.append(
            {
                "model": name,
                "adds": title,
                "log_score": round(float(score.mean()), 4),
                "step": round(float(step.mean()), 4),
                "step_ci95": [round(float(step.mean() + k * half), 4) for k in (-1, 1)],
                "error_of_weight": round(float(np.sqrt(of_model[name]["error"].mean())), 5),
            }
        )
        before = score
    spread = np.sqrt(np.mean([np.var(run.level, ddof=1) for run in runs]))
    return {
        "runs": used,
        "pieces": len(before),
        "slips": int(sum(len(run.place_m) for run in runs)),
        "track_sd": round(float(spread / np.mean([run.level.mean() for run in runs])), 5),
        "track_length_mm": round(1e3 * float(np.median(lengths)), 4),
        "same_place_correlation": _same_place(runs),
        "ladder": ladder,
    }


def _forecasts(run: _Run, others: list[_Run], test: np.ndarray, way: float):
    """(centre, half drop, sd) of the left-out slips by every model; length of the track (m)."""
    level, half = run.level[~test], run.half[~test]
    common = float(np.mean([other.level.mean() for other in others]))
    extremes = np.concatenate([o.level + sign * o.half for o in others for sign in (1, -1)])
    slower = [o for o in others if o.slider.speed_m_s <= run.slider.speed_m_s] or others
    excess = float(np.median([o.excess for o in slower]))
    inertial = run.half_with(excess)
    mean, sd_level = float(level.mean()), max(float(level.std()), SMALLEST_SD)
    track, sd_track, length = _along(run.place_m, run.level, ~test, way)

    def beside(sd, value):
        return np.sqrt(sd**2 + np.mean((half - value) ** 2))

    return {
        "common": (common, 0.0, np.std(extremes - common)),
        "run": (mean, 0.0, beside(sd_level, 0.0)),
        "static": (mean, excess, beside(sd_level, excess)),
        "inertia": (mean, inertial, beside(sd_level, inertial)),
        "track": (track[test], inertial, beside(np.maximum(sd_track[test], SMALLEST_SD), inertial)),
    }, length


def _along(place: np.ndarray, level: np.ndarray, known: np.ndarray, way: float):
    """Kriging along the track, exponential covariance of the likeliest length and nugget."""
    index = np.flatnonzero(known)
    if len(index) > MOST_SLIPS:
        index = index[np.linspace(0, len(index) - 1, MOST_SLIPS).astype(int)]
    mean, variance = level[index].mean(), max(level[index].var(), 1e-8)
    gaps = np.abs(place[index][:, None] - place[index])
    tried = []
    for length, nugget in product(np.array(LENGTHS) * way, NUGGETS):
        matrix = (1 - nugget) * np.exp(-gaps / length) + nugget * np.eye(len(index))
        factor = np.linalg.cholesky(variance * matrix)
        white = np.linalg.solve(factor, level[index] - mean)
        likelihood = -0.5 * white @ white - np.log(np.diag(factor)).sum()
        tried.append((likelihood, length, nugget, variance * matrix))
    _, length, nugget, matrix = max(tried, key=itemgetter(0))
    cross = variance * (1 - nugget) * np.exp(-np.abs(place[:, None] - place[index]) / length)
    weights = np.linalg.solve(matrix, cross.T)
    left = variance - np.sum(cross * weights.T, axis=1)
    return mean + weights.T @ (level[index] - mean), np.sqrt(np.maximum(left, 1e-8)), float(length)


def _same_place(runs: list[_Run]) -> float | None:
    """Mean correlation of different runs' levels at the same place of the drive."""
    low = max(run.place_m.min() for run in runs)
    high = min(run.place_m.max() for run in runs)
    if not high > low:
        return None
    grid = np.linspace(low, high, 4 * PIECES)
    profiles = [
        np.interp(grid, *np.array(sorted(zip(r.place_m, r.level, strict=True))).T) for r in runs
    ]
    if any(np.ptp(profile) == 0 for profile in profiles):
        return None
    matrix = np.corrcoef(profiles)
    return round(float(matrix[np.triu_indices(len(runs), 1)].mean()), 4)


def _impact(block: PushBlock) -> dict | None:
    """The first peak over the level, as measured and as the impact of the finger alone makes it."""
    quantity = block.rows["quantity"]
    levels = block.rows[quantity == LEVEL].set_index("run_id")["y"]
    peaks = (quantity == PEAK).to_numpy()
    if not peaks.any():
        return None
    level = block.rows["run_id"][peaks].map(levels).to_numpy(float)
    alone = 1e3 * block.impact_force(Bench())[peaks]
    ratio = 1 + block.rows["y"].to_numpy(float)[peaks] / level
    excess = ratio - 1 - alone / level
    sums = pd.Series(excess).groupby(block.rows["specimen_id"][peaks].to_numpy()).mean()
    half = np.inf
    if len(sums) > 1:
        half = float(student.ppf(0.975, len(sums) - 1) * sums.std() / np.sqrt(len(sums)))
    return {
        "runs": int(peaks.sum()),
        "specimens": len(sums),
        "peak_over_level": round(float(np.median(ratio)), 4),
        "impact_alone_over_level": round(float(np.median(1 + alone / level)), 4),
        "excess": round(float(sums.mean()), 4),
        "excess_ci95": [round(float(sums.mean() + k * half), 4) for k in (-1, 1)],
        "stiffness_N_m": round(float(np.median(block.stiffness_N_m[peaks])), 1),
    }


def track_step(finding: dict, model: str) -> dict:
    """The step of the ladder that a model adds."""
    return next(entry for entry in finding["ladder"] if entry["model"] == model)


def _certain_track(findings: dict) -> dict | None:
    """What was found of the track, if it is beyond doubt that friction changes along it."""
    track = findings.get("spring_slider")
    if track is None or track_step(track, "track")["step_ci95"][0] <= 0:
        return None
    return track


def departure(findings: dict) -> str:
    """What is beyond doubt within the runs and no plain friction, as a clause; or nothing."""
    found = ["friction changes along the track"] if _certain_track(findings) else []
    if "push" in findings and findings["push"]["excess_ci95"][0] > 0:
        found.append("the first peak is more than the impact")
    return " and ".join(found)


def words(findings: dict) -> list[str]:
    """What the findings say, a sentence each; nothing where nothing is beyond doubt."""
    said = []
    impact = findings.get("push")
    if track := _certain_track(findings):
        gains = [
            with_interval(entry["step"], entry["step_ci95"], 2)
            for entry in (track_step(track, "track"), track_step(track, "static"))
        ]
        shared = track["same_place_correlation"]
        said.append(
            f"Friction is uneven along the track, by {100 * track['track_sd']:.1f} % over "
            f"{track['track_length_mm']:.2g} mm: on track left out that gains {gains[0]} in log "
            f"score a slip, a static excess {gains[1]}"
            + ("." if shared is None or shared > 0.5 else "; each run sees a track of its own.")
        )
    if impact is not None:
        low, high = impact["excess_ci95"]
        said.append(
            f"The first peak is {impact['peak_over_level']:.2f} times the level; the finger's "
            f"impact alone, with the stiffness of its loading, makes "
            f"{impact['impact_alone_over_level']:.2f}: "
            + ("the rest" if low > 0 or high < 0 else "no static excess shows in the rest")
            + f", {with_interval(impact['excess'], impact['excess_ci95'], 1, 100.0, ' %')} of the "
            "level."
        )
    return said
