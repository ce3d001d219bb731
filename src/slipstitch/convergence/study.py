"""What one of them differs by from a finer one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from slipstitch.bench.stage_path import StagePath
from slipstitch.config import Config
from slipstitch.convergence.cases import cases
from slipstitch.errors import BadInput
from slipstitch.simulate.trajectory import Trajectory

SUMMARISED = ("finest", "mean_m", "mean_largest_m", "worst_m", "shifted_mean_m")
SHIFT_MAX_S = 2.0  # how far apart in time two runs are compared
CURVE_POINTS_MAX = 120
FLIP_SPEED_M_S = 0.02  # mean over vertices; the stage moves at 0.01


def common_vertices(side: int, sides: tuple[int, ...]) -> np.ndarray:
    """Numbers of the vertices of one mesh that lie at places common to several, row by row."""
    intervals = math.gcd(*(side - 1 for side in sides))
    line = np.arange(0, side, (side - 1) // intervals)
    return (line[:, None] * side + line).ravel()


def events(run: Trajectory, path: StagePath | None = None) -> dict[str, float | None]:
    """Times of the fast events, in s; None for one that does not happen.

    Returns
    -------
    dict
        ``landing``: the lower edge comes to within 1 mm of the floor. ``slip``: it has been
        dragged 2 mm along the floor since the stage started. ``flip``: the cloth rolls over, its
        vertices moving relative to the clamps at 20 mm/s or more on average, twice the speed of
        the stage; the moment when that is fastest.
    """
    path = path or StagePath(**run.metadata["settings"].get("stage", {}))
    edge = run.positions_m[:, run.uv[:, 1] == run.uv[:, 1].max()].astype(float).mean(axis=1)
    time_s = run.time_s
    found: dict[str, float | None] = {"landing": _first(time_s, 1e-3 - edge[:, 2])}
    found["slip"] = found["flip"] = None
    begun = int(np.searchsorted(time_s, path.drop_duration_s))
    if begun < len(time_s) - 1:
        moved = np.abs(edge[begun:, 0] - edge[begun, 0])
        found["slip"] = _first(time_s[begun:], moved - 2e-3)
        places = run.positions_m[begun:].astype(float)
        places[..., 0] -= run.stage_x_m[begun:, None]
        travelled = np.linalg.norm(np.diff(places, axis=0), axis=2).mean(axis=1)
        speed_m_s = travelled / np.diff(time_s[begun:])
        fastest = int(speed_m_s.argmax())
        if speed_m_s[fastest] >= FLIP_SPEED_M_S:
            found["flip"] = float(time_s[begun + fastest : begun + fastest + 2].mean())
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
    """Distance between two runs, vertex by vertex, at the same times and at shifted ones.

    Parameters
    ----------
    run, finest : Trajectory
        With the same frames; meshes from ``sides``.
    sides : tuple of int
        Vertices a side of all meshes that are to be compared at the same places of the cloth.

    Returns
    -------
    dict
        ``mean_m``: mean over vertices and time; ``mean_largest_m``: the largest mean of a moment;
        ``worst_m``: the worst vertex of any moment; ``shifted_mean_m``, ``shifted_largest_m``:
        the first two, every moment compared with that moment of the finest, up to 2 s before or
        after, which is most like it (places relative to the clamps); ``events``: times in both
        and their difference; ``curve``: thinned out.

    Raises
    ------
    BadInput
        The runs have different frames.
    """
    if len(run.time_s) != len(finest.time_s) or np.abs(run.time_s - finest.time_s).max() > 1e-9:
        raise BadInput("the runs have different frames; regenerate them")
    first, second = (_places(trajectory, sides) for trajectory in (run, finest))
    distance = np.linalg.norm(first - second, axis=2)
    mean, worst = distance.mean(axis=1), distance.max(axis=1)
    shifted = _least_mean_distance(first, second, run.time_s)
    there, reference = events(run), events(finest)
    every = -(-len(mean) // CURVE_POINTS_MAX)
    curve = {"time_s": run.time_s, "mean_m": mean, "worst_m": worst, "shifted_mean_m": shifted}
    return {
        "mean_m": float(mean.mean()),
        "mean_largest_m": float(mean.max()),
        "worst_m": float(worst.max()),
        "worst_time_s": float(run.time_s[worst.argmax()]),
        "shifted_mean_m": float(shifted.mean()),
        "shifted_largest_m": float(shifted.max()),
        "events": {
            name: {"time_s": time_s, "finest_s": reference[name], "shift_s": _shift(time_s, other)}
            for name, time_s in there.items()
            if (other := reference[name]) is not None or time_s is not None
        },
        "curve": {name: np.round(values[::every], 6).tolist() for name, values in curve.items()},
    }


def _places(run: Trajectory, sides: tuple[int, ...]) -> np.ndarray:
    """Common vertices relative to the clamps, shape (T, N, 3)."""
    side = math.isqrt(run.positions_m.shape[1])
    places = run.positions_m[:, common_vertices(side, sides)].astype(float)
    places[..., 0] -= run.stage_x_m[:, None]
    return places


def _least_mean_distance(first, second, time_s) -> np.ndarray:
    frames = len(time_s)
    reach = int(SHIFT_MAX_S / (time_s[1] - time_s[0]) + 1e-9) if frames > 1 else 0
    least = np.full(frames, np.inf)
    for shift in range(-reach, reach + 1):
        here = np.arange(max(0, -shift), min(frames, frames - shift))
        mean = np.linalg.norm(first[here] - second[here + shift], axis=2).mean(axis=1)
        least[here] = np.minimum(least[here], mean)
    return least


def _shift(time_s: float | None, finest_s: float | None) -> float | None:
    return None if time_s is None or finest_s is None else time_s - finest_s


def comparisons(config: Config, runs: Mapping[str, Trajectory]) -> list[dict[str, Any]]:
    """Every run against the finest of its kind.

    Parameters
    ----------
    runs : mapping
        Trajectories by id of the case; those at the chosen settings, and others that `cases` lists.

    Returns
    -------
    list of dict
        `compare`'s, with ``material``, ``friction``, ``kind`` (time step or mesh),
        ``time_step_s``, ``vertices_per_side`` and ``finest`` (the id compared with).
    """
    study, found = config.convergence, []
    for chosen in cases(config):
        if chosen.vertices_per_side != study.vertices_per_side[0] or chosen.halvings:
            continue
        if chosen.id not in runs:
            continue
        family = [case for case in cases(config) if case.pair == chosen.pair and case.id in runs]
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


def summary(config: Config, compared: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The summary for the metadata of simulations: the chosen settings, pair by pair.

    Returns
    -------
    list of dict
        ``material, friction, time_step, mesh, converged``; the third and fourth hold
        ``finest`` (what was compared with), ``mean_m, mean_largest_m, worst_m, shifted_mean_m,
        event_shift_s`` (the largest) and ``events_missing`` (those that happen in one of the two
        runs only), or are None where not studied. ``converged`` is None then, if nothing else
        speaks against it.
    """
    study = config.convergence
    rows: dict[tuple[str, float], dict] = {}
    for comparison in compared:
        row = rows.setdefault(
            (comparison["material"], comparison["friction"]),
            {name: comparison[name] for name in ("material", "friction")}
            | {"time_step": None, "mesh": None},
        )
        key = comparison["kind"].replace(" ", "_")
        if row[key] is None:  # the first is the one at the chosen settings
            shifts = {name: event["shift_s"] for name, event in comparison["events"].items()}
            known = [abs(shift) for shift in shifts.values() if shift is not None]
            row[key] = {
                **{name: comparison[name] for name in SUMMARISED},
                "event_shift_s": max(known, default=0.0),
                "events_missing": [name for name, shift in shifts.items() if shift is None],
            }
    for row in rows.values():
        studied = [row[key] for key in ("time_step", "mesh") if row[key] is not None]
        within = all(kind["mean_largest_m"] <= study.mean_distance_m for kind in studied)
        # Within the demand as far as studied is not converged: the rest may speak against it.
        row["converged"] = None if within and len(studied) < 2 else within
    return list(rows.values())


def describe(config: Config, runs: Mapping[str, Trajectory]) -> dict[str, Any]:
    """The study as JSON can hold it: settings, runs and their cost, what is missing, comparisons.

    Raises
    ------
    BadInput
        No run is there, or runs do not belong together.
    """
    compared = comparisons(config, runs)
    here = [case for case in cases(config) if case.id in runs]
    if not here:
        raise BadInput(f"no runs of the study found; their ids look like {cases(config)[0].id}")
    chosen = runs[here[0].id].metadata
    return {
        "settings": {
            "convergence": config.convergence.model_dump(mode="json"),
            "time_step_s": chosen["step_s"],
            "simulation": chosen["settings"],
            "self_contact": chosen["settings"].get("self_contact"),
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
        "summary": summary(config, compared),
        "comparisons": compared,
    }
