"""Friction limits: the laws that the verdict can name, and those that it cannot.

A contact is a mapping of arrays that broadcast against each other: ``load_N``, ``area_m2``,
``orientation_deg``, ``dwell_s``, ``speed_mm_s``, ``repeats``, ``rh_pct``, ``place_mm``,
``clock_min``, ``previous_load_N``, ``operator`` (0, 1, ...), and the flag ``edge``.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

GRAVITY_M_S2 = 9.81  # m/s^2

EVERY = ("incline", "strip", "drag", "drop_drag")
LOADED, SHEET, CELL, SLID = (
    ("incline", "drag"),
    ("drop_drag",),
    ("drag",),
    ("incline", "strip", "drag"),
)
PULLED = ("drag", "spring_slider")


@dataclass(frozen=True)
class Effect:
    """An effect, whose size is the parameter that is called like it.

    Attributes
    ----------
    reference
        A middling size.
    shows
        Protocols where it has something to show, one of which is always measured.
    smallest, largest, signed
        Sizes that are drawn, and whether they may be negative.
    column
        What drives it.
    details
        What it has besides its size: a middling value, the least and the largest one drawn.
    law
        (contact, parameters, moving) -> its share of the friction at a size of 1, where no verdict
        can name it.
    """

    reference: float
    shows: tuple
    smallest: float = 0.01
    largest: float = 0.45
    signed: bool = True
    column: str | None = None
    details: dict = field(default_factory=dict)
    law: Callable | None = None


def _patch(contact, values, moving):
    inside = np.abs(contact["place_mm"] - values["centre_mm"]) < values["width_mm"] / 2
    return inside.astype(float)


def _periodic(contact, values, moving):
    return np.sin(2 * np.pi * contact["place_mm"] / values["wavelength_mm"] + values["phase"])


def _memory(contact, values, moving):
    """What was pressed harder before has not yet recovered."""
    return np.tanh(np.log(contact["previous_load_N"] / contact["load_N"]))


def _stribeck(contact, values, moving):
    """A dip at one speed: no power and no logarithm of it."""
    if not moving:
        return 0.0
    octave = np.log(contact["speed_mm_s"] / values["dip_mm_s"]) / 0.7
    return 0.5 - np.exp(-0.5 * octave**2)


def _dwell_peak(contact, values, moving):
    if moving:
        return 0.0
    return np.exp(-0.5 * (np.log((contact["dwell_s"] + 0.3) / values["peak_s"]) / 0.8) ** 2)


def _outside(reference, shows, law, column=None, **details):
    return Effect(reference, shows, column=column, details=details, law=law)


EFFECTS = {
    "load_power": Effect(0.10, LOADED, 0.01, 0.3),
    "adhesion": Effect(3.0, LOADED, 0.2, 15.0, False),
    "static_kinetic": Effect(0.12, PULLED, 0.015, 0.6, False, "dwell_s"),
    "ageing": Effect(0.05, (*LOADED, "spring_slider"), 0.006, 0.25, False, "dwell_s"),
    "rate": Effect(0.08, PULLED, 0.01, 0.25),
    "anisotropy": Effect(0.08, EVERY, 0.01, 0.35),
    "nap": Effect(0.08, EVERY, 0.01, 0.35),
    "wear": Effect(0.12, EVERY, 0.02, 0.5, True, "repeat_index", {"wear_r0": (2.5, 1.0, 4.0)}),
    "humidity": Effect(0.04, EVERY, 0.005, 0.15, column="rh_pct"),
    "tilt": Effect(1.2, LOADED, 0.1, 5.0, False, details={"tilt_azimuth": (30.0, 0, 360)}),
    "mass_error": Effect(0.12, SHEET, 0.01, 0.4),
    "bending_error": Effect(0.3, SHEET, 0.04, 1.4),
    "backlash": Effect(0.6, CELL, 0.05, 4.0, False),
    "camera_scale": Effect(1.03, SHEET, 0.003, 0.12),
    "force_offset": Effect(2.0, CELL, 0.1, 20.0),
    "force_gain": Effect(0.05, CELL, 0.005, 0.25),
    "time_lag": Effect(0.12, SHEET, 0.01, 0.8, False),
    "patch": _outside(
        -0.15, EVERY, _patch, "pos_x_mm", centre_mm=(90.0, 40, 160), width_mm=(50.0, 25, 70)
    ),
    "periodic": _outside(
        0.08, SLID, _periodic, "pos_x_mm", wavelength_mm=(30.0, 10, 80), phase=(0.0, 0, 6.28)
    ),
    "memory": _outside(0.08, LOADED, _memory, "clock_min"),
    "operator_habit": _outside(
        0.12, EVERY, lambda c, v, moving: np.equal(c["operator"], 1) * 1.0, "operator"
    ),
    "threefold": _outside(
        0.10, EVERY, lambda c, v, moving: np.cos(3 * np.radians(c["orientation_deg"]))
    ),
    "oblique": _outside(
        0.10, EVERY, lambda c, v, moving: np.sin(2 * np.radians(c["orientation_deg"]))
    ),
    "stribeck": _outside(0.12, CELL, _stribeck, dip_mm_s=(3.0, 2, 12)),
    "thermal": _outside(
        0.10,
        EVERY,
        lambda c, v, moving: np.sin(2 * np.pi * c["clock_min"] / v["period_min"]),
        "clock_min",
        period_min=(90.0, 60, 140),
    ),
    "cleaning": _outside(
        0.12,
        EVERY,
        lambda c, v, moving: np.greater(c["clock_min"], v["moment_min"]) * 1.0,
        "clock_min",
        moment_min=(60.0, 50, 110),
    ),
    "load_step": _outside(
        0.12,
        LOADED,
        lambda c, v, moving: (c["load_N"] > v["threshold_Pa"] * c["area_m2"]) * 1.0,
        threshold_Pa=(40.0, 15, 90),
    ),
    "dwell_peak": _outside(0.10, SLID, _dwell_peak, "dwell_s", peak_s=(10.0, 5, 20)),
    "time_drift": _outside(
        0.10,
        (),
        lambda c, v, moving: c["clock_min"] / v["span_min"] - 0.5,
        "clock_min",
        span_min=(120.0,),  # always
    ),
}
LIBRARY = tuple(name for name, effect in EFFECTS.items() if effect.law is None)
OUTSIDE = tuple(name for name in EFFECTS if name not in (*LIBRARY, "time_drift"))


def details(rng, name):
    """What an effect has besides its size, drawn."""
    drawn = {k: ends for k, (_, *ends) in EFFECTS[name].details.items() if ends}
    return {
        k: np.exp(rng.uniform(*np.log(ends))) if k == "wavelength_mm" else rng.uniform(*ends)
        for k, ends in drawn.items()
    }


def scaled(name, share, **fixed):
    """Parameters of an effect ``share`` times as strong as the reference."""
    size = EFFECTS[name].reference
    size = 1 + share * (size - 1) if name == "camera_scale" else size * share
    return {name: size, **{k: v[0] for k, v in EFFECTS[name].details.items()}} | fixed


def share_of(name, values):
    """How strong an effect is, in units of the reference; signed."""
    none = 1.0 if name == "camera_scale" else 0.0
    return (values[name] - none) / (EFFECTS[name].reference - none)


def tilt_of(effects, azimuth_deg):
    """Tilt of the floor (deg), and the cosine between a direction and that in which it falls."""
    tilt = effects.get("tilt", {"tilt": 0.0, "tilt_azimuth": 0.0})
    return tilt["tilt"], np.cos(np.radians(azimuth_deg - tilt["tilt_azimuth"]))


def friction_limit(contact, coefficient, effects, moving):
    """Friction force that the contact can bear (``moving`` False) or exerts in motion, N."""
    load = np.asarray(contact["load_N"], float)
    direction = np.radians(contact["orientation_deg"])
    ratio = load / 2e-3 if contact.get("edge") else load / contact["area_m2"] / 50.0

    def size(name):
        return effects.get(name, {}).get(name, 0.0)

    force = coefficient * load
    if "load_power" in effects:
        force = force * np.power(np.maximum(ratio, 1e-9), size("load_power"))
    force = force * (1 + size("anisotropy") * np.cos(2 * direction))
    force = force * (1 + size("nap") * np.cos(direction))
    if "wear" in effects:
        worn = -np.expm1(-contact["repeats"] / effects["wear"]["wear_r0"])
        force = force * (1 + size("wear") * worn)
    force = force * (1 + size("humidity") * (contact["rh_pct"] - 50.0) / 10.0)
    if moving:
        force = force * (1 + size("rate") * np.log10(contact["speed_mm_s"] / 10.0))
    else:
        force = force * (1 + size("static_kinetic"))
        force = force * (1 + size("ageing") * np.log10(1 + contact["dwell_s"]))
    for name, values in effects.items():
        if callable(values):  # a law of one's own: a factor
            force = force * values(contact, moving)
        elif law := EFFECTS[name].law:
            force = force * (1 + values[name] * law(contact, values, moving))
    return force + size("adhesion") * contact["area_m2"]


class Track:
    """A substrate whose coefficient varies along it: a factor by place.

    ``kind``: ``smooth`` (three slow waves) or ``patchy`` (plateaus with sharp ends); ``size`` is
    the standard deviation of the factor. A slider on a spring makes 30 mm of way: its track has
    shorter waves.
    """

    def __init__(self, rng, kind, size, protocol="drag", span_mm=(-50.0, 400.0)):
        x = np.arange(*span_mm, 0.5)
        if kind == "smooth":
            waves = rng.uniform(*((12, 80) if protocol == "spring_slider" else (40, 250)), 3)
            y = sum(
                rng.normal() * np.sin(2 * np.pi * x / w + p)
                for w, p in zip(waves, rng.uniform(0, 6.28, 3), strict=True)
            )
        else:
            ends = np.cumsum(rng.uniform(8, 60, 100)) + span_mm[0]
            y = rng.normal(size=101)[np.searchsorted(ends, x)]
        self.x, self.y = x, 1 + size * (y - y.mean()) / y.std()

    def __call__(self, place_mm):
        return np.interp(place_mm, self.x, self.y)
