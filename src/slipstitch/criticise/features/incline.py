"""(a) Features of inclined-plane trials: the slip angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.features.block import Block, covariates_of, downhill_rad
from slipstitch.criticise.forward.bench import STANDARD_GRAVITY_M_S2
from slipstitch.criticise.forward.incline import reading_deg, slip_angle_rad
from slipstitch.friction_law import Contact

USUAL_AREA_M2 = 0.01


@dataclass
class InclineBlock(Block):
    """Slip angles; ``contact`` and masses per row."""

    READS = ("mass_error", "tilt_along_rad", "tilt_across_rad")

    contact: Contact
    areal_mass_kg_m2: float
    area_m2: np.ndarray
    added_mass_kg: np.ndarray

    def predict(self, face, edge, bench):
        mass = self.areal_mass_kg_m2 * (1 + bench.mass_error) * self.area_m2 + self.added_mass_kg
        slope = slip_angle_rad(face, mass * STANDARD_GRAVITY_M_S2, self.contact)
        tilt = downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float))
        return reading_deg(slope, tilt)


def incline_block(table: pd.DataFrame, nominal: dict, measured: bool = True) -> InclineBlock:
    """Features of the table ``incline``."""
    rows = covariates_of(table, "azimuth_deg")
    rows["quantity"] = "angle_deg"
    rows["y"] = table["angle_deg"] if measured else np.nan
    rows["u"] = table["u_angle_deg"].to_numpy(float)
    rows["lower_bound"] = (table["censored"] > 0.5).to_numpy(bool) if measured else False
    rows["static"] = True
    area = table["area_cm2"].to_numpy(float) * 1e-4
    added = table["added_mass_g"].to_numpy(float) * 1e-3
    known = ~np.isnan(area) & ~np.isnan(added)
    area, added = np.where(np.isnan(area), USUAL_AREA_M2, area), np.nan_to_num(added)
    load = (nominal["rho_kg_m2"] * area + added) * STANDARD_GRAVITY_M_S2
    contact = Contact(
        normal_force_N=load,
        area_m2=area,
        direction_rad=np.radians(rows["orientation_deg"].to_numpy(float)),
        dwell_s=rows["dwell_s"].to_numpy(float),
        repeats=rows["repeat_index"].to_numpy(float),
        relative_humidity_pct=rows["rh_pct"].to_numpy(float),
    )
    rows["load_ratio"] = np.where(known, contact.load_ratio(), np.nan)
    return InclineBlock("incline", rows, contact, nominal["rho_kg_m2"], area, added)
