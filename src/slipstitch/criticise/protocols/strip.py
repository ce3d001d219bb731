"""(b) The strip pushed on the substrate (Sano, Yamaguchi and Wada 2017), with its own weight."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from slipstitch.criticise.protocols import protocol
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact, FrictionLaw

RATIO_POINTS = np.linspace(0.0, 1.0, 41)


@cache
def _table():
    data = json.loads((Path(__file__).parent / "strip_table.json").read_text())
    weight = np.array(data["weight"])
    ratio, strain, load = (np.array(data[key]) for key in ("friction_ratio", "strain", "load"))
    largest = ratio[:, -1]
    # Strain grows as the square of the ratio: interpolate strain / ratio^2, which is smooth.
    smooth = np.empty((2, len(weight), len(RATIO_POINTS)))
    for i in range(len(weight)):
        u = ratio[i] / largest[i]
        curvature = strain[i] / u**2
        points = np.clip(RATIO_POINTS, u[0], 1.0)
        smooth[0, i] = make_interp_spline(u, curvature, k=3)(points)
        smooth[1, i] = make_interp_spline(u, load[i], k=3)(points)
    return (
        RectBivariateSpline(weight, RATIO_POINTS, smooth[0]),
        RectBivariateSpline(weight, RATIO_POINTS, smooth[1]),
        make_interp_spline(weight, largest, k=3),
        (weight[0], weight[-1]),
    )


def largest_weight_number() -> float:
    """Largest tabulated rho g L^3 / B."""
    return _table()[3][1]


def areal_contact(weight_number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Friction ratio and strain at which the foot lies flat (areal contact) without a slip."""
    curvature, _, largest, _ = _table()
    return largest(weight_number), curvature.ev(weight_number, 1.0)


def foot(weight_number: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertical strain and foot load (in B width / L^2) of a strip at a friction ratio Q/P.

    Beyond areal contact the strain goes on linearly: a latent value, for censored trials.
    """
    curvature, load, largest, (low, high) = _table()
    weight_number = np.clip(weight_number, low, high)
    u = np.maximum(ratio, 1e-6) / largest(weight_number)
    inside = np.minimum(u, 1.0)
    value = curvature.ev(weight_number, inside)
    slope = 2.0 * value + curvature.ev(weight_number, 1.0, dy=1)
    strain = np.where(u <= 1.0, value * inside**2, value + slope * (u - 1.0))
    return strain, load.ev(weight_number, inside)


def slip_strain(
    law: FrictionLaw,
    weight_number: np.ndarray,
    force_unit_N: np.ndarray,
    contact: Contact,
    tilt_downhill_rad: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Strain at which the foot slips: tan(atan(Q/P) + tilt) = F(P) / P.

    ``weight_number`` is rho g L^3 / B, ``force_unit_N`` B width / L^2; both (n,).
    """
    ratio = np.full(np.shape(weight_number), law.coefficient, dtype=float)
    for _ in range(12):
        _, load = foot(weight_number, ratio)
        normal = load * force_unit_N
        limit = law.force_limit(contact.with_load(normal), static=True) / normal
        update = np.tan(np.clip(np.arctan(limit) - tilt_downhill_rad, 0.0, 1.5))
        change = np.max(np.abs(update - ratio), initial=0.0)
        ratio = update
        if change < 1e-9:
            break
    return foot(weight_number, ratio)[0]


@dataclass
class StripBlock(protocol.Block):
    """Slip strains; the strip's stiffness, weight and edge per row."""

    COEFFICIENT = "mu_edge"
    READS = (
        "mass_error",
        "bending_error",
        "tilt_along_rad",
        "tilt_across_rad",
        "camera_scale",
        "strain_zero",
    )

    contact: Contact
    areal_mass_kg_m2: np.ndarray
    bending_Nm: np.ndarray
    length_m: np.ndarray
    width_m: np.ndarray

    def predict(self, law, bench):
        bending = self.bending_Nm * (1 + bench.bending_error)
        weight = self.areal_mass_kg_m2 * (1 + bench.mass_error) * GRAVITY_M_S2
        strain = slip_strain(
            law,
            weight * self.length_m**3 / bending,
            bending * self.width_m / self.length_m**2,
            self.contact,
            protocol.downhill_rad(bench, self.rows["azimuth_deg"].to_numpy(float)),
        )
        return strain * bench.camera_scale + bench.strain_zero


def features(tables, nominal, measured) -> StripBlock:
    """A strain at slip a trial; partial trials are lower bounds, never dropped."""
    table = tables["strip"]
    rows = protocol.covariates_of(table, "azimuth_deg")
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
        dwell_s=rows["dwell_s"].to_numpy(float),
        edge=True,
        **protocol.conditions_of(rows),
    )
    rows["load_ratio"] = contact.load_ratio()
    return StripBlock("strip", rows, contact, areal_mass, bending, length, width)


STRIP = protocol.Protocol(
    "strip",
    "b",
    {
        "strip": (
            *protocol.RUN_COLUMNS,
            protocol.azimuth("azimuth_deg"),
            protocol.Column("length_mm", 1, 1e4, usual=45.0),
            protocol.Column("width_mm", 0.1, 1e4, usual=12.0),
            protocol.Column("ply", 1, 100, usual=1.0),
            protocol.Column("push_speed_mm_s", 0, 1e4, True, usual=0.5),
            protocol.Column("eps_slip", -0.2, 1.0, measured=True),
            protocol.Column("u_eps", 1e-6, 0.5, usual=0.004),
            protocol.Column("regime", text=True, choices=("slipped", "partial"), measured=True),
        )
    },
    nominal=("rho_kg_m2", "B_strip_Nm", "ply_exponent", "thickness_m"),
    quantities=(protocol.Quantity("eps_slip", "slip strain"),),
    features=features,
    varied=(("length_mm", (30, 45, 60)),),
)
