"""Comparison of runs of drop-and-drag with finer ones: distances, events, verdicts."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d

from slipstitch.base.errors import BadInput
from slipstitch.config import Config
from slipstitch.design.stage_path import StagePath
from slipstitch.physics.convergence.cases import cases
from slipstitch.physics.simulation import convergence
from slipstitch.physics.simulation.trajectory import Trajectory

SUMMARISED = (
    *("finest", "mean_m", "mean_largest_m", "worst_m", "shifted_mean_m"),
    *("shifted_largest_m", "steady_largest_m", "worst_shift_s"),
)
# Converged: the mean distance of the vertices is within this at all times.
MEAN_DISTANCE_M = 1e-3
SHIFT_MAX_S = 2.0  # how far apart in time two runs are compared
SHIFTED_PLACES = 21  # a side, of the places compared at other times
CURVE_POINTS_MAX = 120
SLIP_M = 2e-3  # as far as the lower edge is dragged where it is said to slip
SLIP_UNSURE_M = 1e-3
FLIP_SPEED_M_S = 0.02  # mean over vertices; the stage moves at 0.01
STEADY_SPEED_M_S = 0.001
STEADY_S = 1.0


def common_vertices(side: int, sides: tuple[int, ...]) -> np.ndarray:
    """Numbers of the vertices of one mesh that lie at places common to several, row by row."""
    return _every(side, (side - 1) // math.gcd(*(side - 1 for side in sides)))


def _every(side: int, step: int) -> np.ndarray:
    """Numbers of the vertices in every so many rows and columns of a mesh."""
    line = np.arange(0, side, step)
    return (line[:, None] * side + line).ravel()


def events(run: Trajectory) -> dict[str, float | None]:
    """Times of the fast events, in s; None for one that does not happen.

    ``landing``: the lower edge comes to within 1 mm of the floor. ``slip``: from when on it is 2 mm
    from where it lay as the stroke began. ``flip``: its vertices move relative to the clamps at 20
    mm/s on average, and fastest. ``slip 2`` is of stroke 2.
    """
    time_s = run.time_s
    found: dict[str, float | None] = {"landing": _first(time_s, 1e-3 - _lower_edge_m(run)[:, 2])}
    for number, part in _strokes(run):
        found[f"slip{number}"], found[f"flip{number}"] = None, None
        if len(time_s[part]) < 2:
            continue
        found[f"slip{number}"] = _for_good(time_s[part], _dragged_m(run, part) - SLIP_M)
        speed_m_s = _speeds_m_s(_from_the_clamps(run)[part], time_s[part])
        fastest = int(speed_m_s.argmax())
        if speed_m_s[fastest] >= FLIP_SPEED_M_S:
            found[f"flip{number}"] = float(time_s[part][fastest : fastest + 2].mean())
    return found


def _speeds_m_s(places_m: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Mean over the vertices, from each frame to the next."""
    return np.linalg.norm(np.diff(places_m, axis=0), axis=2).mean(axis=1) / np.diff(time_s)


def _from_the_clamps(run: Trajectory, vertices: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Places of vertices relative to the clamps, shape (T, N, 3)."""
    places_m = run.positions_m[:, vertices].astype(float)
    places_m[..., 0] -= run.stage_x_m[:, None]
    return places_m


def _strokes(run: Trajectory) -> Iterator[tuple[str, slice]]:
    """What names the events of each stroke that was begun, and its frames."""
    path = StagePath(**run.metadata["settings"].get("stage", {}))
    for stroke in range(max(path.strokes, 1)):
        begin_s = path.drop_duration_s + stroke * path.stroke_duration_s
        begun, over = np.searchsorted(run.time_s, [begin_s, begin_s + path.stroke_duration_s])
        part = slice(begun, over + 1)
        if stroke and len(run.time_s[part]) < 2:
            return
        yield f" {stroke + 1}" if stroke else "", part


def _lower_edge_m(run: Trajectory) -> np.ndarray:
    """Its mean place, shape (T, 3)."""
    return run.positions_m[:, run.uv[:, 1] == run.uv[:, 1].max()].astype(float).mean(axis=1)


def _dragged_m(run: Trajectory, part: slice) -> np.ndarray:
    """How far the lower edge is from where it was at the beginning of the frames."""
    along = _lower_edge_m(run)[part, 0]
    return np.abs(along - along[0])


def _slip_shifts(first: Trajectory, second: Trajectory) -> dict[str, float]:
    """How much later the lower edge slips in the first run, where either's is dragged so far.

    The other's is to within `SLIP_UNSURE_M`: it may come to rest, or the run end, a little short.
    """
    found = {}
    for number, part in _strokes(first):
        time_s = first.time_s[part]
        if len(time_s) < 2:
            continue
        beyond = [_dragged_m(run, part) - SLIP_M for run in (first, second)]
        slips_s = [_for_good(time_s, one) for one in beyond]
        for sign, one, other in ((1.0, 0, 1), (-1.0, 1, 0)):
            moments_s = [*time_s[np.abs(beyond[other]) <= SLIP_UNSURE_M], slips_s[other]]
            shifts_s = [
                slips_s[one] - at_s for at_s in moments_s if None not in (at_s, slips_s[one])
            ]
            if shifts_s:
                found[f"slip{number}"] = float(sign * min(shifts_s, key=abs))
                break
    return found


def _first(time_s: np.ndarray, value: np.ndarray) -> float | None:
    """Interpolated time at which a value first becomes positive."""
    after = np.flatnonzero(value > 0)
    if not len(after):
        return None
    k = int(after[0])
    if k == 0:
        return float(time_s[0])
    share = -value[k - 1] / (value[k] - value[k - 1])
    return float(time_s[k - 1] + share * (time_s[k] - time_s[k - 1]))


def compare(run: Trajectory, finest: Trajectory, sides: tuple[int, ...]) -> dict[str, Any]:
    """Distance between two runs with the same frames, vertex by vertex, and at shifted times.

    ``sides`` are the vertices a side of all meshes to compare at the same places. ``shifted``
    numbers compare every moment with that of the finest, up to 2 s apart, which is most like it,
    straight from frame to frame, the largest less what that leaves out of a curved way;
    ``worst_shift_s`` is how much later that is at the largest mean, ``steady_largest_m`` the
    largest mean while both runs are steadily dragged, or None; ``curve`` is thinned out.
    """
    if len(run.time_s) != len(finest.time_s) or np.abs(run.time_s - finest.time_s).max() > 1e-9:
        raise BadInput("the runs have different frames; regenerate them")
    first, second = (
        _from_the_clamps(one, common_vertices(math.isqrt(one.positions_m.shape[1]), sides))
        for one in (run, finest)
    )
    distance = np.linalg.norm(first - second, axis=2)
    mean, worst = distance.mean(axis=1), distance.max(axis=1)
    side = math.isqrt(first.shape[1])
    few = _every(side, -(-(side - 1) // (SHIFTED_PLACES - 1)))
    shifted, shift_s, bend = _least_mean_distance(first[:, few], second[:, few], run.time_s)
    shifted = np.minimum(shifted, mean)
    there, reference, slips = events(run), events(finest), _slip_shifts(run, finest)
    steady = _is_steady(first, run.time_s) & _is_steady(second, run.time_s)
    every = -(-len(mean) // CURVE_POINTS_MAX)
    curve = {"time_s": run.time_s, "mean_m": mean, "worst_m": worst, "shifted_mean_m": shifted}
    return {
        "mean_m": float(mean.mean()),
        "mean_largest_m": float(mean.max()),
        "worst_m": float(worst.max()),
        "worst_time_s": float(run.time_s[worst.argmax()]),
        "shifted_mean_m": float(shifted.mean()),
        "shifted_largest_m": float((shifted - np.minimum(bend, shifted)).max()),
        "worst_shift_s": float(shift_s[mean.argmax()]),
        "steady_largest_m": float(mean[steady].max()) if steady.any() else None,
        "events": {
            name: {
                "time_s": time_s,
                "finest_s": other,
                "shift_s": slips.get(
                    name, None if time_s is None or other is None else time_s - other
                ),
            }
            for name, time_s in there.items()
            if (other := reference[name]) is not None or time_s is not None
        },
        "curve": {name: np.round(values[::every], 6).tolist() for name, values in curve.items()},
    }


def _is_steady(places_m: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Whether the cloth hardly moves relative to the clamps for a second before and after."""
    if len(time_s) < 2:
        return np.zeros(len(time_s), bool)
    fast = np.append(_speeds_m_s(places_m, time_s) > STEADY_SPEED_M_S, False)
    reach = round(STEADY_S / (time_s[1] - time_s[0]))
    return ~maximum_filter1d(fast, 2 * reach + 1)


def _least_mean_distance(first, second, time_s) -> tuple[np.ndarray, ...]:
    """Of each moment of the first from the second's way 2 s before and after, each (T,).

    Distance, how much later, and what a straight line leaves out of an evenly accelerated way.
    """
    frames = len(time_s)
    frame_s = time_s[1] - time_s[0] if frames > 1 else 1.0
    reach = int(SHIFT_MAX_S / frame_s + 1e-9)
    least, later_s, bend = np.full(frames, np.inf), np.zeros(frames), np.zeros(frames)
    way = np.diff(second, axis=0)
    squared = np.maximum((way**2).sum(axis=(1, 2)), 1e-300)
    second_difference = np.zeros(frames)
    second_difference[1:-1] = np.linalg.norm(np.diff(way, axis=0), axis=2).mean(axis=1)
    for shift in range(-reach, reach):
        here = np.arange(max(0, -shift), min(frames, frames - 1 - shift))
        there = here + shift
        away, along = first[here] - second[there], way[there]
        part = np.clip((away * along).sum(axis=(1, 2)) / squared[there], 0.0, 1.0)
        mean = np.linalg.norm(away - part[:, None, None] * along, axis=2).mean(axis=1)
        nearer = mean < least[here]
        here, there, part = here[nearer], there[nearer], part[nearer]
        least[here] = mean[nearer]
        later_s[here] = (shift + part) * frame_s
        bend[here] = np.maximum(second_difference[there], second_difference[there + 1]) / 8
    return least, later_s, bend


def _for_good(time_s: np.ndarray, value: np.ndarray) -> float | None:
    """Interpolated time from which on a value is positive."""
    not_yet = np.flatnonzero(value <= 0)
    begun = int(not_yet[-1]) if len(not_yet) else 0
    return _first(time_s[begun:], value[begun:])


def comparisons(config: Config, runs: Mapping[str, Trajectory]) -> list[dict[str, Any]]:
    """Every run, by id of its case, against the finest of its kind, as `compare` does."""
    here, found = [case for case in cases(config) if case.id in runs], []
    for chosen in here:
        if chosen.vertices_per_side != config.convergence.vertices_per_side[0] or chosen.halvings:
            continue
        family = [case for case in here if case.pair == chosen.pair]
        steps = [case for case in family if case.vertices_per_side == chosen.vertices_per_side]
        meshes = [case for case in family if case.halvings == 0]
        for kind, members in (("time step", steps), ("mesh", meshes)):
            sides = tuple(dict.fromkeys(case.vertices_per_side for case in members))
            for case in members[:-1]:
                run = runs[case.id]
                found.append(
                    {
                        "material": case.material,
                        "friction": case.friction,
                        "kind": kind,
                        "time_step_s": run.metadata["step_s"],
                        "vertices_per_side": case.vertices_per_side,
                        "finest": members[-1].id,
                        **compare(run, runs[members[-1].id], sides),
                    }
                )
    return found


def summary(compared: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The summary for the metadata of simulations: the chosen settings, pair by pair.

    The verdict is the worse of those of both refinements, or None if not both were studied.
    """
    rows: dict[tuple, dict] = {}
    for comparison in compared:
        own = {name: comparison[name] for name in ("material", "friction")}
        row = rows.setdefault(tuple(own.values()), own | {"time_step": None, "mesh": None})
        key = comparison["kind"].replace(" ", "_")
        if row[key] is None:  # the first is the one at the chosen settings
            shifts = {name: event["shift_s"] for name, event in comparison["events"].items()}
            known = [abs(shift) for shift in shifts.values() if shift is not None]
            found = row[key] = {
                **{name: comparison[name] for name in SUMMARISED},
                "event_shift_s": max(known, default=0.0),
                "events_missing": [name for name, shift in shifts.items() if shift is None],
            }
            found["verdict"] = _verdict(found)
    for row in rows.values():
        studied = [row[key] for key in ("time_step", "mesh") if row[key] is not None]
        row["verdict"] = convergence.worst_verdict([found["verdict"] for found in studied])
        if len(studied) < 2 and row["verdict"] != convergence.NOT_CONVERGED:
            row["verdict"] = None  # what was not studied may speak against it
    return list(rows.values())


def _verdict(found: Mapping[str, Any]) -> str:
    """Of one kind of refinement: the same; but for when or how it rolls over; something else."""
    if found["mean_largest_m"] <= MEAN_DISTANCE_M:
        return convergence.CONVERGED
    steady_m, shifted_m = found["steady_largest_m"], found["shifted_largest_m"]
    if steady_m is None or steady_m > MEAN_DISTANCE_M or found["events_missing"]:
        return convergence.NOT_CONVERGED
    shift_s = max(found["event_shift_s"], abs(found["worst_shift_s"]))
    if shifted_m <= MEAN_DISTANCE_M:
        return convergence.BUT_FOR_ITS_MOMENT.format(shift_s)
    return convergence.BUT_FOR_ITS_COURSE.format(shift_s, 1e3 * shifted_m)


def describe(config: Config, runs: Mapping[str, Trajectory]) -> dict[str, Any]:
    """The study as JSON can hold it: settings, runs and their cost, what misses, comparisons."""
    compared = comparisons(config, runs)
    here = [case for case in cases(config) if case.id in runs]
    if not here:
        raise BadInput(f"no runs of the study found; their ids look like {cases(config)[0].id}")
    chosen = runs[here[0].id].metadata
    return {
        "settings": {
            "convergence": config.convergence.model_dump(mode="json")
            | {"mean_distance_m": MEAN_DISTANCE_M},
            "time_step_s": chosen["step_s"],
            "simulation": chosen["settings"],
        },
        "runs": [
            {
                **asdict(case),
                "time_step_s": runs[case.id].metadata["step_s"],
                "cpu_s": (runs[case.id].metadata.get("provenance") or {}).get("cpu_s"),
                "solver": runs[case.id].metadata["solver"],
            }
            for case in here
        ],
        "missing": [case.id for case in cases(config) if case.id not in runs],
        "summary": summary(compared),
        "comparisons": compared,
    }
