"""A slider pulled to and fro over a spring, stepped in time with neither mass nor damping."""

import numpy as np

from support.departures.laws import GRAVITY_M_S2, friction_limit, tilt_of


def loads(rows, effects, rho_kg_m2):
    """(normal load, downhill pull towards +x), both in N."""
    mass = rho_kg_m2 * (1 + effects.get("mass_error", {}).get("mass_error", 0.0))
    weight = (mass * rows["area_m2"] + rows["added_kg"]) * GRAVITY_M_S2
    tilt, towards = tilt_of(effects, rows["azimuth_deg"])
    lean = np.radians(tilt)
    return weight * np.cos(lean), weight * np.sin(lean) * towards


def strokes(rows, coefficient, effects, nominal, stroke_mm, step_mm, texture, track):
    """Readings of the force cell on a fine grid of stage positions.

    Parameters
    ----------
    rows
        Columns of the runs, arrays of shape (runs,).
    coefficient
        Friction coefficient of each run.
    texture
        (runs, places) factors of friction at ``place_mm`` 0, 0.25, ... after the start; or None.
    track
        Factor by place on the substrate, or None.

    Returns
    -------
    dict
        ``stage_mm`` (steps,), ``stroke`` (steps,), ``force_N`` (steps, runs) as read,
        ``place_mm`` (steps, runs).
    """
    load, pull = loads(rows, effects, nominal["rho_kg_m2"])
    count = round(stroke_mm / step_mm)
    out = np.arange(count + 1) * step_mm
    stage = np.concatenate([out, out[::-1]])
    stroke, stage_end = np.repeat([0, 1], count + 1), stage[count]
    lost = effects.get("backlash", {}).get("backlash", 0.0)
    taut = np.where(stroke == 0, stage, np.minimum(stage + lost, stroke_mm))
    stiffness = nominal["k_tether_N_m"] * 1e-3  # N/mm

    def bearable(way, moving, place, dwell):
        turned = rows["orientation_deg"] + (180.0 if way < 0 else 0.0)
        contact = rows | {"load_N": load, "orientation_deg": turned, "dwell_s": dwell}
        contact["place_mm"] = place
        force = friction_limit(contact, coefficient, effects, moving)
        if track is not None:
            force = force * track(place)
        if texture is not None:
            at = np.clip((place - rows["place_mm"]) / 0.25, 0, texture.shape[1] - 1.001)
            low = at.astype(int)
            share, index = at - low, np.arange(len(load))
            grain = texture[index, low] * (1 - share) + texture[index, low + 1] * share
            force = force * grain
        return force

    runs = len(load)
    x = np.zeros(runs)  # of the slider, from its start
    stuck = np.ones(runs, bool)
    force = np.empty((len(stage), runs))
    places = np.empty((len(stage), runs))
    way, dwell = 1, rows["dwell_s"]
    varies = texture is not None or track is not None or {"patch", "periodic"} & set(effects)
    for i in range(len(stage)):
        if stroke[i] == 1 and way == 1:
            way, dwell, stuck = -1, np.full(runs, nominal["reversal_dwell_s"]), np.ones(runs, bool)
        place = rows["place_mm"] + x
        spring = stiffness * (taut[i] - x)
        drive = way * (spring + pull)
        if varies or stage[i] in (0.0, stage_end):
            static = bearable(way, False, place, dwell)
            moving = bearable(way, True, place, dwell)
        stuck &= drive <= static
        goes = ~stuck & (drive > moving)
        x = x + np.where(goes, way * (drive - moving) / stiffness, 0.0)
        force[i] = stiffness * (taut[i] - x)
        places[i] = rows["place_mm"] + x
    gain = effects.get("force_gain", {}).get("force_gain", 0.0)
    offset = effects.get("force_offset", {}).get("force_offset", 0.0) * 1e-3
    return {
        "stage_mm": stage,
        "stroke": stroke,
        "force_N": (1 + gain) * force + offset,
        "place_mm": places,
    }


WINDOWS = 4


def features(rows, coefficient, effects, nominal, stroke_mm, step_mm=0.25, track=None):
    """Exact expectation of what a trace shows, mN, mm, and slope: (runs, features).

    Peak and plateau (in four windows) of each stroke, loading slope (mN/mm), lost motion (mm).
    """
    trace = strokes(rows, coefficient, effects, nominal, stroke_mm, step_mm, None, track)
    force = trace["force_N"] * 1e3
    half = len(force) // 2
    forward, back = force[:half], force[half:]
    load, pull = loads(rows, effects, nominal["rho_kg_m2"])
    late = slice(int(half * 0.45), half - 1)
    gain = 1 + effects.get("force_gain", {}).get("force_gain", 0.0)
    columns = []
    for part, turned, dwell, sign in (
        (forward, 0.0, rows["dwell_s"], 1),
        (back, 180.0, np.full(len(load), nominal["reversal_dwell_s"]), -1),
    ):
        contact = rows | {
            "load_N": load,
            "orientation_deg": rows["orientation_deg"] + turned,
            "dwell_s": dwell,
            "place_mm": trace["place_mm"][0 if sign > 0 else half],
        }
        static = friction_limit(contact, coefficient, effects, False)
        moving = friction_limit(contact, coefficient, effects, True)
        if track is not None:
            static, moving = (f * track(contact["place_mm"]) for f in (static, moving))
        peak = np.maximum(static, moving)
        offset = effects.get("force_offset", {}).get("force_offset", 0.0)
        columns.append(gain * (sign * peak - pull) * 1e3 + offset)
        columns += [w.mean(axis=0) for w in np.array_split(part[late], WINDOWS)]
    columns.append(np.full(len(load), gain * nominal["k_tether_N_m"]))
    lost = effects.get("backlash", {}).get("backlash", 0.0)
    columns.append(np.full(len(load), float(lost)))
    return np.array(columns).T


def noise(rows, coefficient, nominal, stroke_mm, sample_mm, u_mN, grain, grain_mm):
    """Standard deviations of those features: noise of the cell and the track's grain."""
    load, _ = loads(rows, {}, nominal["rho_kg_m2"])
    friction = coefficient * load * 1e3
    window = 0.55 * stroke_mm / WINDOWS
    plateau = np.hypot(
        u_mN / np.sqrt(window / sample_mm), grain * friction * np.sqrt(2 * grain_mm / window)
    )
    peak = np.hypot(u_mN, grain * friction)
    rise = np.maximum(friction / nominal["k_tether_N_m"], 3 * sample_mm)  # mm of loading
    slope = u_mN * np.sqrt(12 * sample_mm / rise) / rise
    lost = np.hypot(u_mN / nominal["k_tether_N_m"], sample_mm / np.sqrt(12))
    one = [peak] + [plateau] * WINDOWS
    return np.array([*one, *one, slope, np.full(len(load), lost)]).T
