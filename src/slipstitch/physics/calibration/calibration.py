"""Choosing settings with the strip, checking them against theory, writing the verified ones."""

import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from tqdm import tqdm

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import provenance_record, read_json, start_clock, write_json
from slipstitch.config.calibrate import BASE, KEYS
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.calibration.choice import (
    STRIP_FRICTION,
    STRIP_SLIP_STRAIN,
    DemandNotMet,
    choose,
    describe,
    judge,
    may_be_chosen,
)
from slipstitch.physics.calibration.experiments import Check, experiments
from slipstitch.physics.calibration.sweep import sweep, sweep_inputs, variations, verified_settings
from slipstitch.physics.simulation.convergence import (
    CONVERGED,
    read_study,
    studied_settings_that_differ,
    study_digest,
)

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

RunProtocol = Callable[[str, dict[str, Any], SimulationSettings], Mapping[str, Any]]
Draw = Callable[[Mapping[str, Any], Mapping[str, Any], bool], None]


def calibrate(simulation: SimulationSettings, run_protocol: RunProtocol) -> dict[str, Any]:
    """Run every experiment with the configured numerical settings.

    Parameters
    ----------
    simulation : SimulationSettings
        Settings to verify.
    run_protocol : callable
        ``registry.run_protocol``: name, options and settings to a result (SI units).

    Returns
    -------
    dict
        ``settings`` (verified), ``met`` (all of them), ``checks`` (list of `Check` as mappings)
        and ``experiments`` (protocol, options, result and wall time in s of each run).
    """
    checks, runs = [], []
    planned = experiments()
    for experiment in tqdm(planned, unit="experiment", disable=not sys.stderr.isatty()):
        began = time.perf_counter()
        judged, result = experiment.run(
            lambda name, options: run_protocol(name, dict(options), simulation)
        )
        checks += [check.as_dict() for check in judged]
        runs.append(
            {
                "protocol": experiment.protocol,
                "options": experiment.options,
                "result": result,
                "wall_s": round(time.perf_counter() - began, 3),
            }
        )
        print(
            f"{experiment.describe()}: "
            f"{'agrees with theory' if all(check.met for check in judged) else 'NOT MET'}, "
            f"{runs[-1]['wall_s']:.1f} s",
            file=sys.stderr,
            flush=True,
        )
        for check in judged:
            if not check.met:
                print(f"  {check.describe()}", file=sys.stderr, flush=True)
    return {
        "settings": verified_settings(simulation),
        "met": all(check["met"] for check in checks),
        "checks": checks,
        "experiments": runs,
    }


def write_calibration(calibration: Mapping[str, Any], path: str | os.PathLike, record) -> None:
    """Write a calibration that met its requirements, with its provenance record.

    Raises
    ------
    DemandNotMet
        If a requirement is not met: one line naming the check; nothing is written, and the whole
        report goes to stderr.
    """
    failed = [check for check in calibration["checks"] if not check["met"]]
    if failed:
        json.dump(calibration, sys.stderr, indent=1, default=str)
        print(file=sys.stderr, flush=True)
        others = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise DemandNotMet(Check(**failed[0]).describe() + others)
    write_json(path, calibration, record)


def strip_calibration(trials: list[dict[str, Any]]) -> dict[str, Any]:
    """Choose settings by the pushed strip, from what `sweep.sweep` returned of all keys.

    Returns
    -------
    dict
        ``demand``, ``trials`` (judged), ``chosen`` (one of them, with the strips' shapes) and
        ``not_told`` (what the strip does not tell).

    Raises
    ------
    DemandNotMet
        If no eligible settings meet the requirements; ``trials`` is its second argument.
    """
    judged = [judge(trial) for trial in trials]
    base = next(trial for trial in judged if trial["key"] == BASE)
    try:
        chosen = choose(judged)
    except DemandNotMet as error:
        raise DemandNotMet(str(error), judged) from None
    return {
        "demand": {"slip_strain": STRIP_SLIP_STRAIN, "friction": STRIP_FRICTION},
        "trials": [
            _without_shapes(trial) | {"may_be_chosen": may_be_chosen(trial, base["settings"])}
            for trial in judged
        ],
        "chosen": chosen,
        "not_told": list(NOT_TOLD),
    }


def _without_shapes(trial: Mapping[str, Any]) -> dict[str, Any]:
    runs = [{k: v for k, v in run.items() if k != "shape_m"} for run in trial["runs"]]
    distance = trial["distance"] if trial["distance"] < float("inf") else None
    return {**trial, "runs": runs, "distance": distance}


def chosen_simulation(simulation: SimulationSettings, strip: Mapping[str, Any]):
    """The section ``simulation`` with the chosen settings."""
    chosen = {k: v for k, v in strip["chosen"]["settings"].items() if k != "vertices"}
    return simulation.model_copy(update=chosen)


def calibrate_to_file(
    config,
    out: str | os.PathLike,
    sweeps: list[str | os.PathLike] | None = None,
    draw: Draw | None = None,
) -> dict:
    """Calibrate with a whole configuration and write the JSON file.

    Parameters
    ----------
    config : Config
    out : path
        The JSON file.
    sweeps : list of path, optional
        What `sweep.sweep_to_file` wrote, of all keys; made now if not given.
    draw : callable, optional
        Told what there is to draw, its record, and whether a requirement is not met; see
        `pictures.draw_pictures`. Handed over, so that plots are no part of the calibration: else
        another line width would simulate everything again.

    Raises
    ------
    BadInput
        If a sweep's file cannot be read or belongs to another configuration.
    DemandNotMet
        If a requirement is not met.
    """
    from slipstitch.physics.experiments.registry import run_protocol

    started = start_clock()
    settings, simulation = config.calibrate, config.simulation
    if sweeps is None:
        keys = (BASE, *KEYS)
        trials = [trial for key in keys for trial in sweep(key, settings, simulation, run_protocol)]
    else:
        trials = read_sweeps(sweeps, config)
    record = provenance_record(
        "calibrate.calibration",
        inputs=list(sweeps or ()),
        config={"simulation": simulation, "calibrate": settings},
        started=started,
    )
    try:
        strip = strip_calibration(trials)
    except DemandNotMet as error:
        if draw is not None:
            draw({"strip": {"trials": error.args[1]}}, record, True)
        raise DemandNotMet(error.args[0]) from None
    print(f"strip: chosen: {describe(strip['chosen'])}", file=sys.stderr, flush=True)
    calibration = calibrate(chosen_simulation(simulation, strip), run_protocol)
    calibration["strip"] = strip
    calibration |= _known_convergence(chosen_simulation(simulation, strip))
    if draw is not None:
        draw(calibration, record, not calibration["met"])
    write_calibration(calibration, out, record)
    return calibration


def _known_convergence(simulation: SimulationSettings) -> dict[str, Any]:
    """What the convergence study says of each fabric and coefficient at the chosen settings.

    And the digest of its table, which may be another when simulations are made.

    Not converged, or not known, is said aloud but is no error: the mesh is not chosen here, and no
    known answer tells how short a step a fabric needs.
    """
    study = read_study()
    if study is None:
        print("convergence: no study came with the package", file=sys.stderr, flush=True)
        return {"convergence": None}
    differ = studied_settings_that_differ(study["studied"], simulation)
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
            if one["verdict"] != CONVERGED
        )
    print(f"convergence: {words or CONVERGED}", file=sys.stderr, flush=True)
    return {"convergence": found, "convergence_table_sha256": study_digest()}


def read_sweeps(paths: list[str | os.PathLike], config) -> list[dict[str, Any]]:
    """Read sweeps, all keys of them, made with this configuration.

    Raises
    ------
    BadInput
        If a file cannot be read, or what was tried, or with what other settings, is not as in the
        configuration.
    """
    trials = []
    for path in paths:
        sweep = read_json(path)
        if not isinstance(sweep, list) or not all(
            isinstance(trial, dict) and "settings" in trial for trial in sweep
        ):
            raise Damaged(path, "not a sweep of the calibration")
        trials += sweep
    expected = [
        setting
        for key in (BASE, *KEYS)
        for setting in variations(key, config.calibrate, config.simulation)
    ]
    tried = [trial["settings"] for trial in trials]
    missing = [setting for setting in expected if setting not in tried]
    again = "regenerate them with: snakemake --cores 2 calibrate"
    if missing or len(tried) != len(expected):
        raise BadInput(
            f"{paths[0]} and others: {len(tried)} settings tried, but the configuration has "
            f"{len(expected)}; {again}"
        )
    for trial in trials:
        inputs = json.loads(
            json.dumps(sweep_inputs(trial["key"], config.calibrate, config.simulation))
        )
        made_with = trial.pop("inputs", {})
        other = sorted(key for key in inputs if made_with.get(key) != inputs[key])
        if other:
            raise BadInput(
                f"{paths[0]} and others: {trial['key']}: pushed with other {', '.join(other)} than "
                f"the configuration's; {again}"
            )
    return trials
