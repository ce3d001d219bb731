"""(b) Features of pushed strips: the vertical strain at slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from slipstitch.criticise.features.block import Block, covariates_of, downhill_rad
from slipstitch.criticise.forward.bench import STANDARD_GRAVITY_M_S2
from slipstitch.criticise.forward.strip import slip_strain
from slipstitch.friction_law import Contact


@dataclass
class StripBlock(Block):
    """Slip strains; the strip's stiffness, weight and edge per row."""

    LAW = "edge"
    READS = ("mass_error", "bending_error", "tilt_along_rad", "tilt_across_rad", "camera_scale")

    contact: Contact
    areal_mass_kg_m2: np.ndarray
    bending_Nm: np.ndarray
    length_m: np.ndarray
    width_m: np.ndarray

    def predict(self, face, edge, bench):
        bending = self.bending_Nm * (1 + bench.bending_error)
        weight = self.areal_mass_kg_m2 * (1 + bench.mass_error) * STANDARD_GRAVITY_M_S2
        strain = slip_strain(
            edge,
            weight * self.length_m**3 / bending,
            bending * self.width_m / self.length_m**2,
            self.contact,
            downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float)),
        )
        return strain * bench.camera_scale


def strip_block(table: pd.DataFrame, nominal: dict, measured: bool = True) -> StripBlock:
    """Features of the table ``strip``; partial trials are lower bounds, never dropped."""
    rows = covariates_of(table, "azimuth_deg")
    rows["quantity"] = "eps_slip"
    rows["y"] = table["eps_slip"] if measured else np.nan
    rows["u"] = table["u_eps"].to_numpy(float)
    rows["lower_bound"] = (table["regime"] == "partial").to_numpy(bool) if measured else False
    rows["static"] = True
    rows["length_mm"] = table["length_mm"].to_numpy(float)
    ply = table["ply"].to_numpy(float)
    length, width = table["length_mm"].to_numpy(float) * 1e-3, table["width_mm"].to_numpy() * 1e-3
    areal_mass = nominal["rho_kg_m2"] * ply
    bending = nominal["B_strip_Nm"] * ply ** nominal["ply_exponent"]
    contact = Contact(
        normal_force_N=22.0 * bending * width / length**2,
        area_m2=width * nominal["thickness_m"],
        direction_rad=np.radians(rows["orientation_deg"].to_numpy(float)),
        dwell_s=rows["dwell_s"].to_numpy(float),
        repeats=rows["repeat_index"].to_numpy(float),
        relative_humidity_pct=rows["rh_pct"].to_numpy(float),
        edge=True,
    )
    rows["load_ratio"] = contact.load_ratio()
    return StripBlock("strip", rows, contact, areal_mass, bending, length, width)
