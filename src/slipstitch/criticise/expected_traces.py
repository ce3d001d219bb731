"""Readings of a campaign that is still to be made, as a plain bench would give them.

Read like measured ones, they give a design all features of a campaign, each with the error that
the reader gives it. What a table of runs does not tell is assumed (:data:`ASSUMPTIONS`), unless
``meta.json`` says it under ``design``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import Case, is_number
from slipstitch.criticise.causes import Bench
from slipstitch.criticise.measurements import COEFFICIENTS, Measurements, assemble
from slipstitch.criticise.protocols import PROTOCOLS, incline, strip
from slipstitch.criticise.protocols.dragged_cloth import rest_state, sliding_state, sticking_path
from slipstitch.criticise.protocols.protocol import weights_of
from slipstitch.criticise.protocols.push import USUAL_STIFFNESS_N_M
from slipstitch.criticise.protocols.stick_slip import Slider
from slipstitch.physics import GRAVITY_M_S2
from slipstitch.physics.friction_law import Contact, FrictionLaw

USUAL_SPEED_MM_S, USUAL_QUIET_S = 10.0, 0.4
MOST_READINGS = 20_000  # of a run
LARGEST_SLOPE_DEG = 60.0  # of the incline
LARGEST = 1e5


@dataclass(frozen=True)
class Assumption:
    """Something that the tables of runs do not tell, for one protocol or (None) for all."""

    name: str
    value: float
    unit: str
    meaning: str
    protocol: str | None = None


# The coefficients and scatters are those from which the fits start; texture, noise and strokes as
# on the benches of the tests, the stroke of (d) that of the simulation, (f) as in data/cases.
ASSUMPTIONS = (
    Assumption("mu_face", 0.3, "1", "coefficient of the face"),
    Assumption("mu_edge", 0.25, "1", "coefficient of the edge", "strip"),
    Assumption("scatter_specimen", 0.05, "1", "scatter between specimens"),
    Assumption("scatter_run", 0.03, "1", "scatter between runs"),
    Assumption("noise_factor", 1.2, "1", "noise over what is stated"),
    Assumption("drag_stroke_mm", 50.0, "mm", "stroke", "drag"),
    Assumption("drag_step_mm", 0.2, "mm", "way between readings", "drag"),
    Assumption("drag_texture_sd", 0.02, "1", "sd of friction along the way", "drag"),
    Assumption("drag_texture_mm", 1.5, "mm", "length over which it is correlated", "drag"),
    Assumption("drop_drag_stroke_mm", 300.0, "mm", "stroke", "drop_drag"),
    Assumption("drop_drag_step_mm", 3.0, "mm", "way between frames", "drop_drag"),
    Assumption("slider_travel_mm", 30.0, "mm", "way after the first slip", "spring_slider"),
    Assumption("slider_readings", 24.0, "1", "readings a natural period", "spring_slider"),
    Assumption("slider_texture_sd", 0.02, "1", "sd of friction along the way", "spring_slider"),
    Assumption(
        "slider_texture_mm", 1.5, "mm", "length over which it is correlated", "spring_slider"
    ),
    Assumption("push_travel_mm", 11.0, "mm", "way of the block, where moved_mm is empty", "push"),
    Assumption("push_step_s", 0.01, "s", "time between readings", "push"),
    Assumption("push_texture_sd", 0.02, "1", "sd of friction along the way", "push"),
    Assumption("push_texture_mm", 1.5, "mm", "length over which it is correlated", "push"),
    Assumption("push_damping", 0.1, "1", "damping ratio of the block on the finger", "push"),
)


def assumptions_of(case: Case) -> dict[str, float]:
    """Values of the assumptions that concern a case's protocols.

    Raises BadInput if ``meta.json`` has under ``design`` what is no such assumption.
    """
    given = case.meta.get("design") or {}
    names = [assumption.name for assumption in ASSUMPTIONS]
    limits = {c.name: (math.exp(c.lower), math.exp(c.upper)) for c in COEFFICIENTS}
    if not isinstance(given, Mapping):
        raise BadInput(f"{case.name}: meta.json: design: must be a mapping")
    for name, value in given.items():
        where = f"{case.name}: meta.json: design.{name}"
        if name not in names:
            raise BadInput(f"{where}: unknown; known: {' '.join(names)}")
        if not is_number(value) or not 0 < value < LARGEST:
            raise BadInput(f"{where}: {value!r}; must be a positive number below {LARGEST:g}")
        low, high = limits.get(name, (0.0, math.inf))
        if not low < value < high:
            raise BadInput(f"{where}: {value!r}; must be between {low:g} and {high:g}")
    own = case.protocols_of_runs
    return {
        a.name: float(given.get(a.name, a.value))
        for a in ASSUMPTIONS
        if a.protocol is None or a.protocol in own
    }


def expected(case: Case, assumed: Mapping[str, float], seed: int) -> Measurements:
    """Features of a design, with the errors that those of its campaign would have."""
    rng = np.random.default_rng([seed, 17])
    tables = {}
    for name in case.protocols_of_runs:
        own = list(PROTOCOLS[name].tables)
        runs = case.tables[own[0]]
        tables[own[0]] = runs.copy()
        readings = _READINGS[name](tables[own[0]], case.nominal, assumed, rng)
        if len(own) > 1:
            tables[own[1]] = pd.concat(
                [
                    part.assign(run_id=run)
                    for part, run in zip(readings, runs["run_id"], strict=True)
                ],
                ignore_index=True,
            )
    return assemble(replace(case, tables=tables))


def _incline(trials, nominal, assumed, rng) -> None:
    block = incline.features({"incline": trials}, nominal, False)
    trials["angle_deg"] = block.predict(FrictionLaw(assumed["mu_face"]), Bench())
    trials["censored"] = (trials["angle_deg"] > LARGEST_SLOPE_DEG) * 1.0


def _strip(trials, nominal, assumed, rng) -> None:
    block = strip.features({"strip": trials}, nominal, False)
    weight_number = block.areal_mass_kg_m2 * GRAVITY_M_S2 * block.length_m**3 / block.bending_Nm
    flat = strip.areal_contact(weight_number)[1]
    strain = block.predict(FrictionLaw(assumed["mu_edge"]), Bench())
    trials["regime"] = np.where(strain < flat, "slipped", "partial")
    trials["eps_slip"] = np.minimum(strain, flat)


def _textured(rng, count: int, step_mm: float, assumed, protocol: str) -> np.ndarray:
    """Friction along the way over its mean, (count,): an autoregression."""
    sd, length = assumed[f"{protocol}_texture_sd"], assumed[f"{protocol}_texture_mm"]
    kept = np.exp(-step_mm / length)
    white = rng.standard_normal(count)
    white[1:] *= np.sqrt(1 - kept**2)
    return 1.0 + sd * lfilter([1.0], [1.0, -kept], white)


def _drag(runs, nominal, assumed, rng) -> Iterator[pd.DataFrame]:
    spring, step = nominal["k_tether_N_m"], assumed["drag_step_mm"]
    step = max(step, assumed["drag_stroke_mm"] / MOST_READINGS)
    x = np.arange(0.0, assumed["drag_stroke_mm"] + 0.5 * step, step)
    levels = 1e3 * assumed["mu_face"] * weights_of(runs, nominal)
    for level, u, speed in zip(levels, runs["u_force_mN"], runs["speed_mm_s"], strict=True):
        friction = level * _textured(rng, len(x), step, assumed, "drag")
        out = _slid(spring * x, friction)
        # Back, friction points the other way, and the spring has to be unloaded first.
        back = out[-1] - _slid(spring * x, out[-1] + friction[::-1])
        time = x / (USUAL_SPEED_MM_S if np.isnan(speed) else speed)
        noise = assumed["noise_factor"] * u * rng.standard_normal(2 * len(x))
        yield pd.DataFrame(
            {
                "stroke": np.repeat([0, 1], len(x)),
                "t_s": np.concatenate([time, time[-1] + time]),
                "x_stage_mm": np.concatenate([x, x[::-1]]),
                "v_mm_s": np.nan,
                "force_mN": np.concatenate([out, back]) + noise,
            }
        )


def _slid(spring_mN: np.ndarray, friction_mN: np.ndarray) -> np.ndarray:
    """The spring's force until the first slip, then the friction's."""
    slipped = np.maximum.accumulate(spring_mN >= friction_mN)
    return np.where(slipped, friction_mN, spring_mN)


def _drop_drag(runs, nominal, assumed, rng) -> Iterator[pd.DataFrame]:
    count, stroke = len(runs), assumed["drop_drag_stroke_mm"]
    height = runs["height_mm"].to_numpy(float) * 1e-3
    weight = np.full(count, nominal["rho_kg_m2"] * GRAVITY_M_S2)
    bending, length = np.full(count, nominal["B_Nm"]), np.full(count, nominal["cloth_length_m"])
    fabric = (weight, bending, length, height)
    contact = Contact(normal_force_N=np.full(count, np.nan))
    distance, flat = sliding_state(FrictionLaw(assumed["mu_face"]), *fabric, contact, False)
    lags = 1e3 * (distance - rest_state(*fabric)[0])
    advances, lifting = sticking_path(weight[0], bending[0], length[0], height)
    step = max(assumed["drop_drag_step_mm"], stroke / MOST_READINGS)
    out = np.arange(0.0, stroke + 0.5 * step, step)
    for i, (lag, u) in enumerate(zip(lags, runs["u_pos_mm"], strict=True)):
        # As far back as the edge has not moved yet.
        back = np.arange(stroke - step, max(stroke - lag, 0.0), -step)
        x = np.concatenate([out, back])
        forward = np.arange(len(x)) < len(out)
        edge = np.where(forward, np.maximum(x - lag, 0.0), stroke - lag)
        lifted = np.interp(1e-3 * (x - edge), advances[i], lifting[i])
        touching = np.where(forward & (x >= lag), flat[i], lifted)
        noise = assumed["noise_factor"] * u * rng.standard_normal((2, len(x)))
        yield pd.DataFrame(
            {
                "frame": np.arange(len(x)),
                "phase": np.where(forward, "fwd", "rev"),
                "t_s": step * np.arange(len(x)) / USUAL_SPEED_MM_S,
                "x_stage_mm": x,
                "te_x_mm": edge + noise[0],
                "contact_len_mm": 1e3 * touching + noise[1],
            }
        )


def _spring_slider(runs, nominal, assumed, rng) -> Iterator[pd.DataFrame]:
    weights = weights_of(runs, nominal)
    columns = (runs[name].to_numpy(float) for name in ("spring_N_m", "speed_mm_s", "u_force_mN"))
    for weight, spring, speed, u in zip(weights, *columns, strict=True):
        slider = Slider(weight / GRAVITY_M_S2, spring, 1e-3 * speed)
        level = 1e3 * assumed["mu_face"] * weight
        frequency = np.sqrt(spring / slider.mass_kg)
        duration = (level / spring + assumed["slider_travel_mm"]) / speed
        step = 2 * np.pi / frequency / assumed["slider_readings"]
        time = np.arange(0.0, duration, max(step, duration / MOST_READINGS))
        uneven = level * _textured(rng, len(time), speed * time[1], assumed, "slider")
        # Without a static excess, the spring swings by the slider's inertia alone.
        swinging = 1e3 * slider.inertial_force * np.sin(frequency * (time - level / spring / speed))
        loading = spring * speed * time
        force = np.where(loading < level, loading, uneven + swinging)
        noise = assumed["noise_factor"] * u * rng.standard_normal(len(time))
        yield pd.DataFrame({"t_s": time, "force_mN": force + noise})


def _push(runs, nominal, assumed, rng) -> Iterator[pd.DataFrame]:
    quiet = runs["quiet_s"].fillna(USUAL_QUIET_S)
    way = runs["moved_mm"].fillna(assumed["push_travel_mm"])
    weights = weights_of(runs, nominal)
    columns = (quiet, way, runs["speed_mm_s"], runs["u_force_mN"])
    for weight, start, distance, speed, u in zip(weights, *columns, strict=True):
        slider = Slider(weight / GRAVITY_M_S2, USUAL_STIFFNESS_N_M, 1e-3 * speed)
        level = 1e3 * assumed["mu_face"] * weight
        slip = start + level / USUAL_STIFFNESS_N_M / speed
        duration = slip + distance / speed
        step = max(assumed["push_step_s"], duration / MOST_READINGS)
        time = np.arange(0.0, duration, step)
        uneven = level * _textured(rng, len(time), speed * step, assumed, "push")
        angle = np.sqrt(USUAL_STIFFNESS_N_M / slider.mass_kg) * np.maximum(time - slip, 0.0)
        fading = np.exp(-assumed["push_damping"] * angle) * np.sin(angle)
        loading = USUAL_STIFFNESS_N_M * speed * np.maximum(time - start, 0.0)
        force = np.where(time < slip, loading, uneven + 1e3 * slider.inertial_force * fading)
        noise = assumed["noise_factor"] * u * rng.standard_normal((2, len(time)))
        yield pd.DataFrame({"t_s": time, "force_x_mN": force + noise[0], "force_y_mN": noise[1]})


_READINGS: Mapping[str, Callable] = {
    "incline": _incline,
    "strip": _strip,
    "drag": _drag,
    "drop_drag": _drop_drag,
    "spring_slider": _spring_slider,
    "push": _push,
}
