"""(d) Drop-and-drag: lag, scale, contact lengths, first motion and turn of a tracked cloth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd

from slipstitch.criticise.protocols import protocol
from slipstitch.criticise.protocols.dragged_cloth import rest_state, sliding_state, sticking_path
from slipstitch.criticise.traces import Signal, noise_of, off_neighbours
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact

# A stage that turns early stands still while its reading goes on.
TURN_MARGIN_MM = 5.0
MOTION_NOISES = 5.0
SURELY_STUCK_NOISES = MOTION_NOISES + 2.0
# What the forward model needs of a run, where its frames do not tell.
UNSEEN = {
    "stage_mm": 200.0,
    "turn_mm": np.nan,
    "threshold_mm": 0.0,
    "stuck_mm": np.zeros(0),
    "grid_step": 0.0,
    "grid_point": 0.0,
}
DESIGN_QUANTITIES = ("lag_mm", "contact_len_mm")


@dataclass
class DropDragBlock(protocol.Block):
    """Drop-and-drag features; ``run`` maps a feature to its run.

    ``runs`` has a line a run: height, azimuth, speed, and what :data:`UNSEEN` has.
    """

    READS = (
        "mass_error",
        "bending_error",
        "tilt_along_rad",
        "tilt_across_rad",
        "camera_scale",
        "time_lag_s",
        "stage_zero_m",
        "turn_early_m",
        "edge_zero_m",
        "contact_zero_m",
        "contact_scale_error",
        "contact_delay_s",
    )

    run: np.ndarray
    runs: pd.DataFrame
    at_rest: Contact
    in_motion: Contact
    areal_mass_kg_m2: float
    bending_Nm: float
    cloth_length_m: float

    def predict(self, law, bench):
        n, runs = len(self.runs), {name: own.to_numpy() for name, own in self.runs.items()}
        weight = np.full(n, self.areal_mass_kg_m2 * (1 + bench.mass_error) * GRAVITY_M_S2)
        bending = np.full(n, self.bending_Nm * (1 + bench.bending_error))
        length, height_m = np.full(n, self.cloth_length_m), 1e-3 * runs["height_mm"]
        tilt = protocol.downhill_rad(bench, runs["azimuth_deg"])
        fabric = (weight, bending, length, height_m)
        rest_distance, _ = rest_state(*fabric, tilt)
        distance, contact = sliding_state(law, *fabric, self.in_motion, False, tilt)
        slip_distance = distance
        if law.differs_at_rest:
            slip_distance, _ = sliding_state(law, *fabric, self.at_rest, True, tilt)
        lag = 1e3 * (distance - rest_distance)
        slip = np.maximum(1e3 * (slip_distance - rest_distance), lag)
        scale, late = bench.camera_scale, bench.time_lag_s * runs["speed_mm_s"]
        start_mm, edge_zero = 1e3 * bench.stage_zero_m, 1e3 * bench.edge_zero_m
        contact_zero = 1e3 * bench.contact_zero_m
        of_contact = 1e3 * scale * (1 + bench.contact_scale_error)
        late = np.where(np.isnan(late), 0.0, late) + start_mm
        edge_mm = scale * (runs["stage_mm"] - lag - late) + edge_zero
        turn_mm = runs["turn_mm"] - start_mm - 1e3 * bench.turn_early_m
        jump = (slip - lag) * scale
        values = {
            "lag_mm": runs["stage_mm"] - edge_mm,
            "edge_slope": np.full(n, scale),
            "contact_len_mm": of_contact * contact + contact_zero,
            "first_motion_mm": protocol.sampled(
                slip + late + np.maximum(runs["threshold_mm"] - jump, 0.0) / scale,
                runs["grid_step"],
                runs["grid_point"],
            ),
            "edge_at_turn_mm": scale * (turn_mm - lag) + edge_zero,
        }
        result = np.empty(len(self.rows))
        quantity = self.rows["quantity"].to_numpy()
        for name, value in values.items():
            here = quantity == name
            result[here] = value[self.run[here]]
        here = np.flatnonzero(quantity == "stuck_contact_mm")
        if len(here):
            behind = late + np.nan_to_num(bench.contact_delay_s * runs["speed_mm_s"])
            set_up, which = np.unique(
                np.column_stack([height_m, tilt.round(12)]), axis=0, return_inverse=True
            )
            fabric = weight[0], bending[0], self.cloth_length_m
            advance, flat = _sticking(*fabric, *set_up.T.ravel())
            for i in here:
                r = self.run[i]
                since = 1e-3 * np.maximum(runs["stuck_mm"][r] - behind[r], 0.0)
                stuck = np.interp(since, advance[which[r]], flat[which[r]])
                result[i] = of_contact * (stuck.sum() / len(stuck)) + contact_zero
        return result


@lru_cache(maxsize=4)
def _sticking(weight: float, bending: float, length: float, *heights_and_tilts: float):
    """The sticking path; derivatives ask for the same one again and again."""
    return sticking_path(weight, bending, length, *np.reshape(heights_and_tilts, (2, -1)))


def _frames(frames: pd.DataFrame, u: float, u_contact: float) -> tuple[dict, dict]:
    """Features of one run and the numbers that their forward model needs."""
    features: dict[str, tuple[float, float]] = {}
    setting = UNSEEN | {"threshold_mm": MOTION_NOISES * u}
    forward = frames[frames["phase"] == "fwd"].sort_values("x_stage_mm", kind="stable")
    x, te = forward["x_stage_mm"].to_numpy(), forward["te_x_mm"].to_numpy()
    contact = forward["contact_len_mm"].to_numpy()
    if len(x) < 6:
        return features, setting
    moved = te > MOTION_NOISES * u
    later = np.append(moved[1:], moved[-1])
    if not (moved & later).any():
        return features, setting
    first = int(np.argmax(moved & later))
    if first > 0:
        features["first_motion_mm"] = (
            0.5 * (x[first - 1] + x[first]),
            float(np.hypot((x[first] - x[first - 1]) / np.sqrt(12), u)),
        )
        # What is not yet seen to move may do so.
        stuck = x < min(x[first - 1] - SURELY_STUCK_NOISES * u, 0.8 * x[first])
        setting |= {"grid_step": x[first] - x[first - 1], "grid_point": x[first]}
        if stuck.any():
            setting["stuck_mm"] = x[stuck]
            features["stuck_contact_mm"] = (contact[stuck].mean(), u_contact / np.sqrt(stuck.sum()))
    steady = (x > x[first] + 0.15 * (x[-1] - x[first])) & (x < x[-1] - TURN_MARGIN_MM)
    if steady.sum() >= 4:
        xs, ts = x[steady], te[steady]
        centre = xs.mean()
        spread = float(((xs - centre) ** 2).sum())
        slope = float(((xs - centre) * (ts - ts.mean())).sum() / spread)
        setting["stage_mm"] = float(centre)
        features["lag_mm"] = (float(centre - ts.mean()), u / np.sqrt(len(xs)))
        features["edge_slope"] = (slope, u / np.sqrt(spread))
        features["contact_len_mm"] = (float(contact[steady].mean()), u_contact / np.sqrt(len(xs)))
        lag = centre - ts.mean()
        back = frames[frames["phase"] == "rev"].sort_values("x_stage_mm", kind="stable")[::-1]
        xb, tb = back["x_stage_mm"].to_numpy(), back["te_x_mm"].to_numpy()
        turn, turn_error = _turn(forward, back)
        early = (turn - xb > 4.0) & (turn - xb < 0.6 * lag)
        if early.any() and np.isfinite(turn_error):
            setting["turn_mm"] = turn
            features["edge_at_turn_mm"] = (
                float(tb[early].mean()),
                float(np.hypot(u / np.sqrt(early.sum()), turn_error)),
            )
    return features, setting


def _deviations(parts, runs, column: str, u_pos: np.ndarray) -> Iterator[np.ndarray]:
    """Deviations of a column from its neighbours on the way out, over the stated uncertainty."""
    for run, u in zip(runs, u_pos, strict=True):
        if run in parts:
            out = parts[run][parts[run]["phase"] == "fwd"].sort_values("x_stage_mm", kind="stable")
            yield off_neighbours(out["x_stage_mm"].to_numpy(), out[column].to_numpy()) / u


def _turn(forward: pd.DataFrame, back: pd.DataFrame) -> tuple[float, float]:
    """Where the stage turned and how well that is known: frames need not show the turn itself."""
    seen = float(forward["x_stage_mm"].max())
    if not len(back):
        return seen, np.inf
    seen = max(seen, float(back["x_stage_mm"].max()))
    every = np.concatenate([forward["x_stage_mm"], back["x_stage_mm"]])
    if np.sum(seen - every < 1e-6) > 2:  # it waited there, in view
        return seen, 0.0
    last, first = forward.iloc[-1], back.iloc[0]
    steps, times = np.diff(forward["x_stage_mm"]), np.diff(forward["t_s"])
    step, time = float(np.median(steps)), float(np.median(times))
    elapsed = first["t_s"] - last["t_s"]
    if not time > 0 or not 0 <= elapsed < 1.6 * time:
        return seen, np.inf
    crossing = 0.5 * (last["x_stage_mm"] + first["x_stage_mm"] + step / time * elapsed)
    # As well as the frames' clock tells how far the stage goes from one to the next.
    return float(max(crossing, seen)), 0.5 * float(np.std(steps - step / time * times))


def features(tables, nominal, measured) -> DropDragBlock | None:
    """Features of every run; without frames, the quantities of the design."""
    runs, frames = tables["drop_drag_runs"], tables.get("drop_drag") if measured else None
    common = protocol.covariates_of(runs, "stage_azimuth_deg")
    common["height_mm"] = runs["height_mm"].to_numpy(float)
    u_pos = runs["u_pos_mm"].to_numpy(float)
    lines, settings = [], []
    parts = dict(list(frames.groupby("run_id", sort=False))) if frames is not None else {}
    noises = tuple(
        noise_of(sensor, column, _deviations(parts, runs["run_id"], column, u_pos))
        for sensor, column in (("edge camera", "te_x_mm"), ("contact camera", "contact_len_mm"))
    )
    u_edge, u_contact = (u_pos * noise.allowance for noise in noises)
    for i, run in enumerate(runs["run_id"]):
        if frames is None:
            found = dict.fromkeys(DESIGN_QUANTITIES, (np.nan, u_pos[i] / 4))
            setting = UNSEEN
        else:
            found, setting = _frames(parts[run], u_edge[i], u_contact[i])
        settings.append(setting)
        lines += [(i, quantity, *value) for quantity, value in found.items()]
    if not lines:
        return None
    index, rows = protocol.feature_rows(common, lines)
    protocol.told_by(rows, rows["quantity"].to_numpy() == "first_motion_mm")
    contact = {"normal_force_N": np.nan, **protocol.conditions_of(common)}
    rows["load_ratio"] = nominal["rho_kg_m2"] * GRAVITY_M_S2 / 50.0
    block = DropDragBlock(
        "drop_drag",
        rows,
        index,
        common.join(pd.DataFrame(settings)),
        Contact(dwell_s=common["dwell_s"].to_numpy(float), **contact),
        Contact(speed_m_s=common["speed_mm_s"].to_numpy(float) * 1e-3, **contact),
        nominal["rho_kg_m2"],
        nominal["B_Nm"],
        nominal["cloth_length_m"],
    )
    block.trace_noises = noises
    return block


DROP_DRAG = protocol.Protocol(
    "drop_drag",
    "d",
    {
        "drop_drag_runs": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("stage_azimuth_deg"),
            protocol.Column("height_mm", 1, 1e4, usual=100.0),
            protocol.Column("speed_mm_s", 1e-6, 1e4, True, usual=10.0),
            protocol.Column("u_pos_mm", 1e-6, 1e3, usual=0.3),
        ),
        "drop_drag": (
            protocol.RUN_ID,
            protocol.Column("frame", 0, 1e9, True),
            protocol.Column("phase", text=True, choices=("fwd", "rev")),
            protocol.Column("t_s", -1e7, 1e7, True),
            protocol.Column("x_stage_mm", -1e5, 1e5),
            protocol.Column("te_x_mm", -1e5, 1e5),
            protocol.Column("contact_len_mm", -1e5, 1e5),
        ),
    },
    nominal=("rho_kg_m2", "B_Nm", "cloth_length_m"),
    quantities=(
        protocol.Quantity("lag_mm", "lag of the edge"),
        protocol.Quantity("edge_slope", "edge per stage", instrument=True),
        protocol.Quantity("contact_len_mm", "contact length"),
        protocol.Quantity("first_motion_mm", "first motion"),
        protocol.Quantity("stuck_contact_mm", "contact, stuck"),
        protocol.Quantity("edge_at_turn_mm", "edge at the turn"),
    ),
    features=features,
    signals=(
        Signal("te_x_mm", "edge camera", "u_pos_mm"),
        Signal("contact_len_mm", "contact camera", "u_pos_mm"),
    ),
    varied=(("height_mm", (70, 100, 130)), ("speed_mm_s", (3, 10, 30))),
)
