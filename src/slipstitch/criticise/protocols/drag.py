"""(c) Flat drag: what a force cell reads while a spring pulls a loaded piece of cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.protocols import protocol
from slipstitch.criticise.protocols.drag_trace import (
    DEPARTURE_NOISES,
    Feature,
    off_ramps,
    pooled_texture,
    sliding,
    trace_features,
)
from slipstitch.criticise.traces import Signal, TraceNoise, noise_of

PLATEAUS = ("force_plateau_mN", "force_back_plateau_mN")
SLIPS = ("force_first_slip_mN", "force_reversal_slip_mN")
# Features of the stroke back, and those of them whose force is the other way round.
RETURNING = ("lost_motion_mm", "force_reversal_slip_mN", "force_back_plateau_mN")
BACK = ("force_reversal_slip_mN", "force_back_plateau_mN")
DESIGN_QUANTITIES = ("force_plateau_mN", "force_first_slip_mN")


@dataclass
class DragBlock(protocol.LoadedBlock):
    """Drag features."""

    READS = (
        "mass_error",
        "tilt_along_rad",
        "tilt_across_rad",
        "backlash_m",
        "force_offset_N",
        "force_gain",
        "stage_zero_m",
        "force_delay_s",
        "force_drift_N_h",
    )

    threshold_N: np.ndarray
    grid_step: np.ndarray
    grid_point: np.ndarray
    ramp_mN: np.ndarray
    spring_mN_mm: float

    def predict(self, law, bench):
        quantity = self.rows["quantity"].to_numpy()
        load, rest, motion = self.pressed(bench)
        tilt = protocol.downhill_rad(bench, self.rows["stage_azimuth_deg"].to_numpy(float))
        direction = np.where(np.isin(quantity, BACK), -1.0, 1.0)

        def cell_reading(friction):
            along = direction * friction - load * np.sin(tilt)
            return 1e3 * ((1.0 + bench.force_gain) * along + bench.force_offset_N)

        moving = cell_reading(law.force_limit(motion, static=False))
        slipping = cell_reading(law.force_limit(rest, static=True))
        # A slider that starts below its kinetic friction is pulled on to it; a departure is seen
        # once the trace is the threshold below the line.
        slipping = direction * np.maximum(direction * slipping, direction * moving)
        drop = direction * (slipping - moving)
        seen = slipping + direction * np.maximum(1e3 * self.threshold_N - drop, 0)
        seen = protocol.sampled(seen, self.grid_step, self.grid_point)
        result = np.where(np.isin(quantity, PLATEAUS), moving, seen)
        relaxed = 1e3 * bench.force_offset_N + bench.force_gain * self.ramp_mN
        late_mm = bench.force_delay_s * 1e3 * np.nan_to_num(self.in_motion.speed_m_s)
        relaxed = relaxed - (1e3 * bench.stage_zero_m + late_mm) * self.spring_mN_mm
        result = np.where(quantity == "relaxed_mN", relaxed, result)
        result = result + 1e3 * bench.force_drift_N_h * self.hours()
        result = np.where(quantity == "stiffness", 1.0 + bench.force_gain, result)
        return np.where(quantity == "lost_motion_mm", 1e3 * bench.backlash_m + late_mm, result)


def _read(runs, traces, spring: float, u_mN: np.ndarray) -> tuple[list[tuple], TraceNoise]:
    """(run, quantity, feature) of every trace, and how noisy the traces are."""
    strokes = {
        (run, int(stroke)): part
        for (run, stroke), part in traces.groupby(["run_id", "stroke"], sort=False)
    }
    none = traces.iloc[:0]
    pairs = [(strokes.get((run, 0), none), strokes.get((run, 1), none)) for run in runs]
    of_ramps = [off_ramps(*pair) / u for pair, u in zip(pairs, u_mN, strict=True)]
    noise = noise_of("force cell", "force_mN", of_ramps, robust=False)
    u_mN = u_mN * noise.allowance
    lines, plateaus, steps = [], [], []
    for (out, _), u in zip(pairs, u_mN, strict=True):
        if not len(out):
            continue
        force, x = out["force_mN"].to_numpy(), out["x_stage_mm"].to_numpy()
        force = force[sliding(x, force, spring)]
        if len(force):
            plateaus.append((force, u, float(np.median(force))))
            steps.append(np.median(np.abs(np.diff(out["x_stage_mm"]))) if len(out) > 1 else 1)
    # Where readings come at odd times, the first one is not always that of the start.
    starts = [out["x_stage_mm"].iloc[0] for out, _ in pairs if len(out)]
    start = min(starts, default=None)
    turns = [
        max(part["x_stage_mm"].max() for part in p if len(part)) for p in pairs if any(map(len, p))
    ]
    turn = max(turns, default=None)
    if turn is not None and turn - np.median(turns) > np.median(steps or [0.0]):
        turn = None
    texture = pooled_texture(plateaus, float(np.median(steps)) if steps else 1.0)
    for i, (out, back) in enumerate(pairs):
        own = trace_features(out, back, spring, u_mN[i], texture, start, turn)
        lines += [(i, quantity, feature) for quantity, feature in own.items()]
    return lines, noise


def features(tables, nominal, measured) -> DragBlock | None:
    """Features of every run; without traces, the quantities of the design."""
    runs, traces = tables["drag_runs"], tables.get("drag") if measured else None
    common = protocol.covariates_of(runs, "stage_azimuth_deg")
    common["stage_azimuth_deg"] = runs["stage_azimuth_deg"].to_numpy(float)
    u, spring = runs["u_force_mN"].to_numpy(float), nominal["k_tether_N_m"]
    noises = ()
    if traces is None:
        lines = [(i, q, Feature(np.nan, u[i])) for i in range(len(runs)) for q in DESIGN_QUANTITIES]
    else:
        lines, noise = _read(runs["run_id"], traces, spring, u)
        u, noises = u * noise.allowance, (noise,)
    if not lines:
        return None
    found = [feature for _, _, feature in lines]
    lines = [(run, quantity, f.value, f.uncertainty) for run, quantity, f in lines]
    index, rows = protocol.feature_rows(common, lines)
    returning = rows["quantity"].isin(RETURNING).to_numpy()
    for name in ("orientation_deg", "azimuth_deg"):
        rows[name] = rows[name] + np.where(returning, 180.0, 0.0)
    reversal_dwell = nominal.get("reversal_dwell_s", np.nan)
    rows["dwell_s"] = np.where(returning, reversal_dwell, rows["dwell_s"])
    slipping = rows["quantity"].isin(SLIPS).to_numpy()
    block = DragBlock(
        "drag",
        rows,
        *protocol.loaded(runs, nominal, index, rows, slipping),
        DEPARTURE_NOISES * 1e-3 * u[index] * (0.0 if traces is None else 1.0),
        np.array([feature.grid_step for feature in found]),
        np.array([feature.grid_point for feature in found]),
        np.array([feature.ramp_mN for feature in found]),
        spring,
    )
    block.trace_noises = noises
    return block


DRAG = protocol.Protocol(
    "drag",
    "c",
    {
        "drag_runs": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("stage_azimuth_deg"),
            protocol.Column("area_cm2", 1e-3, 1e5, usual=100.0),
            protocol.Column("added_mass_g", 0, 1e5, usual=20.0),
            protocol.Column("speed_mm_s", 1e-6, 1e4, True, usual=10.0),
            protocol.Column("u_force_mN", 1e-6, 1e5, usual=0.3),
        ),
        "drag": (
            protocol.RUN_ID,
            protocol.Column("stroke", 0, 1),
            protocol.Column("t_s", -1e7, 1e7, True),
            protocol.Column("x_stage_mm", -1e5, 1e5),
            protocol.Column("v_mm_s", -1e4, 1e4, True),
            protocol.Column("force_mN", -1e7, 1e7),
        ),
    },
    nominal=("rho_kg_m2", "k_tether_N_m"),
    quantities=(
        protocol.Quantity("relaxed_mN", "relaxed reading", instrument=True),
        protocol.Quantity("stiffness", "loading slope", instrument=True),
        protocol.Quantity("force_first_slip_mN", "first slip"),
        protocol.Quantity("force_plateau_mN", "plateau"),
        protocol.Quantity("lost_motion_mm", "lost motion", instrument=True),
        protocol.Quantity("force_reversal_slip_mN", "slip at reversal"),
        protocol.Quantity("force_back_plateau_mN", "plateau back"),
    ),
    features=features,
    signals=(Signal("force_mN", "force cell", "u_force_mN"),),
    varied=(
        ("speed_mm_s", (1, 3, 10, 30)),
        ("added_mass_g", (0, 10, 30, 100)),
        ("area_cm2", (25, 50, 100, 200)),
        ("dwell_s", (1, 10, 100, 1000)),
        ("orientation_deg", (0, 45, 90, 135, 180)),
        ("stage_azimuth_deg", (0, 90, 180, 270)),
        ("repeat_index", (0, 1, 2, 4, 8, 16)),
    ),
)
