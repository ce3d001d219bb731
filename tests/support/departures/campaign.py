"""Campaigns with a hidden truth: drawn from a seed, written as case folders."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from support.departures import laws, sensors, strength
from support.departures.design import draw
from support.departures.readings import measured

FAMILIES = (
    *["null"] * 5,
    *["single"] * 6,
    *["pair"] * 2,
    *["ambiguous"] * 2,
    *["outside"] * 2,
    "sorted",
    "track",
    "units",
)
PROTOCOLS = ("incline", "strip", "drag", "drop_drag", "spring_slider")
# Designs that cannot tell: protocols, fixed columns, tie set.
AMBIGUOUS = (
    (("drop_drag",), {}, ("bending_error", "mass_error")),
    (("incline",), {"added_mass_g": (5.0, 60.0), "area_cm2": 25.0}, ("load_power", "adhesion")),
    (("drag",), {"dwell_s": 10.0}, ("static_kinetic", "ageing")),
    (("incline",), {"locked": True}, ("nap", "tilt")),
    (("incline",), {"humid_by_repeat": True}, ("wear", "humidity")),
)
SORTABLE = {
    "incline": ("added_mass_g", "dwell_s", "rh_pct"),
    "drag": ("added_mass_g", "speed_mm_s", "dwell_s", "rh_pct"),
}
USUAL_SCATTER = ((0.02, 0.08), (0.015, 0.05))  # between specimens, between runs; of log mu
MAY_BE_MISSING = ("operator", "rh_pct", "pos_x_mm", "clock_min", "dwell_s", "repeat_index")


@dataclass
class Plan:
    """All of a campaign but the luck of the draw."""

    seed: int
    family: str
    departures: bool
    protocols: tuple
    mu_face: float
    mu_edge: float
    nominal: dict
    scatter: dict
    noise: dict
    understated: float
    outliers: float
    grain: tuple
    tables: dict
    sampling_mm: float
    frame_mm: float
    damping: float
    effects: dict = field(default_factory=dict)
    faults: list = field(default_factory=list)
    fault_kind: str = "none"
    missing: list = field(default_factory=list)
    tracks: dict = field(default_factory=dict)
    tie: tuple = ()
    sorted_by: str = ""
    units: str = ""
    known: dict = field(default_factory=dict)  # expectations, by what they depend on


def draw_plan(seed, family=None, departures=None, protocols=None):
    """The plan of a seed; by default its family follows from the seed, and odd seeds depart.

    ``protocols`` are measured instead of drawn ones, every column varied.
    """
    family = FAMILIES[(seed // 2) % len(FAMILIES)] if family is None else family
    departures = bool(seed % 2) if departures is None else departures
    rng = np.random.default_rng([seed, 40_000])
    names, drawn, fixed, tie, sort_by, units = _family(rng, family)
    varied = bool(protocols) or _turns(names)
    protocols = tuple(p for p in PROTOCOLS if p in (protocols or drawn))
    nominal = {
        "rho_kg_m2": round(float(rng.uniform(0.09, 0.28)), 4),
        "B_Nm": float(f"{np.exp(rng.uniform(np.log(2e-6), np.log(4e-5))):.3g}"),
        "B_strip_Nm": float(f"{rng.uniform(1.5e-5, 6e-5):.3g}"),
        "ply_exponent": round(float(rng.uniform(1.3, 2.6)), 2),
        "thickness_m": float(f"{rng.uniform(2.5e-4, 7e-4):.3g}"),
        "cloth_length_m": round(float(rng.uniform(0.17, 0.24)), 3),
        "k_tether_N_m": round(float(rng.uniform(20, 70)), 1),
        "reversal_dwell_s": round(float(np.exp(rng.uniform(0, 2.5))), 1),
    }
    if tie == ("static_kinetic", "ageing"):
        nominal["reversal_dwell_s"] = 10.0
    between, within = USUAL_SCATTER
    plan = Plan(
        seed=seed,
        family=family,
        departures=departures,
        protocols=protocols,
        mu_face=round(float(rng.uniform(0.2, 0.65)), 4),
        mu_edge=round(float(rng.uniform(0.12, 0.28)), 4),
        nominal=nominal,
        scatter={p: (rng.uniform(*between), rng.uniform(*within)) for p in protocols},
        noise={
            "incline": round(float(rng.uniform(0.2, 0.7)), 3),
            "strip": round(float(rng.uniform(0.002, 0.008)), 4),
            "drag": round(float(rng.uniform(0.3, 1.2)), 3),
            "drop_drag": round(float(rng.uniform(0.3, 1.2)), 3),
            "spring_slider": round(float(rng.uniform(2.0, 8.0)), 2),
        },
        understated=float(rng.uniform(1.0, 1.5)),
        outliers=float(rng.uniform(0, 0.03)),
        grain=(float(rng.uniform(0.01, 0.04)), float(rng.uniform(0.6, 3.0))),
        tables={},
        sampling_mm=float(rng.choice([0.2, 0.3, 0.4])),
        frame_mm=float(rng.choice([1.0, 2.0, 3.0])),
        damping=float(rng.uniform(0.0, 0.04)),
        tie=tie,
        sorted_by=sort_by,
        units=units,
    )
    if "orientation_deg" not in fixed and rng.uniform() < 0.15 and not varied:
        fixed["orientation_deg"] = 0.0
    for protocol in protocols:
        plan.tables[protocol] = draw(rng, protocol, fixed, sort_by)
        if fixed.get("locked"):
            azimuth = plan.tables[protocol]["azimuth_deg"]
            plan.tables[protocol]["orientation_deg"] = azimuth
        if fixed.get("humid_by_repeat"):
            repeats = plan.tables[protocol]["repeat_index"]
            plan.tables[protocol]["rh_pct"] = (50 + 10 * -np.expm1(-repeats / 2.5)).round(2)
    if family == "track":
        for protocol in protocols:
            kind = str(rng.choice(["smooth", "patchy"]))
            plan.tracks[protocol] = laws.Track(rng, kind, rng.uniform(0.03, 0.1), protocol)
    plan.effects = _sized(rng, plan, names)
    if departures:
        _depart(rng, plan)
    return plan


def _turns(names):
    return bool({"anisotropy", "nap", "threefold", "oblique"} & set(names))


def _family(rng, family):
    """(effects' names, protocols, fixed columns, tie, sorted column, wrong unit)."""
    if family == "ambiguous":
        protocols, fixed, tie = AMBIGUOUS[rng.integers(len(AMBIGUOUS))]
        return (str(rng.choice(tie)),), protocols, dict(fixed), tie, "", ""
    if family == "sorted":
        protocol = str(rng.choice(list(SORTABLE)))
        return ("time_drift",), (protocol,), {}, (), str(rng.choice(SORTABLE[protocol])), ""
    if family == "track":
        return (), ("spring_slider",), {}, (), "", ""
    if family == "units":
        unit = str(rng.choice(sensors.UNITS))
        protocol = "drag" if "force" in unit else "incline"
        return (), (protocol,), {}, (), "", unit
    names = ()
    if family == "single":
        names = (str(rng.choice(laws.LIBRARY)),)
    elif family == "pair":
        names = tuple(str(n) for n in rng.choice(laws.LIBRARY, 2, replace=False))
        if set(names) == {"mass_error", "bending_error"}:  # one to (d)
            names = ("bending_error", "rate")
    elif family == "outside":
        names = (str(rng.choice(laws.OUTSIDE)),)
    number = int(rng.choice([1, 2, 3], p=[0.35, 0.4, 0.25]))
    chosen = [str(rng.choice(laws.EFFECTS[name].shows)) for name in names]
    for protocol in rng.permutation(PROTOCOLS):
        # Stick-slip is rarer; it costs the most to draw.
        if len(set(chosen)) < number and (protocol != "spring_slider" or rng.uniform() < 0.3):
            chosen.append(str(protocol))
    return names, tuple(p for p in PROTOCOLS if p in chosen), {}, (), "", ""


def _sized(rng, plan, names):
    """Sizes that aim at a noncentrality drawn for each effect."""
    effects = {}
    for name in names:
        fixed = laws.details(rng, name)
        if name == "tilt" and plan.tie:  # along the nap, or the design can tell
            fixed["tilt_azimuth"] = 180.0 * (fixed["tilt_azimuth"] > 180)
        low, high = {"single": (9, 1000), "pair": (30, 600)}.get(plan.family, (25, 1000))
        large = rng.uniform() < 0.3  # of the size that such effects have, however plain it is
        aim = np.exp(rng.uniform(np.log(low), np.log(high)))
        effect = laws.EFFECTS[name]
        largest = effect.largest
        sign = -1.0 if effect.signed and rng.uniform() < 0.5 else 1.0
        share = sign
        if large:
            share = sign * rng.uniform(0.7, 2.2)
        for _ in range(0 if large else 3):
            values = laws.scaled(name, share, **fixed)
            # As if slips were not sampled: every seed's sizes hang on that.
            seen = strength.noncentrality(plan, {name: values}, sampled=False)
            unit = abs(laws.share_of(name, values))
            size = abs(values[name] - (1.0 if name == "camera_scale" else 0.0))
            wanted = size * np.clip(np.sqrt(aim / max(seen, 1e-6)), 0.1, 8.0)
            if name == "bending_error" and sign < 0:
                largest = 0.5
            wanted = np.clip(wanted, effect.smallest, largest)
            share = sign * unit * wanted / size
        values = laws.scaled(name, share, **fixed)
        effects[name] = {k: float(f"{v:.5g}") for k, v in values.items()}
    return effects


def _depart(rng, plan):
    """Faults, gaps and unevenness of an honest bench."""
    if plan.units:
        return
    chance = rng.uniform()
    kind = "three" if chance < 0.4 else "one" if chance < 0.65 else "several"
    if kind == "three" and "drop_drag" not in plan.protocols:
        kind = "several"
    plan.fault_kind = kind
    plan.faults = sensors.draw_faults(rng, plan.protocols, kind)
    needed = {laws.EFFECTS[name].column for name in (*plan.effects, *plan.tie)} | {plan.sorted_by}
    spare = [c for c in MAY_BE_MISSING if c not in needed]
    if kind == "several" and rng.uniform() < 0.5:
        plan.missing = [str(c) for c in rng.choice(spare, rng.integers(1, 3), replace=False)]
    if plan.family in ("single", "pair") and kind == "several" and rng.uniform() < 0.3:
        for protocol in plan.protocols:
            shape = str(rng.choice(["smooth", "patchy"]))
            plan.tracks[protocol] = laws.Track(rng, shape, rng.uniform(0.01, 0.03), protocol)
        plan.known.clear()


def make_case(seed, folder, family=None, departures=None, repeat=0, effect_free=False):
    """Write a case folder; return its truth.

    Parameters
    ----------
    seed
        All that is drawn follows from it.
    family, departures
        See :func:`draw_plan`.
    repeat
        A further campaign of the same plan: other specimens and noise.
    effect_free
        Leave the hidden effects out.

    Returns
    -------
    dict
        ``effects``, ``faults``, ``missing``, ``lambda``, ``separation`` (single effects) and
        ``each`` (pairs), and what else the plan says.
    """
    plan = draw_plan(seed, family, departures)
    truth = truth_of(plan)
    if effect_free:
        plan.effects = {}
    write(plan, Path(folder), repeat)
    return truth


def planted(seed, folder, effects, *protocols, repeat=0, **changes):
    """Write a sound bench's case with effects of one's own; return its plan.

    Parameters
    ----------
    effects
        By name: parameters, a size alone, or a factor on the friction of (contact, moving).
    repeat
        A further campaign of the same plan.
    changes
        Of the plan that is drawn; of mappings, entries.
    """
    plan = draw_plan(seed, "null", False, protocols)
    effects = {k: {k: v} if isinstance(v, float) else v for k, v in effects.items()}
    for name, value in changes.items():
        changes[name] = getattr(plan, name) | value if isinstance(value, dict) else value
    plan = replace(plan, effects=effects, **changes)
    write(plan, Path(folder), repeat)
    return plan


def write(plan, folder, repeat=0):
    """The files of a plan."""
    tables = {}
    for protocol in plan.protocols:
        number = PROTOCOLS.index(protocol)
        tables |= measured(plan, protocol, np.random.default_rng([plan.seed, 50, number, repeat]))
    if plan.units:
        tables = sensors.wrong_units(plan.units, tables)
    for table in tables.values():
        for column in set(plan.missing) & set(table):
            table[column] = ""
    write_case(folder, f"departures-{plan.seed}", tables, plan.nominal, plan.protocols)


def write_case(folder, name, tables, nominal, protocols):
    """A case folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for table, content in tables.items():
        content.to_csv(folder / f"{table}.csv", index=False)
    nominal = dict(nominal)
    meta = {"case": name, "protocols": list(protocols)}
    meta |= {"reversal_dwell_s": nominal.pop("reversal_dwell_s"), "nominal": nominal}
    (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def truth_of(plan):
    """All that a score needs to know."""
    names = tuple(plan.effects)
    as_they_are = (
        *("seed", "family", "departures", "effects", "mu_face", "mu_edge", "faults", "fault_kind"),
        *("missing", "sorted_by", "units"),
    )
    truth = {name: getattr(plan, name) for name in as_they_are} | {
        "protocols": list(plan.protocols),
        "scatter": {p: [round(float(x), 4) for x in s] for p, s in plan.scatter.items()},
        "understated": round(plan.understated, 3),
        "uneven_track": sorted(plan.tracks),
        "tie": list(plan.tie),
        "lambda": 0.0,
        "separation": 0.0,
        "each": [],
        "fault_strength": 0.0,
    }
    if names:
        truth["lambda"] = round(strength.noncentrality(plan, plan.effects), 2)
    if plan.family == "single":
        rivals = [m for m in laws.LIBRARY if m not in names]
        truth["separation"] = round(strength.separation(plan, plan.effects, rivals), 2)
    if plan.fault_kind == "one":
        truth["fault_strength"] = round(strength.fault_strength(plan, plan.faults[0]), 2)
    if plan.family == "pair":
        truth["each"] = [round(x, 2) for x in strength.shares_of_pair(plan, plan.effects)]
    return truth
