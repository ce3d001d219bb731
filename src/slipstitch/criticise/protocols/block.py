"""What a protocol hands to the inference: features of runs, and what the model says of them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pandas as pd

from slipstitch.criticise.causes import Bench
from slipstitch.criticise.protocols.trace_noise import TraceNoise
from slipstitch.physics.friction_law import FrictionLaw

USUAL_AREA_M2 = 0.01  # where it was not recorded


@dataclass
class Block:
    """Features of one protocol; subclasses add :meth:`predict`.

    ``rows`` has one line a feature: run_id, specimen_id, quantity, measured value ``y``, its
    instrument uncertainty ``u``, ``lower_bound`` (the truth is at or above y), ``static`` and the
    covariates of :mod:`slipstitch.criticise.covariates` (NaN or '' where not recorded or not
    meaningful). In ``orientation_deg`` and ``azimuth_deg`` is the direction of the slide itself.
    """

    # What a prediction depends on: the coefficient of its friction law, and fields of the bench.
    COEFFICIENT: ClassVar[str] = "mu_face"
    READS: ClassVar[tuple[str, ...]] = tuple(field.name for field in fields(Bench))
    # Noise of the protocol's sensors as its traces tell it.
    trace_noises: ClassVar[tuple[TraceNoise, ...]] = ()

    protocol: str
    rows: pd.DataFrame

    def hours(self) -> np.ndarray:
        """(features,) time since the middle of the session; 0 where it was not recorded."""
        clock = self.rows["clock_min"].to_numpy(float) / 60.0
        known = np.isfinite(clock)
        if not known.any():
            return np.zeros(len(clock))
        return np.where(known, clock - 0.5 * (clock[known].min() + clock[known].max()), 0.0)

    def predict(self, law: FrictionLaw, bench: Bench) -> np.ndarray:
        """What the instrument would read, (features,), in the units of ``y``."""
        raise NotImplementedError


def covariates_of(table: pd.DataFrame, azimuth: str) -> pd.DataFrame:
    """The common covariates of a run table, in the columns of a block."""
    rows = pd.DataFrame({"run_id": table["run_id"], "specimen_id": table["specimen_id"]})
    rows["specimen_id"] = [
        specimen or f"(run {run})"
        for specimen, run in zip(table["specimen_id"], table["run_id"], strict=True)
    ]
    for name in ("pos_x_mm", "clock_min", "rh_pct", "repeat_index", "dwell_s", "orientation_deg"):
        rows[name] = table[name].to_numpy(float)
    rows["azimuth_deg"] = table[azimuth].to_numpy(float)
    rows["operator"] = table["operator"]
    rows["support"] = table.get("support", "")
    for name in ("load_ratio", "speed_mm_s", "length_mm", "height_mm"):
        rows[name] = np.nan
    return rows


def downhill_rad(bench: Bench, azimuth_deg: np.ndarray) -> np.ndarray:
    """Slope of the floor along lab azimuths; 0 where the azimuth is not recorded."""
    azimuth = np.radians(azimuth_deg)
    slope = bench.tilt_along_rad * np.cos(azimuth) + bench.tilt_across_rad * np.sin(azimuth)
    return np.where(np.isnan(azimuth), 0.0, slope)


def feature_rows(common: pd.DataFrame, lines: list[tuple]) -> tuple[np.ndarray, pd.DataFrame]:
    """Runs' numbers and rows of features from lines (number of the run, quantity, y, u).

    ``common`` has the columns that the features of a run share.
    """
    run = np.array([line[0] for line in lines])
    rows = common.iloc[run].reset_index(drop=True)
    rows["quantity"] = [line[1] for line in lines]
    rows["y"], rows["u"] = [line[2] for line in lines], [line[3] for line in lines]
    rows["lower_bound"] = False
    return run, rows


def conditions_of(rows: pd.DataFrame) -> dict[str, np.ndarray]:
    """Fields of a contact that every protocol's rows tell."""
    return {
        "direction_rad": np.radians(rows["orientation_deg"].to_numpy(float)),
        "repeats": rows["repeat_index"].to_numpy(float),
        "relative_humidity_pct": rows["rh_pct"].to_numpy(float),
    }


def sampled(value: np.ndarray, grid_step: np.ndarray, grid_point: np.ndarray) -> np.ndarray:
    """Mean reading of a slip at ``value`` that sampling puts in the middle of its grid cell.

    A saw tooth, smoothed by the scatter of slips (taken as 5 %); cells repeat from run to run, so
    without it the error would not average out.
    """
    step = np.where(grid_step > 0, grid_step, 1.0)
    blur = np.maximum(0.05 * np.abs(value) / step, 0.2)
    phase = 2 * np.pi * (value - grid_point) / step
    tooth = sum(
        np.exp(-2 * (np.pi * k * blur) ** 2) * np.sin(k * phase) / (np.pi * k) for k in range(1, 4)
    )
    return value + np.where(grid_step > 0, step * tooth, 0.0)
