"""A block pushed over boards (Zhou 2015): near-translations as features for the inference."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from slipstitch.bench.gravity import GRAVITY_M_S2
from slipstitch.criticise.measurements import Measurements, measurements_of
from slipstitch.criticise.protocols.block import Block, downhill_rad
from slipstitch.errors import BadInput
from slipstitch.friction_law import Contact

BLOCK_MASS_KG = 1.518
LARGEST_TURN_DEG = 4.0
QUIET_S = 0.4


@dataclass
class PushBlock(Block):
    """Mean push force over the weight, in thousandths."""

    contact: Contact

    def predict(self, law, bench):
        weight = BLOCK_MASS_KG * GRAVITY_M_S2
        ratio = law.force_limit(self.contact, static=False) / weight
        tilt = downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float))
        return 1e3 * (ratio - np.sin(tilt))


def _yaw_deg(row: dict, end: str) -> float:
    w, x, y, z = (float(row[name + end]) for name in ("qw", "qx", "qy", "qz"))
    return float(np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))


def read_pushes(folder: Path) -> pd.DataFrame:
    """One line per push: force over weight, turn of the block, direction of motion, covariates.

    Raises
    ------
    BadInput
        If a file of the data set is missing.
    """
    index, arrays = folder / "index.csv", folder / "pushes.npz"
    for path in (index, arrays):
        if not path.exists():
            raise BadInput(f"{path}: missing; the push data set has index.csv and pushes.npz")
    force = np.load(arrays)["force"].astype(float)
    rows = []
    for row in csv.DictReader(index.open(encoding="utf-8")):
        start, count = int(row["force_start"]), int(row["force_n"])
        part = force[start : start + count]
        time, readings = part[:, 0], part[:, 1:] - part[part[:, 0] < QUIET_S, 1:].mean(axis=0)
        late = time > 0.5 * time[-1]
        size = np.hypot(*readings[late].T)
        move = [float(row[f"{axis}1_mm"]) - float(row[f"{axis}0_mm"]) for axis in "xy"]
        yaw = _yaw_deg(row, "0")
        turn = (_yaw_deg(row, "1") - yaw + 180.0) % 360.0 - 180.0
        heading = float(np.degrees(np.arctan2(move[1], move[0])))
        rows.append(
            {
                "run": row["run"],
                "surface": row["surface"],
                "support": row["support"],
                "push": int(row["push"]),
                "x_mm": float(row["x0_mm"]),
                "y_mm": float(row["y0_mm"]),
                "ratio": size.mean() / (BLOCK_MASS_KG * GRAVITY_M_S2),
                "unrest": size.std() / (BLOCK_MASS_KG * GRAVITY_M_S2),
                "turn_deg": turn,
                "moved_mm": float(np.hypot(*move)),
                "heading_deg": heading % 360,
                "in_block_deg": (heading - yaw) % 360,
            }
        )
    return pd.DataFrame(rows)


def measurements(pushes: pd.DataFrame) -> Measurements:
    """Near-translations as features: a log is the specimen, the support the 'operator'.

    The turn's effect on the force is even in the turn and enters as the covariate ``height_mm``
    does in no other protocol: not at all; large turns are left out instead.
    """
    kept = pushes[(pushes["turn_deg"].abs() < LARGEST_TURN_DEG) & (pushes["moved_mm"] > 4.0)]
    kept = kept.reset_index(drop=True)
    n = len(kept)
    rows = pd.DataFrame(
        {
            "protocol": "push",
            "run_id": kept["run"] + "/" + kept["push"].astype(str),
            "specimen_id": kept["run"],
            "pos_x_mm": kept["x_mm"],
            "clock_min": np.nan,
            "rh_pct": np.nan,
            "repeat_index": kept["push"].astype(float),
            "dwell_s": np.nan,
            "orientation_deg": kept["in_block_deg"],
            "azimuth_deg": kept["heading_deg"],
            "operator": np.where(kept["support"] == "patch", "whole face", "three points"),
            "load_ratio": np.nan,
            "speed_mm_s": np.nan,
            "length_mm": np.nan,
            "height_mm": np.nan,
            "quantity": "push_over_weight",
            "y": 1e3 * kept["ratio"],
            "u": 1e3 * kept["unrest"] / np.sqrt(10.0),
            "lower_bound": False,
            "static": False,
        }
    )
    contact = Contact(
        normal_force_N=np.full(n, BLOCK_MASS_KG * GRAVITY_M_S2),
        direction_rad=np.radians(kept["in_block_deg"].to_numpy()),
        repeats=kept["push"].to_numpy(float),
    )
    return measurements_of([PushBlock("push", rows, contact)])


def by_surface_and_support(pushes: pd.DataFrame) -> pd.DataFrame:
    """Mean, scatter and count of the near-translations in every cell."""
    kept = pushes[(pushes["turn_deg"].abs() < LARGEST_TURN_DEG) & (pushes["moved_mm"] > 4.0)]
    table = kept.groupby(["surface", "support"])["ratio"].agg(["mean", "std", "count"])
    return table.reset_index()
