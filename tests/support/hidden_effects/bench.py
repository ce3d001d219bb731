"""A simulated bench: draws a design, hides an effect, writes the case folder.

``make_case(seed, kind, folder)`` returns the truth. Laws and elasticas are those of the bench of
departures, drags and stick-slip are stepped here: nothing is of the package, so that a mistake in
the package cannot cancel.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from support.departures.campaign import write_case
from support.departures.design import rows_of
from support.departures.drop_drag import Cloth
from support.departures.incline import slip_angle_deg
from support.departures.laws import LIBRARY, friction_limit, tilt_of
from support.departures.strip import slip_strain
from support.hidden_effects.slider_bench import G, spring_slider

OUTSIDE = ("patch", "thermal_cycle", "threefold", "load_bump", "operator", "dwell_peak")
NEEDS_PROTOCOL = {
    "backlash": ("drag",),
    "force_offset": ("drag",),
    "force_gain": ("drag",),
    "time_lag": ("drop_drag",),
    "camera_scale": ("drop_drag",),
    "rate": ("drag", "drop_drag"),
    "static_kinetic": ("drag",),
    "mass_error": ("drag",),
    "bending_error": ("drop_drag", "strip"),
}


def draw_effect(rng, name):
    """Parameters of one effect, of a size between hardly visible and plain."""
    sign = rng.choice([-1, 1])
    size = np.exp(rng.uniform(np.log(0.25), np.log(1.6)))
    table = {
        "load_power": {"load_power": -0.15 * size},
        "adhesion": {"adhesion": 4.0 * size},
        "static_kinetic": {"static_kinetic": 0.2 * size},
        "ageing": {"ageing": 0.08 * size},
        "rate": {"rate": sign * 0.1 * size},
        "anisotropy": {"anisotropy": sign * 0.1 * size},
        "nap": {"nap": sign * 0.1 * size},
        "wear": {"wear": sign * 0.2 * size, "r0": rng.uniform(1.5, 6)},
        "humidity": {"humidity": sign * 0.08 * size},
        "tilt": {"tilt": 1.5 * size, "azimuth": rng.uniform(0, 360)},
        "mass_error": {"mass_error": sign * 0.15 * size},
        "bending_error": {"bending_error": float(np.exp(sign * 0.6 * size) - 1)},
        "backlash": {"backlash": 0.6 * size},
        "camera_scale": {"camera_scale": 1 + sign * 0.04 * size},
        "force_offset": {"force_offset": sign * 2.0 * size},
        "force_gain": {"force_gain": sign * 0.08 * size},
        "time_lag": {"time_lag": 0.3 * size},
        "patch": {"size": sign * 0.2 * size, "at": rng.uniform(40, 160), "width": 18.0},
        "thermal_cycle": {
            "size": 0.12 * size,
            "period": rng.uniform(25, 60),
            "phase": rng.uniform(0, 6.3),
        },
        "threefold": {"size": 0.12 * size, "phase": rng.uniform(0, 6.3)},
        "load_bump": {"size": sign * 0.25 * size, "at": rng.uniform(0.3, 1.2), "width": 0.35},
        "operator": {"size": sign * 0.15 * size},
        "dwell_peak": {"size": 0.25 * size, "at": rng.uniform(0.8, 2.0), "width": 0.35},
    }
    return table[name]


def _outside(name, e):
    """The factor (contact, moving) of a law that no library holds, along one covariate."""

    def bump(x):
        return 1 + e["size"] * np.exp(-0.5 * ((x - e["at"]) / e["width"]) ** 2)

    def ratio(c):
        return c["load_N"] / 2e-3 if c.get("edge") else c["load_N"] / c["area_m2"] / 50.0

    def wave(angle):
        return 1 + e["size"] * angle

    def smooth(c, moving):  # planted only: any law along one covariate
        along = {"pos_x_mm": c["run_place_mm"], "clock_min": c["clock_min"]}
        along |= {"load_ratio": ratio(c), "speed_mm_s": c["speed_mm_s"]}
        return 1.0 if e["along"] == "speed_mm_s" and not moving else e["law"](along[e["along"]])

    return {
        "patch": lambda c, moving: bump(c["run_place_mm"]),
        "thermal_cycle": lambda c, moving: wave(
            np.sin(2 * np.pi * c["clock_min"] / e["period"] + e["phase"])
        ),
        "threefold": lambda c, moving: wave(
            np.cos(3 * np.radians(c["orientation_deg"]) + e["phase"])
        ),
        "load_bump": lambda c, moving: bump(np.log10(50 * ratio(c))),
        "operator": lambda c, moving: wave(np.equal(c["operator"], 1)),
        "dwell_peak": lambda c, moving: 1.0 if moving else bump(np.log10(1 + c["dwell_s"])),
        "smooth": smooth,
    }[name]


class World:
    """Friction, fabric and instruments with the hidden effects, for the bench of departures."""

    def __init__(self, effects, nominal, mu_face, mu_edge):
        named = {"r0": "wear_r0", "azimuth": "tilt_azimuth"}
        self.effects = {
            name: {named.get(key, key): value for key, value in values.items()}
            if name in LIBRARY
            else _outside(name, values)
            for name, values in effects.items()
        }
        self.nominal, self.mu_face, self.mu_edge = nominal, mu_face, mu_edge

    def get(self, name, default=0.0):
        return self.effects.get(name, {}).get(name, default)

    @property
    def rho(self):
        return self.nominal["rho_kg_m2"] * (1 + self.get("mass_error"))

    def rows(self, table, protocol):
        """The runs in SI."""
        names = table["operator"].map({"A": "ann", "B": "ben"})
        own = table.assign(rh_pct=table["true_rh"], operator=names)
        rows = rows_of(own, protocol, self.nominal["rho_kg_m2"])
        return rows | {"run_place_mm": rows["place_mm"], "scatter": table["scatter"].to_numpy()}

    def friction(self, row, load, moving, **changes):
        """Of one run under a load, N."""
        contact = row | {"load_N": load} | changes
        return friction_limit(contact, self.mu_face * row["scatter"], self.effects, moving)

    def downhill(self, azimuth_deg):
        tilt, towards = tilt_of(self.effects, azimuth_deg)
        return np.radians(tilt) * towards


def _each(rows):
    """Every run's own values."""
    for i in range(len(rows["scatter"])):
        yield {name: values[i] for name, values in rows.items()}


def _common(rng, letter, specimens, trials, noise, options):
    rows = []
    clock = rng.uniform(0, 5)
    rh_level, rh_swing = rng.uniform(42, 58), rng.uniform(3, 9)
    phase = rng.uniform(0, 6.3)
    for s in range(specimens):
        level = np.exp(noise["specimen"] * rng.standard_normal())
        cut = rng.choice([0, 45, 90, 135, 180, 270])
        for r in range(trials):
            clock += rng.uniform(1.5, 4)
            outlier = rng.random() < noise["outliers"]
            extra = np.exp(rng.choice([-1, 1]) * rng.uniform(0.2, 0.45))
            extra = extra if outlier and noise["run"] > 0 else 1.0
            humidity = rh_level + rh_swing * np.sin(clock / 40 + phase) + rng.normal(0, 2.5)
            if options["orientation"] == "trial":
                cut = rng.choice([0, 30, 45, 60, 90, 120, 135, 180, 210, 270, 300])
            elif options["orientation"] == "two":
                cut = rng.choice([0, 90])
            rows.append(
                {
                    "run_id": f"{letter}{len(rows):03d}",
                    "specimen_id": f"{letter.upper()}{s}",
                    "clock_min": round(clock, 2),
                    "repeat_index": r,
                    "orientation_deg": float(cut) if options["orientation"] != "fixed" else 0.0,
                    "dwell_s": float(rng.choice([1, 3, 10, 30, 100, 300])),
                    "true_rh": humidity,
                    "rh_pct": round(humidity + rng.normal(0, 0.7), 2),
                    "pos_x_mm": round(rng.uniform(0, 200), 1),
                    "operator": str(rng.choice(["A", "B"])),
                    "scatter": level * np.exp(noise["run"] * rng.standard_normal()) * extra,
                    "outlier": outlier,
                }
            )
    table = pd.DataFrame(rows)
    if options["dwell"] == "reversal":
        table["dwell_s"] = options["reversal_dwell_s"]
    keep = rng.random(len(table)) > options["unbalance"]
    keep[:3] = True
    return table[keep].reset_index(drop=True)


def _incline(rng, world, noise, options, switch):
    table = _common(rng, "a", rng.integers(6, 12), rng.integers(4, 7), noise, options)
    n = len(table)
    table["azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    area = rng.choice([25.0, 50.0, 100.0], n) if options["area"] != "fixed" else np.full(n, 50.0)
    table["area_cm2"] = area
    masses = [0.0, 5.0, 20.0, 50.0, 200.0] if options["load"] == "varied" else [5.0, 50.0]
    table["added_mass_g"] = rng.choice(masses, n)
    rows = world.rows(table, "incline")
    coefficient = world.mu_face * rows["scatter"]
    true = slip_angle_deg(rows, coefficient, world.effects, world.nominal["rho_kg_m2"])
    u = noise["u_angle"]
    reading = true + switch * u * noise["understated"] * rng.standard_normal(n)
    table["censored"] = (reading > 60).astype(int)
    table["angle_deg"] = np.where(reading > 60, 60.0, reading).round(3)
    table["u_angle_deg"] = u
    return {"incline": table}


def _strip(rng, world, noise, options, switch):
    table = _common(rng, "b", rng.integers(6, 12), rng.integers(3, 6), noise, options)
    n = len(table)
    table["azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    table["length_mm"] = rng.choice([30.0, 45.0, 60.0], n)
    table["width_mm"] = rng.choice([8.0, 12.0, 16.0], n)
    table["ply"] = rng.choice([1.0, 2.0], n)
    table["push_speed_mm_s"] = 0.5
    rows = world.rows(table, "strip")
    rows["area_m2"] = rows["width_m"] * world.nominal["thickness_m"]
    coefficient = world.mu_edge * rows["scatter"]
    strain, slipped = slip_strain(rows, coefficient, world.effects, world.nominal)
    u = noise["u_eps"]
    reading = strain + switch * u * noise["understated"] * rng.standard_normal(n)
    table["eps_slip"] = reading.round(5)
    table["u_eps"] = u
    table["regime"] = np.where(slipped, "slipped", "partial")
    return {"strip": table}


def _drag(rng, world, noise, options, switch):
    table = _common(rng, "c", rng.integers(5, 9), rng.integers(3, 6), noise, options)
    n = len(table)
    table["stage_azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    table["area_cm2"] = rng.choice([50.0, 100.0, 200.0], n) if options["area"] != "fixed" else 100.0
    table["added_mass_g"] = rng.choice([0.0, 10.0, 30.0, 100.0], n)
    table["speed_mm_s"] = rng.choice([1.0, 3.0, 10.0, 30.0], n)
    table["u_force_mN"] = noise["u_force"]
    spring = world.nominal["k_tether_N_m"]
    step, reach = 0.1, 40.0
    rho = np.exp(-step / noise["texture_length"])
    gain, offset = 1 + world.get("force_gain"), world.get("force_offset")
    lost = world.get("backlash")
    traces = []
    for run_id, row in zip(table["run_id"], _each(world.rows(table, "drag")), strict=True):
        load = (world.rho * row["area_m2"] + row["added_kg"]) * G
        slope = 1e3 * load * np.sin(world.downhill(row["azimuth_deg"]))
        points = round(reach / step) + 1
        texture = np.empty(points)
        texture[0] = rng.standard_normal()
        for j in range(1, points):
            texture[j] = rho * texture[j - 1] + np.sqrt(1 - rho**2) * rng.standard_normal()
        texture = 1 + switch * noise["texture"] * texture
        pull, x = 0.0, np.linspace(0, reach, points)
        for stroke, direction in ((0, 1), (1, -1)):
            if stroke:
                row["orientation_deg"] += 180.0
                row["dwell_s"] = world.nominal["reversal_dwell_s"]
            peak, moving = (1e3 * world.friction(row, load, moves) for moves in (False, True))
            # Below its kinetic friction a slider creeps and the spring pulls it on.
            peak = max(peak, moving)
            path = x if stroke == 0 else x[::-1]
            slack = 0.0 if stroke == 0 else lost
            stuck = True
            values = np.empty(points)
            for j in range(points):
                if j:
                    move = path[j] - path[j - 1]
                    taken = min(slack, abs(move))
                    slack -= taken
                    pull += spring * (move - np.sign(move) * taken)
                at = texture[j if stroke == 0 else points - 1 - j]
                here = direction * (peak if stuck else moving) * at - slope
                if direction * (pull - here) > 0:
                    stuck = False
                    pull = direction * moving * at - slope
                elif not stuck:
                    pull = direction * moving * at - slope
                values[j] = gain * pull + offset
            noisy = values + switch * noise["u_force"] * noise["understated"] * (
                rng.standard_normal(points)
            )
            columns = {
                "run_id": run_id,
                "stroke": stroke,
                "t_s": (np.arange(points) * step / row["speed_mm_s"]).round(4),
                "x_stage_mm": path.round(4),
                "v_mm_s": direction * row["speed_mm_s"],
                "force_mN": noisy.round(4),
            }
            traces.append(pd.DataFrame(columns))
    return {"drag_runs": table, "drag": pd.concat(traces, ignore_index=True)}


def _drop_drag(rng, world, noise, options, switch):
    table = _common(rng, "d", rng.integers(5, 9), rng.integers(2, 5), noise, options)
    n = len(table)
    table["stage_azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    table["height_mm"] = rng.choice([70.0, 100.0, 130.0], n)
    table["speed_mm_s"] = rng.choice([3.0, 10.0, 20.0], n)
    table["u_pos_mm"] = noise["u_pos"]
    scale, lag = world.get("camera_scale", 1.0), world.get("time_lag")
    frames, cloths = [], {}
    for run_id, row in zip(table["run_id"], _each(world.rows(table, "drop_drag")), strict=True):
        key = (row["height_m"], world.downhill(row["azimuth_deg"]))
        if key not in cloths:
            cloths[key] = Cloth(*key, world.effects, world.nominal)
        cloth = cloths[key]
        law = (row, world.mu_face * row["scatter"], world.effects, None)
        held, sliding = (cloth.gap_where_it_gives(*law, moves, 0.0) for moves in (False, True))
        advance, flat = 1e3 * (cloth.gap - cloth.gap[0]), 1e3 * cloth.contact
        slip, follow = (1e3 * (gap - cloth.gap[0]) for gap in (max(held, sliding), sliding))
        contact = np.interp(follow, advance, flat)
        reach, speed = 250.0, row["speed_mm_s"]
        pause = reach / speed
        times = np.arange(0, (reach + 40) / speed, 1 / 2.4 if speed >= 10 else 0.8)
        past = np.maximum(times - lag, 0)
        x_now = np.where(times <= pause, speed * times, 2 * reach - speed * times)
        x_then = np.where(past <= pause, speed * past, 2 * reach - speed * past)
        forward = past <= pause
        te = np.where(forward, np.where(x_then < slip, 0.0, x_then - follow), reach - follow)
        behind = np.where(forward, np.where(x_then < slip, x_then, follow), x_then - te)
        c = np.where(forward & (x_then >= slip), contact, np.interp(behind, advance, flat))
        c = np.where(~forward & (behind < 0), flat[0], c)
        m = len(times)
        u = noise["u_pos"] * noise["understated"] * switch
        part = pd.DataFrame(
            {
                "run_id": run_id,
                "frame": np.arange(m),
                "phase": np.where(times <= pause, "fwd", "rev"),
                "t_s": times.round(4),
                "x_stage_mm": x_now.round(4),
                "te_x_mm": (scale * te + u * rng.standard_normal(m)).round(4),
                "contact_len_mm": (scale * c + u * rng.standard_normal(m)).round(4),
            }
        )
        frames.append(part[rng.random(m) > 0.03])
    return {"drop_drag_runs": table, "drop_drag": pd.concat(frames, ignore_index=True)}


def _spring_slider(rng, world, noise, options, switch):
    common = _common(rng, "e", rng.integers(6, 9), rng.integers(4, 6), noise, options)
    return spring_slider(rng, world, noise, common, switch)


BUILDERS = {"incline": _incline, "strip": _strip, "drag": _drag, "drop_drag": _drop_drag}
# Only when planted: the rates of the benchmark are of protocols (a) to (d).
PLANTED_ONLY = {"spring_slider": _spring_slider}
COVARIATE_OF = {
    "ageing": "dwell_s",
    "anisotropy": "orientation_deg",
    "nap": "orientation_deg",
    "humidity": "rh_pct",
    "wear": "repeat_index",
    "patch": "pos_x_mm",
    "dwell_peak": "dwell_s",
    "threefold": "orientation_deg",
    "operator": "operator",
    "thermal_cycle": "clock_min",
}
POOLS = {"single": LIBRARY, "outside": OUTSIDE, "unrecorded": tuple(COVARIATE_OF)}
# Designs in which two mechanisms do exactly or nearly the same: which, where, what is fixed.
AMBIGUOUS = {
    "load": (("load_power", "adhesion"), "incline", {"area": "fixed", "load": "two"}),
    "rest": (("static_kinetic", "ageing"), "drag", {"dwell": "reversal"}),
    "direction": (("anisotropy", "nap"), "incline", {"orientation": "two"}),
}


def make_case(seed, kind, folder, noise_free=False, draw=0, effect_free=False, plant=None):
    """Write a case; ``kind`` is null, single, pair, outside, unrecorded or ambiguous.

    ``noise_free`` writes the same case without scatter, outliers, texture or noise (what the
    effect alone does), from the same draws of design and effect; another ``draw`` is a fresh
    campaign of the same world; ``effect_free`` leaves the effects out and all else as it was.
    ``plant`` is (effects by name, protocols), to choose them instead of drawing.

    Returns the truth: kind, effects, nominal, noise, coefficients.
    """
    rng = np.random.default_rng([seed, 7])
    nominal = {
        "rho_kg_m2": round(rng.uniform(0.1, 0.3), 3),
        "B_Nm": float(f"{np.exp(rng.uniform(np.log(1.5e-6), np.log(2.5e-5))):.3g}"),
        "B_strip_Nm": float(f"{np.exp(rng.uniform(np.log(2e-5), np.log(1.5e-4))):.3g}"),
        "ply_exponent": round(rng.uniform(1.2, 2.8), 2),
        "thickness_m": 4e-4,
        "cloth_length_m": 0.2,
        "k_tether_N_m": round(rng.uniform(40, 150), 1),
        "reversal_dwell_s": float(rng.choice([2.0, 5.0])),
    }
    noise = {
        "specimen": rng.uniform(0.02, 0.06),
        "run": rng.uniform(0.01, 0.04),
        "outliers": rng.choice([0.0, 0.02, 0.05]),
        "understated": rng.uniform(1.0, 1.5),
        "texture": rng.uniform(0.01, 0.04),
        "texture_length": rng.uniform(0.3, 2.0),
        "u_angle": round(rng.uniform(0.15, 0.5), 2),
        "u_eps": round(rng.uniform(0.002, 0.006), 4),
        "u_force": round(rng.uniform(0.1, 0.5), 2),
        "u_pos": round(rng.uniform(0.2, 0.6), 2),
    }
    names = list(BUILDERS)
    count = rng.choice([1, 2, 3, 4], p=[0.2, 0.3, 0.3, 0.2])
    protocols = set(rng.choice(names, count, replace=False))
    options = {
        "orientation": rng.choice(["specimen", "trial"]),
        "dwell": "varied",
        "area": "varied",
        "load": "varied",
        "unbalance": rng.choice([0.0, 0.15]),
        "reversal_dwell_s": nominal["reversal_dwell_s"],
    }
    effects, chosen = {}, []
    if kind == "pair":
        chosen = list(rng.choice(LIBRARY, 2, replace=False))
    elif kind in POOLS:
        chosen = [rng.choice(POOLS[kind])]
    elif kind == "ambiguous":
        pair, protocol, fixed = AMBIGUOUS[rng.choice(list(AMBIGUOUS))]
        chosen, protocols, options = [rng.choice(pair)], {protocol}, options | fixed
    if kind == "outside" and chosen[0] == "threefold":
        options["orientation"] = "trial"
    for name in chosen:
        name = str(name)
        effects[name] = draw_effect(rng, name)
        wanted = NEEDS_PROTOCOL.get(name)
        if wanted and not set(wanted) & protocols:
            protocols |= {str(rng.choice(wanted))}
        at_rest_or_loaded = name in ("dwell_peak", "ageing", "load_bump")
        if at_rest_or_loaded and not {"incline", "drag"} & protocols:
            protocols |= {"incline"}
    if plant is not None:
        effects, protocols = plant[0], set(plant[1])
    mu_face = float(np.exp(rng.uniform(np.log(0.2), np.log(0.8))))
    mu_edge = rng.uniform(0.12, 0.3)
    world = World({} if effect_free else effects, nominal, mu_face, mu_edge)
    switch = 1.0
    if noise_free:
        switch = 0.0
        noise = noise | {"specimen": 0.0, "run": 0.0}
    tables = {}
    builders = BUILDERS | PLANTED_ONLY
    for i, name in enumerate(builders):
        if name in protocols:
            own = np.random.default_rng([seed, 11, i, draw])
            tables |= builders[name](own, world, noise, options, switch)
    truth = {"seed": seed, "kind": kind, "effects": effects, "nominal": nominal, "noise": noise}
    truth |= {"mu_face": mu_face, "mu_edge": mu_edge, "protocols": sorted(protocols)}
    for name, table in tables.items():
        if kind == "unrecorded" and COVARIATE_OF[chosen[0]] in table:
            table[COVARIATE_OF[chosen[0]]] = np.nan
        outlier = table["outlier"] if "outlier" in table else np.zeros(len(table), bool)
        truth.setdefault("outliers", {})[name] = table.loc[outlier, "run_id"].tolist()
        hidden = [c for c in ("true_rh", "scatter", "outlier") if c in table]
        tables[name] = table.drop(columns=hidden)
    used = [name for name in builders if name in protocols]
    write_case(Path(folder), f"seed{seed}", tables, nominal, used)
    return truth
