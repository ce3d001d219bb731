"""Choosing settings with the strip, checking them against theory, writing the verified ones."""

import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.progress import note, progress
from slipstitch.config.simulation import BASE, KEYS, SimulationSettings
from slipstitch.physics.calibration.sweep import RunProtocol, sweep, sweep_inputs, verified_settings
from slipstitch.physics.experiments.specimen import Demand
from slipstitch.physics.simulation import convergence

# Largest errors of the strain at slip, and of the friction coefficient inferred from that strain.
STRIP_SLIP_STRAIN = 6e-3
STRIP_FRICTION = 5e-3

# Looser values than the configured ones are tried and shown, but never chosen: the strip does not
# tell what they do to the cloth (docs/how/physics.md). The strip's own mesh is not the cloth's.
NEVER_LOOSER = ("time_step_s", "friction_tolerance", "damping_s")
FREE = ("newton_iterations_max",)
# Said in calibration.json, in the words of docs/how/physics.md.
NOT_TOLD = (
    "mesh: the strip is a cylinder along mesh lines, accurate even at a spacing of 15 mm; the "
    "cloth folds and wrinkles in two directions: the mesh of drop-and-drag is not chosen here",
    "time step: the strip is pushed slowly and evenly; it does not test how the cloth rolls over "
    "at a reversal, or to which side it buckles: no step larger than simulation.time_step_s",
    "tolerance: a strip slips once, at its foot, which carries the whole load; a cloth rests on "
    "many vertices with little load each: no tolerance larger than simulation.friction_tolerance",
    "damping: negligible in the slow push: none larger than simulation.damping_s",
    "self-contact, anisotropy and strain-dependent stiffness: not tested by the strip",
)

INCLINE_FRICTIONS = (0.1, 0.5, 1.2)
# tan(slope) over mu, of which a body sticks below 1 and slides above -> demands by name.
INCLINES = {
    0.999: {
        "sticks": Demand("sticks", relative=False, theory=1.0),
        "creep": Demand("creep_m", 1e-6, relative=False, theory=0.0),  # in 1 s
    },
    1.001: {"sticks": Demand("sticks", relative=False, theory=0.0)},
    1.5: {"acceleration": Demand("acceleration_m_s2", 1e-3)},
}
FLAT_DRAG_FRICTIONS = (0.1, 0.5, 1.0)
FLAT_DRAG = {"pull over weight": Demand("pull_over_weight", 5e-3)}
STRIP_DRAG_FRICTIONS = (0.1, 0.3, 0.6, 1.0, 1.5)
STRIP_DRAG_GRAVITY_LENGTH_M = 0.02  # (B/w)^(1/3)
STRIP_DRAG = {
    "pull": Demand("pull_over_w_m", 0.01),
    "tail": Demand("holder_ahead_of_tail_m", 1e-3, relative=False),
}

Trial = dict[str, Any]
Draw = Callable[[Mapping[str, Any], Mapping[str, Any], bool], None]


class DemandNotMet(SlipstitchError):  # noqa: N818 - says what happened, as the other errors do
    """The simulator deviates from theory by more than the tolerances; exit code 1."""


def judge(trial: Mapping[str, Any]) -> Trial:
    """Add to a trial of `sweep.sweep` what its runs are worth.

    Errors are the largest of the runs that slip, or None; ``distance`` is the largest over its
    limit, infinite with a wrong or unsolved regime; ``work`` is iterations x vertices.
    """
    runs = trial["runs"]
    right = [run for run in runs if run["regime"] == run["theory_regime"]]
    slipped = [run for run in right if run["regime"] == "slipped"]
    strain = [abs(run["slip_strain"] - run["theory_slip_strain"]) for run in slipped]
    friction = [abs((run["friction_read_from_strain"] or 0.0) - run["friction"]) for run in slipped]
    wrong = len(runs) - len(right)
    distance = max(
        max(strain, default=0.0) / STRIP_SLIP_STRAIN, max(friction, default=0.0) / STRIP_FRICTION
    )
    return {
        **trial,
        "strain_error": max(strain, default=None),
        "friction_error": max(friction, default=None),
        "wrong_regimes": wrong,
        "distance": math.inf if wrong else distance,
        "meets": not wrong and distance <= 1.0,
        "work": sum(run["newton_iterations"] or 0 for run in runs) * trial["settings"]["vertices"],
        "cpu_s": round(sum(run["cpu_s"] for run in runs), 3),
    }


def choose(trials: Sequence[Trial]) -> Trial:
    """Return the configured settings if they meet the requirements, else the cheapest that do.

    `DemandNotMet` names the closest if no eligible settings meet the requirements.
    """
    base = next(trial for trial in trials if trial["key"] == BASE)
    if base["meets"]:
        return base
    allowed = [trial for trial in trials if may_be_chosen(trial, base["settings"])]
    meeting = [trial for trial in allowed if trial["meets"]]
    if meeting:
        return min(meeting, key=lambda trial: trial["work"])
    best = min(allowed, key=lambda trial: (trial["wrong_regimes"], trial["distance"]))
    strain, friction = best["strain_error"], best["friction_error"]
    came = "no run slipped"
    if strain is not None:
        came = f"slip strain within {strain:.2g}, friction within {friction:.2g}"
    raise DemandNotMet(
        f"no settings meet the requirements (slip strain within {STRIP_SLIP_STRAIN:g}, friction "
        f"within {STRIP_FRICTION:g}, correct regimes); closest: {describe(best)} with {came}, "
        f"{best['wrong_regimes']} of {len(best['runs'])} regimes wrong"
    )


def may_be_chosen(trial: Mapping[str, Any], base: Mapping[str, Any]) -> bool:
    """Whether a trial differs from the configured settings in nothing but allowed ways."""
    key = trial["key"]
    return key in (BASE, *FREE) or (key in NEVER_LOOSER and trial["settings"][key] < base[key])


def describe(trial: Mapping[str, Any]) -> str:
    """The distinguishing settings of a trial."""
    if trial["key"] == BASE:
        return "the configured settings"
    return f"{trial['key']} = {trial['settings'][trial['key']]:g}"


def describe_check(check: Mapping[str, Any]) -> str:
    """One line: check, options, measured, theory, limit."""
    where = ", ".join(f"{key} {value:.6g}" for key, value in check["options"].items())
    unit = f" {check['unit']}" if check["unit"] else ""
    demand = f"{100 * check['demand']:g} %" if check["relative"] else f"{check['demand']:g}{unit}"
    measured, theory = (
        "nothing" if check[key] is None else f"{check[key]:.6g}" for key in ("measured", "theory")
    )
    return (
        f"{check['name']} at {where}: measured {measured}{unit}, theory {theory}{unit}, "
        f"allowed difference {demand}"
    )


def experiments() -> list[tuple[str, dict[str, float], Mapping[str, Demand]]]:
    """Protocol, options and demands by name of all experiments, the cheap ones first."""
    found: list[tuple[str, dict[str, float], Mapping[str, Demand]]] = [
        ("incline", {"friction": mu, "slope_deg": math.degrees(math.atan(multiple * mu))}, demands)
        for mu in INCLINE_FRICTIONS
        for multiple, demands in INCLINES.items()
    ]
    found += [("flat-drag", {"friction": mu}, FLAT_DRAG) for mu in FLAT_DRAG_FRICTIONS]
    length = {"gravity_length_m": STRIP_DRAG_GRAVITY_LENGTH_M}
    found += [("strip-drag", {"friction": mu} | length, STRIP_DRAG) for mu in STRIP_DRAG_FRICTIONS]
    return found


def _check(protocol: str, options: dict[str, float], name: str, demand: Demand, result) -> Trial:
    key, judged = demand.key, demand.verdict(result)
    values = {"measured": result[key], "theory": demand.expected(result)}
    return {
        "name": f"{protocol} {name}",
        "protocol": protocol,
        "options": options,
        **{
            name: float(value) if value is not None and math.isfinite(value) else None
            for name, value in values.items()
        },
        "error": judged["error"],
        "demand": demand.allowed,
        "relative": demand.relative,
        "unit": "m/s²" if key.endswith("_m_s2") else "m" if key.endswith("_m") else "",
        "met": judged["met"],
    }


def calibrate(simulation: SimulationSettings, run_protocol: RunProtocol) -> dict[str, Any]:
    """Run every experiment with the numerical settings to verify, by `registry.run_protocol`.

    Return ``settings`` (verified), ``met`` (all of them), ``checks`` (one a demand) and
    ``experiments`` (protocol, options, result and wall time in s of each run).
    """
    checks: list[Trial] = []
    runs: list[Trial] = []
    for protocol, options, demands in progress(experiments(), unit="experiment"):
        began = time.perf_counter()
        said = " ".join([protocol, *(f"{key}={value:.6g}" for key, value in options.items())])
        try:
            result = dict(run_protocol(protocol, dict(options), simulation))
        except SlipstitchError as error:
            raise type(error)(f"{said}: {error}") from error
        wall_s = round(time.perf_counter() - began, 3)
        runs.append({"protocol": protocol, "options": options, "result": result, "wall_s": wall_s})
        judged = [
            _check(protocol, options, name, demand, result) for name, demand in demands.items()
        ]
        failed = [check for check in judged if not check["met"]]
        note(f"{said}: {'NOT MET' if failed else 'agrees with theory'}, {wall_s:.1f} s")
        note(*(f"  {describe_check(check)}" for check in failed))
        checks += judged
    return {
        "settings": verified_settings(simulation),
        "met": all(check["met"] for check in checks),
        "checks": checks,
        "experiments": runs,
    }


def write_calibration(calibration: Mapping[str, Any], path: str | os.PathLike, record) -> None:
    """Write a calibration; `DemandNotMet` if it is none, and the whole report on stderr."""
    failed = [check for check in calibration["checks"] if not check["met"]]
    if failed:
        note(json.dumps(calibration, indent=1, default=str))
        others = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise DemandNotMet(describe_check(failed[0]) + others)
    provenance.write_json(path, calibration, record)


def strip_calibration(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Choose settings by the pushed strip, from what `sweep.sweep` returned of all keys.

    Return ``demand``, ``trials`` (judged), ``chosen`` (with the strips' shapes), ``not_told``.
    """
    judged = [judge(trial) for trial in trials]
    base = next(trial for trial in judged if trial["key"] == BASE)
    chosen = choose(judged)
    return {
        "demand": {"slip_strain": STRIP_SLIP_STRAIN, "friction": STRIP_FRICTION},
        "trials": [
            {
                **trial,
                "runs": [{k: v for k, v in run.items() if k != "shape_m"} for run in trial["runs"]],
                "distance": trial["distance"] if trial["distance"] < math.inf else None,
                "may_be_chosen": may_be_chosen(trial, base["settings"]),
            }
            for trial in judged
        ],
        "chosen": chosen,
        "not_told": list(NOT_TOLD),
    }


def calibrate_to_file(
    config,
    out: str | os.PathLike,
    sweeps: list[str | os.PathLike] | None = None,
    draw: Draw | None = None,
) -> dict:
    """Calibrate with a whole configuration and write the JSON file, or raise `DemandNotMet`.

    Without `sweeps`, files of `sweep.sweep_to_file`, they are made now. `draw` gets what there is
    to draw, its record, and whether a requirement is not met; plots are no part of the calibration,
    as another line width would simulate everything again.
    """
    from slipstitch.physics.experiments.registry import run_protocol

    started = provenance.start_clock()
    settings, simulation = config.calibrate, config.simulation
    if sweeps is None:
        keys = (BASE, *KEYS)
        trials = [trial for key in keys for trial in sweep(key, settings, simulation, run_protocol)]
    else:
        trials = read_sweeps(sweeps, config)
    sections, made_of = {"simulation": simulation, "calibrate": settings}, list(sweeps or ())
    record = provenance.provenance_record(
        "calibrate.calibration", inputs=made_of, config=sections, started=started
    )
    try:
        strip = strip_calibration(trials)
    except DemandNotMet:
        if draw is not None:
            draw({"strip": {"trials": [judge(trial) for trial in trials]}}, record, True)
        raise
    note(f"strip: chosen: {describe(strip['chosen'])}")
    chosen = {k: v for k, v in strip["chosen"]["settings"].items() if k != "vertices"}
    simulation = simulation.model_copy(update=chosen)
    calibration = calibrate(simulation, run_protocol) | {"strip": strip}
    calibration |= _known_convergence(simulation)
    if draw is not None:
        draw(calibration, record, not calibration["met"])
    write_calibration(calibration, out, record)
    return calibration


def _known_convergence(simulation: SimulationSettings) -> dict[str, Any]:
    """What the convergence study says at the chosen settings, and the digest of its table."""
    study = convergence.read_study()
    differ = convergence.studied_settings_that_differ(study["studied"], simulation)
    found = [
        {key: case[key] for key in ("material", "friction")}
        | {"verdict": None if differ else case["verdict"]}
        for case in study["cases"]
    ]
    if differ:
        words = f"nothing is known: studied with other {', '.join(differ)}"
    else:
        words = "; ".join(
            f"{one['material']} at {one['friction']:g} {one['verdict'] or 'not known'}"
            for one in found
            if one["verdict"] != convergence.CONVERGED
        )
    note(f"convergence: {words or convergence.CONVERGED}")
    return {"convergence": found, "convergence_table_sha256": convergence.study_digest()}


def read_sweeps(paths: list[str | os.PathLike], config) -> list[dict[str, Any]]:
    """Read sweeps of all keys; BadInput if they were not made with this configuration."""
    expected = {
        key: json.loads(json.dumps(sweep_inputs(key, config.calibrate, config.simulation)))
        for key in (BASE, *KEYS)
    }
    again = "regenerate them with: snakemake --cores 2 calibrate"
    trials: list[dict[str, Any]] = []
    for path in paths:
        with provenance.reading(path, "sweep of the calibration"):
            for trial in provenance.read_json(path):
                inputs, made_with = expected[trial["key"]], trial.pop("inputs", {})
                other = sorted(name for name in inputs if made_with.get(name) != inputs[name])
                if other:
                    raise BadInput(
                        f"{path}: {trial['key']}: pushed with other {', '.join(other)} than the "
                        f"configuration's; {again}"
                    )
                trials.append(trial)
    count = sum(len(inputs["tried"]) for inputs in expected.values())
    if len(trials) != count:
        said = f"{len(trials)} settings tried, but the configuration has {count}; {again}"
        raise BadInput(f"{paths[0]} and others: {said}")
    return trials
