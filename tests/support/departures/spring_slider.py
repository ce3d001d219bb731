"""A mass on a spring that is driven at constant speed: its motion, integrated in time."""

import numpy as np

from support.departures.laws import friction_limit


def motion(rows, coefficient, effects, loads, duration_s, sample_s, track=None, damping=0.0):
    """Force of the spring (N), sampled: shapes (samples,), (samples, runs).

    Symplectic Euler steps of a 160th of the shortest natural period. At rest until the drive
    exceeds what the contact bears (its age grows meanwhile), then kinetic friction of the drive's
    speed until the slider stops.

    Parameters
    ----------
    loads
        (normal load N, downhill pull towards +x N) of each run.
    damping
        Viscous damping ratio of the oscillator.
    """
    load, pull = loads
    mass, stiffness = rows["mass_kg"], rows["spring_N_m"]
    speed = rows["speed_mm_s"] * 1e-3
    rate = np.sqrt(stiffness / mass)
    every = max(1, int(np.ceil(sample_s * rate.max() * 160 / (2 * np.pi))))
    step = sample_s / every
    samples = int(duration_s / sample_s) + 1
    x, v = np.zeros(len(mass)), np.zeros(len(mass))
    stuck, rest = np.ones(len(mass), bool), rows["dwell_s"].astype(float)
    contact = rows | {"load_N": load}
    placed = track is not None or {"patch", "periodic"} & set(effects)
    ages = {"ageing", "dwell_peak"} & set(effects)

    def bearable(moving):
        values = contact | {"dwell_s": rest, "place_mm": rows["place_mm"] + 1e3 * x}
        force = friction_limit(values, coefficient, effects, moving)
        return force if track is None else force * track(values["place_mm"])

    static, kinetic = bearable(False), bearable(True)
    force = np.empty((samples, len(mass)))
    for i in range(samples * every):
        drive = stiffness * (speed * step * i - x) + pull
        if i % every == 0:
            force[i // every] = drive - pull
        if placed or ages:
            static = bearable(False)
            if placed:
                kinetic = bearable(True)
        stuck &= drive <= np.maximum(static, kinetic)
        push = (drive - kinetic - 2 * damping * mass * rate * v) / mass
        v = np.where(stuck, 0.0, v + step * push)
        stops = ~stuck & (v <= 0)
        v[stops] = 0.0
        stuck |= stops & (drive <= np.maximum(static, kinetic))
        x = x + step * v
        rest = np.where(stuck, np.where(stops, 0.0, rest + step), rest)
    return np.arange(samples) * sample_s, force


def levels(rows, coefficient, effects, loads, track=None):
    """(level, half swing) of steady stick-slip, mN: (runs, 2); energy balance of one slip.

    From the static limit with the relative speed V the spring's force swings about the kinetic
    level; the age of each stick is the time that the drive needs to load the spring again.
    """
    load, pull = loads
    contact = rows | {"load_N": load}
    speed = rows["speed_mm_s"] * 1e-3
    spots = rows["place_mm"]
    if track is not None or {"patch", "periodic"} & set(effects):
        spots = spots + np.linspace(0, 1, 41)[:, None] * rows["travel_mm"]
    shape = 1.0 if track is None else track(spots)

    def mean(values):
        values = values * shape
        return values.mean(axis=0) if values.ndim > 1 else values

    kinetic = mean(friction_limit(contact | {"place_mm": spots}, coefficient, effects, True))
    excess = kinetic / 2  # from above: of two balances of ageing, the one with stick-slip
    for _ in range(60):
        rest = 2 * excess / (rows["spring_N_m"] * speed)
        values = contact | {"dwell_s": rest, "place_mm": spots}
        static = mean(friction_limit(values, coefficient, effects, False))
        excess = np.maximum(static - kinetic, 0.0)
    swing = np.sqrt(excess**2 + speed**2 * rows["spring_N_m"] * rows["mass_kg"])
    return np.array([kinetic - pull, swing]).T * 1e3


def noise(rows, coefficient, loads, u_mN, grain):
    """Standard deviations of those two."""
    friction = coefficient * loads[0] * 1e3
    level = np.hypot(u_mN / 10, 0.3 * grain * friction)
    inertia = rows["speed_mm_s"] * np.sqrt(rows["spring_N_m"] * rows["mass_kg"])  # mN
    swing = np.sqrt((u_mN / 3) ** 2 + (0.3 * grain * friction) ** 2 + (0.15 * inertia) ** 2)
    return np.array([level, swing]).T
