"""(a) The inclined plane: the slope at which a loaded piece of cloth slips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipstitch.criticise.protocols import protocol
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact, FrictionLaw

LARGEST_ANGLE_RAD = np.radians(89.0)


def slip_angle_rad(law: FrictionLaw, weight_N: np.ndarray, contact: Contact) -> np.ndarray:
    """Slope alpha (n,) with ``W sin alpha = F(N = W cos alpha)``, static, at most 89 degrees.

    ``weight_N`` is of cloth and carrier; the load of ``contact`` is replaced.
    """
    weight_N = np.asarray(weight_N, dtype=float)
    slope = np.full(weight_N.shape, np.arctan(max(law.coefficient, 1e-9)))
    for _ in range(30):
        normal = weight_N * np.cos(slope)
        ratio = law.force_limit(contact.with_load(normal), static=True) / normal
        update = np.minimum(np.arctan(ratio), LARGEST_ANGLE_RAD)
        change = np.max(np.abs(update - slope), initial=0.0)
        slope = update
        if change < 1e-10:
            break
    return slope


@dataclass
class InclineBlock(protocol.Block):
    """Slip angles; ``contact`` and masses per row."""

    READS = ("mass_error", "tilt_along_rad", "tilt_across_rad", "angle_zero_rad")

    contact: Contact
    areal_mass_kg_m2: float
    area_m2: np.ndarray
    added_mass_kg: np.ndarray

    def predict(self, law, bench):
        mass = self.areal_mass_kg_m2 * (1 + bench.mass_error) * self.area_m2 + self.added_mass_kg
        slope = slip_angle_rad(law, mass * GRAVITY_M_S2, self.contact)
        tilt = protocol.downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float))
        # The protractor's base already falls by the tilt that way.
        return np.degrees(slope - tilt) + np.degrees(bench.angle_zero_rad)


def features(tables, nominal, measured) -> InclineBlock:
    """A slip angle a trial."""
    table = tables["incline"]
    rows = protocol.covariates_of(table, "azimuth_deg")
    rows["quantity"] = "angle_deg"
    rows["y"] = table["angle_deg"] if measured else np.nan
    rows["u"] = table["u_angle_deg"].to_numpy(float)
    rows["lower_bound"] = (table["censored"] > 0.5).to_numpy(bool) if measured else False
    rows["static"] = True
    area = table["area_cm2"].to_numpy(float) * 1e-4
    added = table["added_mass_g"].to_numpy(float) * 1e-3
    known = ~np.isnan(area) & ~np.isnan(added)
    area, added = np.where(np.isnan(area), protocol.USUAL_AREA_M2, area), np.nan_to_num(added)
    load = (nominal["rho_kg_m2"] * area + added) * GRAVITY_M_S2
    contact = Contact(
        normal_force_N=load,
        area_m2=area,
        dwell_s=rows["dwell_s"].to_numpy(float),
        **protocol.conditions_of(rows),
    )
    rows["load_ratio"] = np.where(known, contact.load_ratio(), np.nan)
    return InclineBlock("incline", rows, contact, nominal["rho_kg_m2"], area, added)


INCLINE = protocol.Protocol(
    "incline",
    "a",
    {
        "incline": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("azimuth_deg"),
            protocol.Column("area_cm2", 1e-3, 1e5, True, usual=50.0),
            protocol.Column("added_mass_g", 0, 1e5, True, usual=20.0),
            protocol.Column("angle_deg", -10, 90, measured=True),
            protocol.Column("u_angle_deg", 1e-4, 20, usual=0.3),
            protocol.Column("censored", 0, 1, measured=True),
        )
    },
    nominal=("rho_kg_m2",),
    quantities=(protocol.Quantity("angle_deg", "slip angle"),),
    features=features,
    varied=(
        ("added_mass_g", (0, 5, 20, 50, 200)),
        ("area_cm2", (12.5, 25, 50, 100)),
        ("dwell_s", (1, 10, 100, 1000)),
        ("orientation_deg", (0, 45, 90, 135, 180)),
        ("repeat_index", (0, 1, 2, 4, 8, 16)),
        ("rh_pct", (35, 50, 65)),
        ("azimuth_deg", (0, 90, 180, 270)),
    ),
)
