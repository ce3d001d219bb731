"""A simulated bench: draws a design, hides an effect, writes the case folder.

``make_case(seed, kind, folder)`` returns the truth. Everything physical is written here anew, in
plain numbers, so that a mistake in the package cannot cancel.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from support.hidden_effects.elastica import hanging_cloth, pushed_strip
from support.hidden_effects.slider_bench import G, spring_slider

LIBRARY = (
    "load_power",
    "adhesion",
    "static_kinetic",
    "ageing",
    "rate",
    "anisotropy",
    "nap",
    "wear",
    "humidity",
    "tilt",
    "mass_error",
    "bending_error",
    "backlash",
    "camera_scale",
    "force_offset",
    "force_gain",
    "time_lag",
)
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


class World:
    """Friction force, fabric and instruments with the hidden effects."""

    def __init__(self, rng, effects, nominal, mu_face, mu_edge):
        self.effects, self.nominal = effects, nominal
        self.mu_face, self.mu_edge = mu_face, mu_edge
        self.rng = rng

    def get(self, name, parameter=None, default=0.0):
        values = self.effects.get(name)
        return default if values is None else values[parameter or name]

    @property
    def rho(self):
        return self.nominal["rho_kg_m2"] * (1 + self.get("mass_error"))

    def bump(self, name, x):
        """The factor of an effect that is a bump along a covariate."""
        if name not in self.effects:
            return 1.0
        e = self.effects[name]
        return 1 + e["size"] * np.exp(-0.5 * ((x - e["at"]) / e["width"]) ** 2)

    def friction(self, load, area, row, phi_deg, static, dwell, speed, edge=False):
        mu = self.mu_edge if edge else self.mu_face
        ratio = load / 2e-3 if edge else load / area / 50.0
        phi = np.radians(phi_deg)
        force = load * mu * ratio ** self.get("load_power")
        force = force * (1 + self.get("anisotropy") * np.cos(2 * phi))
        force = force * (1 + self.get("nap") * np.cos(phi))
        repeats = row["repeat_index"]
        force = force * (
            1 + self.get("wear") * (1 - np.exp(-repeats / self.get("wear", "r0", 1.0)))
        )
        force = force * (1 + self.get("humidity") * (row["true_rh"] - 50) / 10)
        if static:
            force = force * (1 + self.get("static_kinetic"))
            force = force * (1 + self.get("ageing") * np.log10(1 + dwell))
            force = force * self.bump("dwell_peak", np.log10(1 + dwell))
        else:
            force = force * (1 + self.get("rate") * np.log10(speed / 10))
        force = force * self.bump("patch", row["pos_x_mm"])
        if "thermal_cycle" in self.effects:
            e = self.effects["thermal_cycle"]
            angle = 2 * np.pi * row["clock_min"] / e["period"] + e["phase"]
            force = force * (1 + e["size"] * np.sin(angle))
        if "threefold" in self.effects:
            e = self.effects["threefold"]
            force = force * (1 + e["size"] * np.cos(3 * phi + e["phase"]))
        force = force * self.bump("load_bump", np.log10(ratio * 50))
        if "operator" in self.effects:
            force = force * np.where(row["operator"] == "B", 1 + self.get("operator", "size"), 1)
        if "smooth" in self.effects:  # planted only: any law along one covariate
            e = self.effects["smooth"]
            along = {"pos_x_mm": row["pos_x_mm"], "clock_min": row["clock_min"]}
            along |= {"load_ratio": ratio, "speed_mm_s": 1.0 if static else speed}
            if not (static and e["along"] == "speed_mm_s"):
                force = force * e["law"](along[e["along"]])
        return force * row["scatter"] + self.get("adhesion") * area

    def downhill(self, azimuth_deg):
        tilt, azimuth = self.get("tilt"), self.get("tilt", "azimuth")
        return np.radians(tilt) * np.cos(np.radians(azimuth_deg - azimuth))


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
    true = np.empty(n)
    for i, row in table.iterrows():
        a = row["area_cm2"] * 1e-4
        weight = (world.rho * a + row["added_mass_g"] * 1e-3) * G
        low, high = 0.0, np.radians(89.9)
        for _ in range(60):
            mid = 0.5 * (low + high)
            load = weight * np.cos(mid)
            limit = world.friction(load, a, row, row["orientation_deg"], True, row["dwell_s"], None)
            if weight * np.sin(mid) > limit:
                high = mid
            else:
                low = mid
        true[i] = np.degrees(mid) - np.degrees(world.downhill(row["azimuth_deg"]))
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
    lengths = [30.0, 45.0, 60.0]
    table["length_mm"] = rng.choice(lengths, n)
    table["width_mm"] = rng.choice([8.0, 12.0, 16.0], n)
    table["ply"] = rng.choice([1.0, 2.0], n)
    table["push_speed_mm_s"] = 0.5
    ply, length, width = (
        table["ply"].to_numpy(),
        table["length_mm"].to_numpy() * 1e-3,
        table["width_mm"].to_numpy() * 1e-3,
    )
    nominal = world.nominal
    bending = nominal["B_strip_Nm"] * (1 + world.get("bending_error"))
    bending = bending * ply ** nominal["ply_exponent"]
    gamma = world.rho * ply * G * length**3 / bending
    unit = bending * width / length**2
    ratio = np.full(n, world.mu_edge)
    for _ in range(8):
        _, load, _ = pushed_strip(gamma, np.minimum(ratio, 3.0))
        normal = load * unit
        limit = world.friction(
            normal,
            width * nominal["thickness_m"],
            table,
            table["orientation_deg"].to_numpy(),
            True,
            table["dwell_s"].to_numpy(),
            None,
            edge=True,
        )
        ratio = np.tan(np.arctan(limit / normal) - world.downhill(table["azimuth_deg"]))
        ratio = np.maximum(np.asarray(ratio, float), 1e-3)
    strain, _, flat = pushed_strip(gamma, ratio)
    strain = strain * world.get("camera_scale", default=1.0)
    u = noise["u_eps"]
    reading = strain + switch * u * noise["understated"] * rng.standard_normal(n)
    table["eps_slip"] = reading.round(5)
    table["u_eps"] = u
    table["regime"] = np.where(flat, "partial", "slipped")
    return {"strip": table}


def _drag(rng, world, noise, options, switch):
    table = _common(rng, "c", rng.integers(5, 9), rng.integers(3, 6), noise, options)
    n = len(table)
    table["stage_azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    table["area_cm2"] = rng.choice([50.0, 100.0, 200.0], n) if options["area"] != "fixed" else 100.0
    masses = [0.0, 10.0, 30.0, 100.0]
    table["added_mass_g"] = rng.choice(masses, n)
    speeds = [1.0, 3.0, 10.0, 30.0]
    table["speed_mm_s"] = rng.choice(speeds, n)
    table["u_force_mN"] = noise["u_force"]
    spring = world.nominal["k_tether_N_m"]
    step, reach = 0.1, 40.0
    rho = np.exp(-step / noise["texture_length"])
    gain, offset = 1 + world.get("force_gain"), world.get("force_offset")
    lost = world.get("backlash")
    traces = []
    for _, row in table.iterrows():
        a = row["area_cm2"] * 1e-4
        load = (world.rho * a + row["added_mass_g"] * 1e-3) * G
        slope = 1e3 * load * np.sin(world.downhill(row["stage_azimuth_deg"]))
        points = round(reach / step) + 1
        texture = np.empty(points)
        texture[0] = rng.standard_normal()
        for j in range(1, points):
            texture[j] = rho * texture[j - 1] + np.sqrt(1 - rho**2) * rng.standard_normal()
        texture = 1 + switch * noise["texture"] * texture
        pull, x = 0.0, np.linspace(0, reach, points)
        for stroke, direction in ((0, 1), (1, -1)):
            phi = row["orientation_deg"] + 180 * stroke
            dwell = row["dwell_s"] if stroke == 0 else world.nominal["reversal_dwell_s"]
            peak, moving = (
                1e3 * world.friction(load, a, row, phi, static, dwell, row["speed_mm_s"])
                for static in (True, False)
            )
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
            traces.append(
                pd.DataFrame(
                    {
                        "run_id": row["run_id"],
                        "stroke": stroke,
                        "t_s": (np.arange(points) * step / row["speed_mm_s"]).round(4),
                        "x_stage_mm": path.round(4),
                        "v_mm_s": direction * row["speed_mm_s"],
                        "force_mN": noisy.round(4),
                    }
                )
            )
    return {"drag_runs": table, "drag": pd.concat(traces, ignore_index=True)}


def _drop_drag(rng, world, noise, options, switch):
    table = _common(rng, "d", rng.integers(5, 9), rng.integers(2, 5), noise, options)
    n = len(table)
    table["stage_azimuth_deg"] = rng.choice([0.0, 90.0, 180.0, 270.0], n)
    heights = [70.0, 100.0, 130.0]
    table["height_mm"] = rng.choice(heights, n)
    speeds = [3.0, 10.0, 20.0]
    table["speed_mm_s"] = rng.choice(speeds, n)
    table["u_pos_mm"] = noise["u_pos"]
    nominal = world.nominal
    downhill = world.downhill(table["stage_azimuth_deg"].to_numpy())
    weight, lean = world.rho * G * np.cos(downhill), np.tan(downhill)
    bending = nominal["B_Nm"] * (1 + world.get("bending_error"))
    scale, lag = world.get("camera_scale", default=1.0), world.get("time_lag")
    h = table["height_mm"].to_numpy() * 1e-3
    beta, length = bending / (weight * h**3), nominal["cloth_length_m"] / h

    def excess(mid, static):
        lifted, _, point = hanging_cloth(beta, mid, lean)
        c = np.maximum(length - lifted, 1e-4)
        normal = (c + point) * weight * h
        limit = np.asarray(
            world.friction(
                normal,
                c * h,
                table,
                table["orientation_deg"].to_numpy(),
                static,
                table["dwell_s"].to_numpy(),
                table["speed_mm_s"].to_numpy(),
            )
        )
        limit = limit - c * h * weight * lean
        return mid - limit / (weight * h)

    def steady(static):
        low, high = np.full(n, 1e-4), np.full(n, 8.0)
        excess_low, excess_high = excess(low, static), excess(high, static)
        side = np.zeros(n)
        for _ in range(30):  # regula falsi, Illinois
            mid = (low * excess_high - high * excess_low) / (excess_high - excess_low)
            value = excess(mid, static)
            up = value > 0
            high, excess_high = np.where(up, mid, high), np.where(up, value, excess_high)
            low, excess_low = np.where(up, low, mid), np.where(up, excess_low, value)
            excess_low = np.where(up & (side > 0), excess_low / 2, excess_low)
            excess_high = np.where(~up & (side < 0), excess_high / 2, excess_high)
            side = np.where(up, 1, -1)
            if np.max(np.abs(value)) < 1e-6:
                break
        return mid

    eta_moving = steady(False)
    eta_static = np.maximum(steady(True), eta_moving)
    fractions = np.linspace(0, 1, 28) ** 2
    grid = np.maximum(eta_static, eta_moving)[:, None] * fractions
    lifted, extent, _ = hanging_cloth(
        np.repeat(beta[:, None], 28, 1), grid, np.repeat(lean[:, None], 28, 1)
    )
    flat = length[:, None] - lifted
    distance = (flat + extent) * h[:, None] * 1e3
    flat = flat * h[:, None] * 1e3
    frames = []
    for i, row in table.iterrows():
        advance = distance[i] - distance[i, 0]
        slip = np.interp(eta_static[i], grid[i], advance)
        follow = np.interp(eta_moving[i], grid[i], advance)
        contact = np.interp(eta_moving[i], grid[i], flat[i])
        reach, speed = 250.0, row["speed_mm_s"]
        pause = reach / speed
        times = np.arange(0, (reach + 40) / speed, 1 / 2.4 if speed >= 10 else 0.8)
        past = np.maximum(times - lag, 0)
        x_now = np.where(times <= pause, speed * times, 2 * reach - speed * times)
        x_then = np.where(past <= pause, speed * past, 2 * reach - speed * past)
        forward = past <= pause
        te = np.where(forward, np.where(x_then < slip, 0.0, x_then - follow), reach - follow)
        behind = np.where(forward, np.where(x_then < slip, x_then, follow), x_then - te)
        c = np.where(forward & (x_then >= slip), contact, np.interp(behind, advance, flat[i]))
        c = np.where(~forward & (behind < 0), flat[i, 0], c)
        m = len(times)
        u = noise["u_pos"] * noise["understated"] * switch
        part = pd.DataFrame(
            {
                "run_id": row["run_id"],
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
    effects = {}
    if kind == "single":
        chosen = [rng.choice(LIBRARY)]
    elif kind == "pair":
        chosen = list(rng.choice(LIBRARY, 2, replace=False))
    elif kind == "outside":
        chosen = [rng.choice(OUTSIDE)]
    elif kind == "unrecorded":
        chosen = [rng.choice(list(COVARIATE_OF))]
    elif kind == "ambiguous":
        # Designs in which two or more mechanisms do exactly or nearly the same.
        which = rng.choice(["load", "rest", "direction"])
        if which == "load":
            chosen = [rng.choice(["load_power", "adhesion"])]
            protocols, options["area"], options["load"] = {"incline"}, "fixed", "two"
        elif which == "rest":
            chosen = [rng.choice(["static_kinetic", "ageing"])]
            protocols, options["dwell"] = {"drag"}, "reversal"
        else:
            chosen = [rng.choice(["anisotropy", "nap"])]
            protocols, options["orientation"] = {"incline"}, "two"
    else:
        chosen = []
    if kind == "outside" and chosen[0] == "threefold":
        options["orientation"] = "trial"
    for name in chosen:
        name = str(name)
        effects[name] = draw_effect(rng, name)
        wanted = NEEDS_PROTOCOL.get(name)
        if wanted and not set(wanted) & protocols:
            protocols |= {str(rng.choice(wanted))}
        if name in ("dwell_peak", "ageing") and not {"incline", "drag"} & protocols:
            protocols |= {"incline"}
        if name == "load_bump" and not {"incline", "drag"} & protocols:
            protocols |= {"incline"}
    if plant is not None:
        effects, protocols = plant[0], set(plant[1])
    mu_face = float(np.exp(rng.uniform(np.log(0.2), np.log(0.8))))
    mu_edge = rng.uniform(0.12, 0.3)
    world = World(rng, {} if effect_free else effects, nominal, mu_face, mu_edge)
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
    truth = {
        "seed": seed,
        "kind": kind,
        "effects": effects,
        "nominal": nominal,
        "noise": noise,
        "mu_face": mu_face,
        "mu_edge": mu_edge,
        "protocols": sorted(protocols),
    }
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        if kind == "unrecorded" and COVARIATE_OF[chosen[0]] in table:
            table[COVARIATE_OF[chosen[0]]] = np.nan
        hidden = [c for c in ("true_rh", "scatter", "outlier") if c in table]
        truth.setdefault("outliers", {})[name] = (
            table.loc[table["outlier"], "run_id"].tolist() if "outlier" in table else []
        )
        table.drop(columns=hidden).to_csv(folder / f"{name}.csv", index=False)
    meta = {
        "case": f"seed{seed}",
        "nominal": {k: v for k, v in nominal.items() if k != "reversal_dwell_s"},
        "reversal_dwell_s": nominal["reversal_dwell_s"],
        "protocols": [name for name in builders if name in protocols],
    }
    (folder / "meta.json").write_text(json.dumps(meta))
    return truth
