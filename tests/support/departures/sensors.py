"""Faults of instruments: what is drawn, and what they do to readings.

A fault is a mapping: ``protocol``, ``sensor``, ``quantity`` (column), ``kind``, ``size``, ``unit``.
None of them equals a mechanism that a verdict can name.
"""

import numpy as np

# protocol -> (sensor, column, kind, smallest, largest, unit, either sign?)
CATALOGUE = {
    "incline": (
        ("inclinometer", "angle_deg", "noise", 1.8, 3.0, "1", False),
        ("inclinometer", "angle_deg", "zero", 0.4, 1.2, "deg", True),
        ("inclinometer", "angle_deg", "scale", 0.02, 0.05, "1", True),
        ("inclinometer", "angle_deg", "tails", 3.0, 3.0, "1", False),
        ("inclinometer", "angle_deg", "outliers", 0.04, 0.08, "1", False),
        ("inclinometer", "angle_deg", "quantised", 0.5, 1.0, "deg", False),
    ),
    "strip": (
        ("camera", "eps_slip", "noise", 1.8, 3.0, "1", False),
        ("camera", "eps_slip", "zero", 0.006, 0.015, "1", True),
        ("camera", "eps_slip", "tails", 3.0, 3.0, "1", False),
        ("camera", "eps_slip", "outliers", 0.04, 0.08, "1", False),
        ("camera", "eps_slip", "quantised", 0.005, 0.01, "1", False),
    ),
    "drag": (
        ("force_cell", "force_mN", "noise", 1.8, 3.0, "1", False),
        ("force_cell", "force_mN", "drift", 1.5, 5.0, "mN", True),
        ("force_cell", "force_mN", "delay", 0.05, 0.2, "s", False),
        ("stage", "x_stage_mm", "zero", 0.7, 1.6, "mm", False),
        ("force_cell", "force_mN", "tails", 3.0, 3.0, "1", False),
        ("force_cell", "force_mN", "quantised", 0.5, 2.0, "mN", False),
        ("clock", "t_s", "dropped", 0.1, 0.35, "1", False),
        ("clock", "t_s", "irregular", 0.3, 0.5, "1", False),
    ),
    "drop_drag": (
        ("stage", "x_stage_mm", "zero", 0.7, 1.6, "mm", True),
        ("stage", "x_stage_mm", "turn", 2.0, 2.0, "mm", False),
        ("contact_camera", "contact_len_mm", "noise", 1.5, 2.5, "1", False),
        ("contact_camera", "contact_len_mm", "zero", 1.5, 4.0, "mm", True),
        ("contact_camera", "contact_len_mm", "scale", 0.02, 0.05, "1", True),
        ("contact_camera", "contact_len_mm", "delay", 0.2, 0.6, "s", False),
        ("edge_camera", "te_x_mm", "noise", 1.8, 3.0, "1", False),
        ("edge_camera", "te_x_mm", "tails", 3.0, 3.0, "1", False),
        ("edge_camera", "te_x_mm", "quantised", 0.5, 1.5, "mm", False),
        ("clock", "t_s", "dropped", 0.1, 0.35, "1", False),
        ("clock", "t_s", "irregular", 0.3, 0.5, "1", False),
    ),
    "spring_slider": (
        ("force_cell", "force_mN", "noise", 1.8, 3.0, "1", False),
        ("force_cell", "force_mN", "drift", 5.0, 20.0, "mN", True),
        ("force_cell", "force_mN", "tails", 3.0, 3.0, "1", False),
        ("force_cell", "force_mN", "quantised", 1.0, 3.0, "mN", False),
        ("clock", "t_s", "dropped", 0.1, 0.35, "1", False),
    ),
}
# Kinds that a criticism should report; the others it has only to bear.
REPORTABLE = ("noise", "zero", "scale", "drift", "delay", "turn")


def draw_fault(rng, protocol, entry):
    """One fault with its size."""
    sensor, column, kind, low, high, unit, signed = entry
    size = round(float(rng.uniform(low, high) * (rng.choice([-1, 1]) if signed else 1)), 5)
    fault = {"protocol": protocol, "sensor": sensor, "quantity": column, "kind": kind}
    return fault | {"size": size, "unit": unit}


def draw_faults(rng, protocols, how):
    """Faults of a campaign.

    ``three``: the stage's zero, its early turn and a noisier contact length of (d); ``one``: one
    reportable fault; ``several``: two to five of any kind.
    """
    if how == "three" and "drop_drag" in protocols:
        wanted = {("x_stage_mm", "zero"), ("x_stage_mm", "turn"), ("contact_len_mm", "noise")}
        entries = [e for e in CATALOGUE["drop_drag"] if (e[1], e[2]) in wanted]
        faults = [draw_fault(rng, "drop_drag", e) for e in entries]
        faults[-1]["size"] = 1.5
        return faults
    every = [(p, e) for p in protocols for e in CATALOGUE[p]]
    if how == "one":
        every = [(p, e) for p, e in every if e[2] in REPORTABLE]
    number = 1 if how == "one" else int(rng.integers(2, 6))
    chosen = rng.permutation(len(every))[:number]
    return [draw_fault(rng, *every[i]) for i in chosen]


def since_middle(clock_min):
    """Two hours since the middle of a session: a drift that is off on average is an offset."""
    return (clock_min - 75.0) / 120.0


class Faults:
    """The faults of one protocol, looked up by column and kind."""

    def __init__(self, faults, protocol):
        self.sizes = {
            (f["quantity"], f["kind"]): f["size"] for f in faults if f["protocol"] == protocol
        }

    def size(self, column, kind, default=0.0):
        return self.sizes.get((column, kind), default)

    def read(self, rng, column, exact, noise, clock_min=None):
        """Readings of exact values with ``noise`` (true standard deviation) and every fault."""
        sd = noise * self.size(column, "noise", 1.0)
        if self.size(column, "tails"):
            error = sd * rng.standard_t(3, exact.shape)
        else:
            error = sd * rng.normal(size=exact.shape)
        far = rng.uniform(size=exact.shape) < self.size(column, "outliers")
        error = np.where(far, rng.choice([-1, 1], exact.shape) * rng.uniform(6, 15) * sd, error)
        value = exact * (1 + self.size(column, "scale")) + self.size(column, "zero") + error
        drift = self.size(column, "drift")
        if drift and clock_min is not None:
            value = value + drift * since_middle(clock_min)
        pitch = self.size(column, "quantised")
        return np.round(value / pitch) * pitch if pitch else value

    def keep(self, rng, number):
        """Samples that were not dropped, in order: single ones and bursts."""
        share = self.size("t_s", "dropped")
        lost = rng.uniform(size=number) < share / 2
        length = max(1, int(number * share / 6))
        for start in rng.integers(0, number, 3 if share else 0):
            lost[start : start + length] = True
        lost[:2] = False
        return np.flatnonzero(~lost)

    def instants(self, rng, number, every):
        """Indices into a fine grid of ``number`` points, one each ``every``, regular or not."""
        index = np.arange(0, number, every)
        wander = self.size("t_s", "irregular")
        if wander:
            index = index + np.round(wander * every * rng.uniform(-1, 1, len(index))).astype(int)
        return np.unique(np.clip(index, 0, number - 1))


UNITS = (
    "angles_in_radians",
    "forces_in_N",
    "forces_flipped",
    "all_censored",
    "zero_forces",
    "zero_angles",
)


def wrong_units(name, tables):
    """Tables of a case as somebody with the wrong unit or sign would have written them."""
    tables = {k: v.copy() for k, v in tables.items()}
    if name == "angles_in_radians":
        for column in ("angle_deg", "u_angle_deg"):
            tables["incline"][column] = np.radians(tables["incline"][column])
        tables["incline"]["u_angle_deg"] = tables["incline"]["u_angle_deg"].clip(lower=1e-3)
    elif name == "all_censored":
        tables["incline"] = tables["incline"].assign(censored=1, angle_deg=60.0)
    elif name == "zero_angles":
        tables["incline"]["angle_deg"] = 0.0
    elif name == "forces_in_N":
        tables["drag"]["force_mN"] *= 1e-3
        tables["drag_runs"]["u_force_mN"] *= 1e-3
    elif name == "forces_flipped":
        tables["drag"]["force_mN"] *= -1
    elif name == "zero_forces":
        tables["drag"]["force_mN"] = 0.0
    else:
        raise ValueError(name)
    return tables
