"""The mechanisms of the contact: formulas and specific properties.

An entry of the table is everything that a further mechanism takes: protocols and fits evaluate its
formula with NumPy, and the cloth simulator evaluates a translation of the same source
(:mod:`slipstitch.physics.cloth.friction`). A formula is therefore one return statement with NumPy's
functions only.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from slipstitch.physics.friction_law.contact import (
    REFERENCE_DWELL_S,
    REFERENCE_HUMIDITY_PCT,
    REFERENCE_SPEED_M_S,
)
from slipstitch.physics.friction_law.mechanism import ContactMechanism, Parameter

LEAST_RATIO = 1.0e-9  # of the load to the reference: below, the power is cut off
# Below, the logarithm is cut off: a node's elastic microslip over a time step is of this size.
SLOWEST_M_S = 1.0e-5


def load_power_factor(load_power, load_ratio):
    """(p / p0)^m, p0 = 50 Pa; at an edge (N / 2 mN)^m (Howell; Bowden and Young: n = 1 + m)."""
    return np.maximum(load_ratio, LEAST_RATIO) ** load_power


def adhesion_added_force(adhesion, area_m2):
    """A shear stress times the apparent area, at no load (Bowden and Tabor)."""
    return adhesion * area_m2


def static_kinetic_static_factor(static_kinetic):
    """1 + e."""
    return 1.0 + static_kinetic


def ageing_static_factor(ageing, dwell_s):
    """1 + a log10(1 + t / 1 s) (Dieterich)."""
    return 1.0 + ageing * np.log10(1.0 + dwell_s / REFERENCE_DWELL_S)


def rate_kinetic_factor(rate, speed_m_s):
    """1 + b log10(v / 10 mm/s)."""
    return 1.0 + rate * np.log10(np.maximum(speed_m_s, SLOWEST_M_S) / REFERENCE_SPEED_M_S)


def anisotropy_factor(anisotropy, direction_rad):
    """1 + a cos 2 phi, the same forth and back."""
    return 1.0 + anisotropy * np.cos(2.0 * direction_rad)


def nap_factor(nap, direction_rad):
    """1 + a cos phi: sliding back has the other sign."""
    return 1.0 + nap * np.cos(direction_rad)


def wear_factor(wear, wear_r0, repeats):
    """1 + a (1 - exp(-r / r0)), r the slides before."""
    return 1.0 + wear * (1.0 - np.exp(-repeats / wear_r0))


def humidity_factor(humidity, relative_humidity_pct):
    """1 + a (RH - 50) / 10."""
    return 1.0 + humidity * (relative_humidity_pct - REFERENCE_HUMIDITY_PCT) / 10.0


_ENTRIES = (
    ContactMechanism(
        "load_power",
        "friction grows less (or more) than in proportion to the load",
        (Parameter("load_power", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="load_ratio",
        factor=load_power_factor,
    ),
    ContactMechanism(
        "adhesion",
        "part of the friction grows with the area, not the load",
        (Parameter("adhesion", "Pa", 0.0, 1.0, -30.0, 200.0),),
        covariate="load_ratio",
        added_force=adhesion_added_force,
    ),
    ContactMechanism(
        "static_kinetic",
        "static friction exceeds kinetic friction",
        (Parameter("static_kinetic", "1", 0.0, 0.1, 0.0, 3.0, kinked=True),),
        # Whether an excess at rest grows with the rest cannot be told without the rests.
        aliased_if_unrecorded="ageing",
        static_factor=static_kinetic_static_factor,
    ),
    ContactMechanism(
        "ageing",
        "static friction grows with the rest time before the pull",
        (Parameter("ageing", "1/decade", 0.0, 0.05, 0.0, 2.0, kinked=True),),
        covariate="dwell_s",
        static_factor=ageing_static_factor,
        unrecorded={"dwell_s": 0.0},
    ),
    ContactMechanism(
        "rate",
        "kinetic friction changes with the sliding speed",
        (Parameter("rate", "1/decade", 0.0, 0.05, -0.9, 0.9, kinked=True),),
        covariate="speed_mm_s",
        kinetic_factor=rate_kinetic_factor,
        unrecorded={"speed_m_s": REFERENCE_SPEED_M_S},
    ),
    ContactMechanism(
        "anisotropy",
        "friction along the warp differs from friction along the weft",
        (Parameter("anisotropy", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="orientation_deg",
        factor=anisotropy_factor,
        unrecorded={"direction_rad": np.pi / 4},
    ),
    ContactMechanism(
        "nap",
        "friction with the nap differs from friction against it",
        (Parameter("nap", "1", 0.0, 0.05, -0.9, 0.9),),
        covariate="orientation_deg",
        factor=nap_factor,
        unrecorded={"direction_rad": np.pi / 2},
    ),
    ContactMechanism(
        "wear",
        "friction changes with the number of slides of a specimen",
        (
            Parameter("wear", "1", 0.0, 0.1, -0.9, 3.0),
            Parameter("wear_r0", "slides", 3.0, 2.0, 0.3, 40.0, prior_sd=4.0),
        ),
        covariate="repeat_index",
        tested_at=({"wear_r0": 1.0}, {"wear_r0": 2.5}, {"wear_r0": 6.0}),
        starts=({"wear": 0.02, "wear_r0": 1.5}, {"wear": 0.02, "wear_r0": 5.0}),
        factor=wear_factor,
        unrecorded={"repeats": 0.0},
    ),
    ContactMechanism(
        "humidity",
        "friction changes with the humidity of the air",
        (Parameter("humidity", "1 per 10 % RH", 0.0, 0.05, -0.15, 0.15),),
        covariate="rh_pct",
        factor=humidity_factor,
        unrecorded={"relative_humidity_pct": REFERENCE_HUMIDITY_PCT},
    ),
)
CONTACT_MECHANISMS: Mapping[str, ContactMechanism] = MappingProxyType(
    {mechanism.identifier: mechanism for mechanism in _ENTRIES}
)
