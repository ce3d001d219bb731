"""Friction limits: the laws that the verdict can name, and those that it cannot.

A contact is a mapping of arrays that broadcast against each other: ``load_N``, ``area_m2``,
``orientation_deg``, ``dwell_s``, ``speed_mm_s``, ``repeats``, ``rh_pct``, ``place_mm``,
``clock_min``, ``previous_load_N``, ``operator`` (0, 1, ...), and the flag ``edge``.
"""

import numpy as np

GRAVITY_M_S2 = 9.81  # m/s^2

# Parameter values of a middling effect; sizes are scaled from these.
REFERENCE = {
    "load_power": {"load_power": 0.10},
    "adhesion": {"adhesion": 3.0},
    "static_kinetic": {"static_kinetic": 0.12},
    "ageing": {"ageing": 0.05},
    "rate": {"rate": 0.08},
    "anisotropy": {"anisotropy": 0.08},
    "nap": {"nap": 0.08},
    "wear": {"wear": 0.12, "wear_r0": 2.5},
    "humidity": {"humidity": 0.04},
    "tilt": {"tilt": 1.2, "tilt_azimuth": 30.0},
    "mass_error": {"mass_error": 0.12},
    "bending_error": {"bending_error": 0.3},
    "backlash": {"backlash": 0.6},
    "camera_scale": {"camera_scale": 1.03},
    "force_offset": {"force_offset": 2.0},
    "force_gain": {"force_gain": 0.05},
    "time_lag": {"time_lag": 0.12},
    "patch": {"patch": -0.15, "centre_mm": 90.0, "width_mm": 50.0},
    "periodic": {"periodic": 0.08, "wavelength_mm": 30.0, "phase": 0.0},
    "memory": {"memory": 0.08},
    "operator_habit": {"operator_habit": 0.12},
    "threefold": {"threefold": 0.10},
    "oblique": {"oblique": 0.10},
    "stribeck": {"stribeck": 0.12, "dip_mm_s": 3.0},
    "thermal": {"thermal": 0.10, "period_min": 90.0},
    "cleaning": {"cleaning": 0.12, "moment_min": 60.0},
    "load_step": {"load_step": 0.12, "threshold_Pa": 40.0},
    "dwell_peak": {"dwell_peak": 0.10, "peak_s": 10.0},
    "time_drift": {"time_drift": 0.10, "span_min": 120.0},
}
# The parameter that carries the size, the smallest and largest value drawn, and whether it may be
# negative.
BOUNDS = {
    "load_power": (0.01, 0.3, True),
    "adhesion": (0.2, 15.0, False),
    "static_kinetic": (0.015, 0.6, False),
    "ageing": (0.006, 0.25, False),
    "rate": (0.01, 0.25, True),
    "anisotropy": (0.01, 0.35, True),
    "nap": (0.01, 0.35, True),
    "wear": (0.02, 0.5, True),
    "humidity": (0.005, 0.15, True),
    "tilt": (0.1, 5.0, False),
    "mass_error": (0.01, 0.4, True),
    "bending_error": (0.04, 1.4, True),
    "backlash": (0.05, 4.0, False),
    "camera_scale": (0.003, 0.12, True),
    "force_offset": (0.1, 20.0, True),
    "force_gain": (0.005, 0.25, True),
    "time_lag": (0.01, 0.8, False),
}
LIBRARY = tuple(BOUNDS)
OUTSIDE = tuple(name for name in REFERENCE if name not in (*LIBRARY, "time_drift"))


def scaled(name, share, **fixed):
    """Parameters of an effect ``share`` times as strong as the reference."""
    values = dict(REFERENCE[name])
    if name == "camera_scale":
        values[name] = 1 + share * (values[name] - 1)
    else:
        values[name] *= share
    return values | fixed


def share_of(name, values):
    """How strong an effect is, in units of the reference; signed."""
    if name == "camera_scale":
        return (values[name] - 1) / (REFERENCE[name][name] - 1)
    return values[name] / REFERENCE[name][name]


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
    for name in effects:
        if callable(effects[name]):  # another bench's law: a factor
            force = force * effects[name](contact, moving)
        elif name in _BEYOND:
            force = force * (1 + size(name) * _BEYOND[name](contact, effects[name], moving))
    return force + size("adhesion") * contact["area_m2"]


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


_BEYOND = {
    "patch": _patch,
    "periodic": _periodic,
    "memory": _memory,
    "operator_habit": lambda c, v, moving: np.equal(c["operator"], 1) * 1.0,
    "threefold": lambda c, v, moving: np.cos(3 * np.radians(c["orientation_deg"])),
    "oblique": lambda c, v, moving: np.sin(2 * np.radians(c["orientation_deg"])),
    "stribeck": _stribeck,
    "thermal": lambda c, v, moving: np.sin(2 * np.pi * c["clock_min"] / v["period_min"]),
    "cleaning": lambda c, v, moving: np.greater(c["clock_min"], v["moment_min"]) * 1.0,
    "load_step": lambda c, v, moving: (c["load_N"] > v["threshold_Pa"] * c["area_m2"]) * 1.0,
    "dwell_peak": _dwell_peak,
    "time_drift": lambda c, v, moving: c["clock_min"] / v["span_min"] - 0.5,
}


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
