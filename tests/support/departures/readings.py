"""The tables of a campaign as its instruments write them."""

import numpy as np
import pandas as pd

from support.departures import drag, drop_drag, incline, spring_slider, strip
from support.departures.sensors import Faults
from support.departures.strength import BACK_MM, SLIDE_MM, STROKE_MM, TRAVEL_MM, rows


def scattered(plan, protocol, rng):
    """Coefficient of every run: specimens, runs, and now and then a run that went wrong."""
    table = plan.tables[protocol]
    between, within = plan.scatter[protocol]
    index = np.unique(table["specimen_id"], return_inverse=True)[1]
    logs = between * rng.normal(size=index.max() + 1)[index] + within * rng.normal(size=len(table))
    wrong = rng.uniform(size=len(table)) < plan.outliers
    logs = logs + np.where(wrong, rng.choice([-1, 1], len(table)) * rng.uniform(0.25, 0.5), 0.0)
    return (plan.mu_edge if protocol == "strip" else plan.mu_face) * np.exp(logs)


def measured(plan, protocol, rng):
    """Tables (name -> frame) of one protocol."""
    return {
        "incline": _incline,
        "strip": _strip,
        "drag": _drag,
        "drop_drag": _drop_drag,
        "spring_slider": _spring_slider,
    }[protocol](plan, rng, plan.tables[protocol].copy(), Faults(plan.faults, protocol))


def _incline(plan, rng, table, faults):
    mu = scattered(plan, "incline", rng)
    values, track = rows(plan, "incline"), plan.tracks.get("incline")
    if track is not None:
        mu = mu * track(values["place_mm"])
    exact = incline.slip_angle_deg(values, mu, plan.effects, plan.nominal["rho_kg_m2"])
    u = plan.noise["incline"]
    angle = faults.read(rng, "angle_deg", exact, u * plan.understated)
    table["censored"] = (angle >= 60).astype(int)
    table["angle_deg"] = np.clip(angle, 0.0, 60.0).round(3)
    table["u_angle_deg"] = u
    return {"incline": table}


def _strip(plan, rng, table, faults):
    mu = scattered(plan, "strip", rng)
    values, track = rows(plan, "strip"), plan.tracks.get("strip")
    if track is not None:
        mu = mu * track(values["place_mm"])
    exact, slipped = strip.slip_strain(values, mu, plan.effects, plan.nominal)
    u = plan.noise["strip"]
    table["eps_slip"] = faults.read(rng, "eps_slip", exact, u * plan.understated).round(5)
    table["u_eps"] = u
    table["regime"] = np.where(slipped, "slipped", "partial")
    return {"strip": table}


def _grain(plan, rng, runs, length_mm):
    """Texture of the track: an autoregression along it, one for each run."""
    sd, correlation = plan.grain
    decay = np.exp(-0.25 / correlation)
    steps = rng.normal(size=(runs, int(length_mm / 0.25) + 8))
    out = np.empty_like(steps)
    out[:, 0] = steps[:, 0]
    for i in range(1, steps.shape[1]):
        out[:, i] = decay * out[:, i - 1] + np.sqrt(1 - decay**2) * steps[:, i]
    return 1 + sd * out


def _drag(plan, rng, table, faults):
    step = 0.05
    values = rows(plan, "drag")
    grain = _grain(plan, rng, len(table), STROKE_MM)
    mu = scattered(plan, "drag", rng)
    track = plan.tracks.get("drag")
    trace = drag.strokes(values, mu, plan.effects, plan.nominal, STROKE_MM, step, grain, track)
    u = plan.noise["drag"]
    half = len(trace["stage_mm"]) // 2
    shift_mm, delay = faults.size("x_stage_mm", "zero"), faults.size("force_mN", "delay")
    every, frames = round(plan.sampling_mm / step), []
    for j, run in enumerate(table.itertuples()):
        speed = run.speed_mm_s
        index = np.concatenate([faults.instants(rng, half, every) + s * half for s in (0, 1)])
        index = index[faults.keep(rng, len(index))]
        stroke = trace["stroke"][index]
        # The place along the way that a late force cell still shows.
        path = np.where(stroke == 0, 0, half) + (index % half)
        late = np.maximum(path - delay * speed / step, 0)
        force = np.interp(late, np.arange(2 * half), trace["force_N"][:, j]) * 1e3
        reading = faults.read(rng, "force_mN", force, u * plan.understated, run.clock_min)
        back = stroke == 1
        elapsed = (index % half) * step / speed
        elapsed = elapsed + back * (STROKE_MM / speed + plan.nominal["reversal_dwell_s"])
        columns = {
            "run_id": run.run_id,
            "stroke": stroke,
            "t_s": elapsed.round(4),
            "x_stage_mm": (trace["stage_mm"][index] + shift_mm).round(3),
            "v_mm_s": np.where(back, -speed, speed),
            "force_mN": reading.round(3),
        }
        frames.append(pd.DataFrame(columns))
    table["u_force_mN"] = u
    return {"drag_runs": table, "drag": pd.concat(frames, ignore_index=True)}


def _drop_drag(plan, rng, table, faults):
    step = 0.25
    values = rows(plan, "drop_drag")
    short = faults.size("x_stage_mm", "turn")
    mu = scattered(plan, "drop_drag", rng)
    way = (TRAVEL_MM - short, BACK_MM - short, step)
    track = plan.tracks.get("drop_drag")
    trace = drop_drag.runs(values, mu, plan.effects, plan.nominal, *way, track)
    u = plan.noise["drop_drag"]
    scale = plan.effects.get("camera_scale", {}).get("camera_scale", 1.0)
    lag = plan.effects.get("time_lag", {}).get("time_lag", 0.0)
    hold = round(2 * short / step)  # steps that the commanded stage goes on without the real one
    turn = int(np.argmax(trace["back"]))
    out = np.arange(round(TRAVEL_MM / step) + 1) * step
    commanded = np.append(out, TRAVEL_MM - np.arange(1, round(BACK_MM / step) + 1) * step)
    source = np.insert(np.arange(len(trace["back"])), turn, np.full(hold, turn - 1))
    source = source[: len(commanded)]
    frames = []
    slow = faults.size("contact_len_mm", "delay")
    for j, run in enumerate(table.itertuples()):
        index = faults.instants(rng, len(commanded), max(1, round(plan.frame_mm / step)))
        index = index[faults.keep(rng, len(index))]

        def shown(column, delay_s, j=j, index=index, speed=run.speed_mm_s):
            at = np.maximum(index - delay_s * speed / step, 0)
            return np.interp(at, np.arange(len(source)), trace[column][source, j])

        noise = u * plan.understated
        edge = faults.read(rng, "te_x_mm", scale * shown("edge_mm", lag), noise)
        contact = scale * shown("contact_mm", lag + slow)
        # Where the stage's zero is off, the record starts before or after the real start.
        zero = faults.size("x_stage_mm", "zero")
        columns = {
            "run_id": run.run_id,
            "frame": np.arange(len(index)),
            "phase": np.where(index > round(TRAVEL_MM / step), "rev", "fwd"),
            "t_s": (index * step / run.speed_mm_s).round(4),
            "x_stage_mm": (commanded[index] + zero).round(3),
            "te_x_mm": edge.round(3),
            "contact_len_mm": faults.read(rng, "contact_len_mm", contact, noise).round(3),
        }
        frames.append(pd.DataFrame(columns))
    table["u_pos_mm"] = u
    return {"drop_drag_runs": table, "drop_drag": pd.concat(frames, ignore_index=True)}


def _spring_slider(plan, rng, table, faults):
    values = rows(plan, "spring_slider")
    forces = drag.loads(values, plan.effects, plan.nominal["rho_kg_m2"])
    mu = scattered(plan, "spring_slider", rng)
    period = 2 * np.pi * np.sqrt((values["mass_kg"] / values["spring_N_m"]).min())
    sample = float(f"{period / 24:.2g}")
    u = plan.noise["spring_slider"]
    frames = {}
    for speed in np.unique(values["speed_mm_s"]):
        chosen = np.flatnonzero(values["speed_mm_s"] == speed)
        some = {k: v[chosen] for k, v in values.items()}
        loading = 1e3 * (mu * forces[0] / values["spring_N_m"])[chosen].max()
        loads, duration_s = tuple(f[chosen] for f in forces), (SLIDE_MM + loading) / speed
        of_bench = sample, plan.tracks.get("spring_slider"), plan.damping
        law = mu[chosen], plan.effects
        time, force = spring_slider.motion(some, *law, loads, duration_s, *of_bench)
        for k, j in enumerate(chosen):
            run = table.iloc[j]
            index = faults.keep(rng, len(time))
            exact, noise = force[index, k] * 1e3, u * plan.understated
            reading = faults.read(rng, "force_mN", exact, noise, run["clock_min"]).round(3)
            columns = {"run_id": run["run_id"], "t_s": time[index].round(5), "force_mN": reading}
            frames[j] = pd.DataFrame(columns)
    table["u_force_mN"] = u
    trace = pd.concat([frames[j] for j in sorted(frames)], ignore_index=True)
    return {"spring_slider_runs": table, "spring_slider": trace}
