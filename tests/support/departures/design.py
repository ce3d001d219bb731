"""Designs of campaigns: which trials and runs are made, in which order."""

import numpy as np
import pandas as pd

PREFIX = {"incline": "a", "strip": "b", "drag": "c", "drop_drag": "d", "spring_slider": "e"}
LEVELS = {
    "orientation_deg": (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0),
    "dwell_s": (1.0, 3.0, 10.0, 30.0, 100.0),
    "azimuth_deg": (0.0, 90.0, 180.0, 270.0),
}
OWN_LEVELS = {
    "incline": {"area_cm2": (16.0, 36.0), "added_mass_g": (2.0, 8.0, 25.0, 60.0)},
    "strip": {
        "length_mm": (30.0, 42.0, 55.0),
        "width_mm": (15.0, 25.0),
        "ply": (1.0, 2.0, 3.0),
        "push_speed_mm_s": (0.2,),
    },
    "drag": {
        "area_cm2": (20.0, 45.0),
        "added_mass_g": (6.0, 15.0, 40.0),
        "speed_mm_s": (1.0, 3.0, 10.0, 30.0),
    },
    "drop_drag": {"height_mm": (45.0, 65.0, 90.0), "speed_mm_s": (3.0, 10.0, 25.0)},
    "spring_slider": {
        "area_cm2": (20.0, 45.0),
        "added_mass_g": (80.0, 150.0, 300.0),
        "spring_N_m": (60.0, 180.0),
        "speed_mm_s": (1.5, 4.0, 10.0),
    },
}
SIZES = {  # specimens, runs of each
    "incline": ((7, 11), (8, 12)),
    "strip": ((6, 9), (6, 9)),
    "drag": ((6, 9), (4, 6)),
    "drop_drag": ((5, 8), (3, 5)),
    "spring_slider": ((5, 7), (2, 4)),
}


def draw(rng, protocol, fixed=None, sort_by=None):
    """One table of runs, without measurements; columns as in the file.

    Parameters
    ----------
    fixed
        Column -> its only level, or its levels.
    sort_by
        A column whose levels follow each other in time, from the smallest on.
    """
    fixed = fixed or {}
    (few, many), (short, long) = SIZES[protocol]
    specimens, each = int(rng.integers(few, many + 1)), int(rng.integers(short, long + 1))
    n = specimens * each

    def column(name, levels):
        levels = np.atleast_1d(fixed.get(name, levels))
        return rng.permutation(np.resize(levels, n)).astype(float)

    slope = column("azimuth_deg", LEVELS["azimuth_deg"])
    table = {
        "run_id": [f"{PREFIX[protocol]}{i:03d}" for i in range(n)],
        "specimen_id": [f"{PREFIX[protocol].upper()}{i // each:02d}" for i in range(n)],
        "clock_min": np.cumsum(rng.uniform(0.5, 1.5, n)) * 150.0 / n,
        "repeat_index": np.tile(np.arange(each), specimens).astype(float),
        "orientation_deg": column("orientation_deg", LEVELS["orientation_deg"]),
        "dwell_s": column("dwell_s", LEVELS["dwell_s"]),
        "rh_pct": rng.uniform(35, 65, n) if "rh_pct" not in fixed else column("rh_pct", 50.0),
        "pos_x_mm": rng.uniform(0, 180, n).round(0),
        "operator": rng.choice(["ann", "ben"], n),
    }
    table["stage_azimuth_deg" if protocol not in ("incline", "strip") else "azimuth_deg"] = slope
    for name, levels in OWN_LEVELS[protocol].items():
        table[name] = column(name, levels)
    table = pd.DataFrame(table)
    if sort_by is not None and sort_by in table:
        table[sort_by] = np.sort(table[sort_by].to_numpy())
    return table


def rows_of(table, protocol, rho_kg_m2):
    """Columns in SI, as the models read them."""

    def get(name, default=0.0):
        return table[name].to_numpy(float) if name in table else np.full(len(table), default)

    rows = {
        "orientation_deg": get("orientation_deg"),
        "dwell_s": get("dwell_s"),
        "speed_mm_s": get("speed_mm_s", 10.0),
        "repeats": get("repeat_index"),
        "rh_pct": get("rh_pct"),
        "place_mm": get("pos_x_mm"),
        "clock_min": get("clock_min"),
        "operator": (table["operator"] == "ben").to_numpy().astype(int),
        "azimuth_deg": get("azimuth_deg" if "azimuth_deg" in table else "stage_azimuth_deg"),
        "area_m2": get("area_cm2") * 1e-4,
        "added_kg": get("added_mass_g") * 1e-3,
    }
    if protocol == "strip":
        rows |= {"length_m": get("length_mm") * 1e-3, "width_m": get("width_mm") * 1e-3}
        rows |= {"ply": get("ply")}
    if protocol == "drop_drag":
        rows["height_m"] = get("height_mm") * 1e-3
    if protocol == "spring_slider":
        rows["spring_N_m"] = get("spring_N_m")
        rows["mass_kg"] = rows["added_kg"] + rho_kg_m2 * rows["area_m2"]
    # The load of the run before, in the order of time; for laws that remember it.
    weight = (rows["added_kg"] + rho_kg_m2 * rows["area_m2"]) * 9.81
    if protocol == "strip":
        weight = 4e-3 * rows["ply"] * rows["width_m"] / 0.02
    if protocol == "drop_drag":
        weight = rho_kg_m2 * 9.81 * 0.1 / np.maximum(rows["height_m"] / 0.065, 0.1)
    rows["previous_load_N"] = np.concatenate([weight[:1], weight[:-1]])
    return rows
