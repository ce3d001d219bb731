"""What a protocol hands to the inference: features of runs, and what the model says of them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pandas as pd

from slipstitch.criticise.forward.bench import Bench
from slipstitch.friction_law import FrictionLaw

COVARIATES = (
    "pos_x_mm",
    "clock_min",
    "rh_pct",
    "repeat_index",
    "dwell_s",
    "orientation_deg",
    "azimuth_deg",
    "load_ratio",
    "speed_mm_s",
    "operator",
    "length_mm",
    "height_mm",
)


@dataclass
class Block:
    """Features of one protocol; subclasses add :meth:`predict`.

    ``rows`` has one line a feature: run_id, specimen_id, quantity, measured value ``y``, its
    instrument uncertainty ``u``, ``lower_bound`` (the truth is at or above y), ``static`` and the
    covariates of :data:`COVARIATES` (NaN or '' where not recorded or not meaningful). In
    ``orientation_deg`` and ``azimuth_deg`` is the direction of the slide itself.
    """

    # What a prediction depends on: the face's law or the edge's, and fields of the bench.
    LAW: ClassVar[str] = "face"
    READS: ClassVar[tuple[str, ...]] = tuple(field.name for field in fields(Bench))

    protocol: str
    rows: pd.DataFrame

    def predict(self, face: FrictionLaw, edge: FrictionLaw, bench: Bench) -> np.ndarray:
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
    for name in ("load_ratio", "speed_mm_s", "length_mm", "height_mm"):
        rows[name] = np.nan
    return rows


def downhill_rad(bench: Bench, azimuth_deg: np.ndarray) -> np.ndarray:
    """Slope of the floor along lab azimuths; 0 where the azimuth is not recorded."""
    azimuth = np.radians(azimuth_deg)
    slope = bench.tilt_along_rad * np.cos(azimuth) + bench.tilt_across_rad * np.sin(azimuth)
    return np.where(np.isnan(azimuth), 0.0, slope)
