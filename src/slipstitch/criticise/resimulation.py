"""The measured drop-and-drag runs, simulated again in the cloth simulator with null and new law."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.stats import t as student

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import ZEROS
from slipstitch.criticise.inference.discrepancy import along
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.verdict import analyse
from slipstitch.criticise.verdict_data import extended_model, verdict_of
from slipstitch.physics.experiments.tracked_drag import DragRun, Sheet, TrackedShape, drag_tracked
from slipstitch.physics.friction_law import CONTACT_MECHANISMS, FrictionLaw
from slipstitch.physics.friction_law.extended_model import ExtendedModel, model_of

MODELS = ("null", "extended")
QUANTITIES = ("te_x_mm", "contact_len_mm")
MOST_FOLDS, FEWEST_SPECIMENS = 6, 3  # each specimen is left out once
ROWS, STEP_S = 161, 0.04
# Column of a run table, field of a simulated run, quantity of a contact, factor to SI.
CONDITIONS = (
    ("orientation_deg", "orientation_rad", "direction_rad", np.pi / 180),
    ("dwell_s", "dwell_s", "dwell_s", 1.0),
    ("repeat_index", "repeats", "repeats", 1.0),
    ("rh_pct", "relative_humidity_pct", "relative_humidity_pct", 1.0),
)


@dataclass
class Resimulation:
    """Measured and simulated shapes on the forward strokes.

    ``frames`` has a line a frame: run_id, specimen_id, x_stage_mm, the measured quantities, and
    ``<quantity>_null`` and ``<quantity>_extended``; ``summary`` is plain data.
    """

    frames: pd.DataFrame
    summary: dict


def resimulate(case: Case, verdict: dict, rows: int = ROWS) -> Resimulation:
    """Simulate every measured drop-and-drag run with the null law and with the verdict's.

    Runs that are the same to a law are simulated once. Raises BadInput where there are no such
    runs, NotConverged where a simulation could not be solved.
    """
    if "drop_drag" not in case.protocols:
        raise BadInput(f"{case.name}: no drop-and-drag runs to simulate")
    runs = case.tables["drop_drag_runs"]
    measured = case.tables["drop_drag"]
    measured = measured[measured["phase"] == "fwd"]
    measured = measured[measured["run_id"].isin(runs["run_id"])]
    plain = {name: extended_model(verdict, name) for name in MODELS}
    models = {name: model_of(data) for name, data in plain.items()}
    zeros = {
        name: _zeros(verdict, name if data["causes"] else "null") for name, data in plain.items()
    }
    parts = []
    done: dict[str, dict] = {name: {} for name in MODELS}
    for _, run in runs.iterrows():
        frames = measured[measured["run_id"] == run["run_id"]].copy()
        if not len(frames):
            continue
        frames["specimen_id"] = run["specimen_id"] or run["run_id"]
        frames["u_pos_mm"] = run["u_pos_mm"]
        for name, model in models.items():
            key = _run_of(run, model, float(measured["x_stage_mm"].max()))
            law = law_of_run(run, model, plain[name].get("discrepancy"))
            if (key, law.coefficient) not in done[name]:
                done[name][key, law.coefficient] = drag_tracked(
                    law, _sheet(case.nominal, model), key, rows, STEP_S, frame_rate_hz=5.0
                )
            seen = done[name][key, law.coefficient]
            readings = {**model.readings, **zeros[name]}
            _read_off(frames, seen, readings, run["speed_mm_s"], name)
        parts.append(frames)
    said = {
        "verdict": verdict["verdict"],
        "causes": verdict["models"]["extended"]["causes"],
        "simulations": {name: len(found) for name, found in done.items()},
    }
    return _together(case, parts, said, rows)


def _together(case: Case, parts: list[pd.DataFrame], said: dict, rows: int = ROWS) -> Resimulation:
    frames = pd.concat(parts, ignore_index=True)
    compared = {
        "quantities": {quantity: compare(frames, quantity) for quantity in QUANTITIES},
        "all": compare(frames, *QUANTITIES),
    }
    start = {"case": case.name, "rows": rows, "step_s": STEP_S}
    return Resimulation(frames, start | said | compared)


def resimulate_left_out(case: Case, seed: int, replicates: int) -> Resimulation | None:
    """As :func:`resimulate`, every run with models that its specimen had no part in.

    One specimen is left out at a time (a sixth of them where there are more than six) and the
    whole criticism, selection included, made anew from the others. None where there are too few.
    """
    runs, frames = case.tables["drop_drag_runs"], case.tables["drop_drag"]
    names = runs["specimen_id"].where(runs["specimen_id"] != "", runs["run_id"])
    specimens = list(dict.fromkeys(names))
    if len(specimens) < FEWEST_SPECIMENS:
        return None

    def part(of: pd.Series) -> Case:
        own = frames["run_id"].isin(runs["run_id"][of])
        tables = {"drop_drag_runs": runs[of], "drop_drag": frames[own]}
        tables = {name: table.reset_index(drop=True) for name, table in tables.items()}
        return replace(case, tables=case.tables | tables)

    shown, folds = [], []
    count = min(len(specimens), MOST_FOLDS)
    for k in range(count):
        left_out = names.isin(specimens[k::count])
        training = part(~left_out)
        analysis = analyse(assemble(training), seed, replicates)
        verdict = verdict_of(training, analysis, seed, "")
        again = resimulate(part(left_out), verdict)
        shown.append(again.frames)
        folds.append(
            {
                "left_out": specimens[k::count],
                "verdict": verdict["verdict"],
                "causes": verdict["models"]["extended"]["causes"],
                "simulations": again.summary["simulations"],
            }
        )
    return _together(case, shown, {"folds": folds})


def _sheet(nominal: dict, model: ExtendedModel) -> Sheet:
    return Sheet(
        nominal["rho_kg_m2"] * (1 + model.mass_error),
        nominal["B_Nm"] * (1 + model.bending_error),
        nominal["cloth_length_m"],
    )


def law_of_run(run: pd.Series, model: ExtendedModel, table: dict | None) -> FrictionLaw:
    """The model's law; a factor by place or time is that of the whole run."""
    if table is None or table["covariate"] not in ("pos_x_mm", "clock_min"):
        return model.law
    at = run[table["covariate"]]
    factor = float(along(table, at)) if np.isfinite(at) else 1.0
    return FrictionLaw(factor * model.law.coefficient, model.law.mechanisms)


def _run_of(run: pd.Series, model: ExtendedModel, furthest_mm: float) -> DragRun:
    """The run as far as a model asks for it; what it does not ask for has its default."""
    asked = {need for name in model.law.mechanisms for need in CONTACT_MECHANISMS[name].needs}
    asked |= {model.law.curve.quantity} if model.law.curve else set()
    known = {}
    for column, field, quantity, factor in CONDITIONS:
        if quantity in asked and np.isfinite(run[column]):
            known[field] = float(run[column]) * factor
    azimuth = np.radians(run["stage_azimuth_deg"])
    tilt = model.tilt_along_rad * np.cos(azimuth) + model.tilt_across_rad * np.sin(azimuth)
    speed = run["speed_mm_s"] if "speed_m_s" in asked else np.nan
    return DragRun(
        float(run["height_mm"]) * 1e-3,
        float(speed) * 1e-3 if np.isfinite(speed) else 0.02,
        furthest_mm * 1e-3 + 2e-3,
        tilt_downhill_rad=float(tilt) if np.isfinite(tilt) else 0.0,
        **known,
    )


def _zeros(verdict: dict, name: str) -> dict[str, float]:
    """What the sensors are off by where the model is right, in SI units.

    Model and zeros are estimated together: a length that the camera reads too large is otherwise
    taken for a stiffer cloth.
    """
    found = verdict["models"][name].get("zeros", {}).get("drop_drag", {})
    return {
        field: ZEROS[field].to_si * ZEROS[field].sd * value for field, (value, _) in found.items()
    }


def _read_off(
    frames: pd.DataFrame, shape: TrackedShape, readings: dict, speed_mm_s: float, name: str
) -> None:
    """What the cameras would have read at the frames' stage positions.

    ``readings`` are departures of the instruments: fields of
    :class:`slipstitch.criticise.causes.Bench`.
    """
    speed = speed_mm_s if np.isfinite(speed_mm_s) else 0.0
    late = readings.get("time_lag_s", 0.0) * speed + 1e3 * readings.get("stage_zero_m", 0.0)
    scale = readings.get("camera_scale", 1.0)
    of_contact = scale * (1 + readings.get("contact_scale_error", 0.0))
    later = late + readings.get("contact_delay_s", 0.0) * speed
    for quantity, values, factor, zero, behind in (
        ("te_x_mm", shape.edge_m, scale, "edge_zero_m", late),
        ("contact_len_mm", shape.contact_m, of_contact, "contact_zero_m", later),
    ):
        stage = np.maximum(frames["x_stage_mm"].to_numpy() - behind, 0.0)
        seen = np.interp(stage, 1e3 * shape.stage_m, 1e3 * values)
        frames[f"{quantity}_{name}"] = factor * seen + 1e3 * readings.get(zero, 0.0)


def compare(frames: pd.DataFrame, *quantities: str) -> dict:
    """Error of both models, and the gain: how much of the null's mean square error is gone.

    Its interval is that of the ratio's logarithm (jackknife over specimens): never above 1.
    """
    squares = {}
    for name in MODELS:
        errors = [
            (frames[f"{quantity}_{name}"] - frames[quantity]).to_numpy() for quantity in quantities
        ]
        squares[name] = np.mean(np.square(errors), axis=0)
    table = pd.DataFrame(squares).groupby(frames["specimen_id"].to_numpy()).mean()
    n = len(table)
    log_ratio = float(np.log(table["extended"].mean() / table["null"].mean()))
    interval = None
    if n > 1:
        others = (table.sum() - table) / (n - 1)
        left_out = np.log((others["extended"] / others["null"]).to_numpy())
        error = np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2))
        reach = student.ppf(0.975, n - 1) * error
        interval = [round(float(1 - np.exp(log_ratio + k * reach)), 4) for k in (1, -1)]
    return {
        "rmse_null_mm": round(float(np.sqrt(table["null"].mean())), 4),
        "rmse_extended_mm": round(float(np.sqrt(table["extended"].mean())), 4),
        "gain": round(1 - float(np.exp(log_ratio)), 4),
        "gain_ci95": interval,
        "specimens": n,
    }
