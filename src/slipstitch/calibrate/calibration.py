"""Running the known-answer experiments and writing what they verified."""

import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from slipstitch.calibrate.experiments import experiments
from slipstitch.calibrate.settings import CalibrateSettings
from slipstitch.errors import SlipstitchError
from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar
from slipstitch.simulate.settings import SimulationSettings

# What an experiment does not exercise: the grid's mesh, what is recorded, and the bench.
NOT_NUMERICAL = frozenset(
    {
        "vertices_per_side",
        "frames",
        "frame_rate_hz",
        "pins",
        "settle_s",
        "yaw_sd_deg",
        "height_sd_m",
        "fabric_sd_rel",
        "natural_curl_per_m",
    }
)

RunProtocol = Callable[[str, dict[str, Any], SimulationSettings], Mapping[str, Any]]


class DemandNotMet(SlipstitchError):  # noqa: N818 - says what happened, as the other errors do
    """The simulator does not agree with theory as closely as demanded; exit code 1."""


def verified_settings(simulation: SimulationSettings) -> dict[str, Any]:
    """The numerical settings that the experiments exercise, as JSON can hold them."""
    return simulation.model_dump(mode="json", exclude=set(NOT_NUMERICAL))


def calibrate(
    settings: CalibrateSettings, simulation: SimulationSettings, run_protocol: RunProtocol
) -> dict[str, Any]:
    """Run every configured experiment with the configured numerical settings.

    Parameters
    ----------
    settings : CalibrateSettings
        Which experiments, and the demands.
    simulation : SimulationSettings
        Settings to verify.
    run_protocol : callable
        ``slipstitch.protocol.run_protocol``: name, options and settings to a mapping of results
        (SI units).

    Returns
    -------
    dict
        ``settings`` (verified), ``met`` (all of them), ``checks`` (list of `Check` as mappings)
        and ``experiments`` (protocol, options, result and wall time in s of each run).

    Raises
    ------
    SlipstitchError
        If an experiment fails altogether.
    """
    checks, runs = [], []
    planned = experiments(settings)
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
            f"{'as theory says' if all(check.met for check in judged) else 'NOT MET'}, "
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
    """Write a calibration that met its demands, with its provenance beside it.

    Parameters
    ----------
    calibration : mapping
        What `calibrate` returned.
    path : path
        The JSON file.
    record : mapping
        Its provenance.

    Raises
    ------
    DemandNotMet
        If a demand is not met: one line naming the check; nothing is written, and the whole
        report goes to stderr.
    """
    failed = [check for check in calibration["checks"] if not check["met"]]
    if failed:
        json.dump(calibration, sys.stderr, indent=1, default=str)
        print(file=sys.stderr, flush=True)
        raise DemandNotMet(_failure(failed))
    with atomic_path(path) as temporary:
        Path(temporary).write_text(
            json.dumps(calibration, indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
    write_sidecar(path, record)


def _failure(failed: list[Mapping[str, Any]]) -> str:
    from slipstitch.calibrate.experiments import Check

    others = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
    return Check(**failed[0]).describe() + others


def calibrate_to_file(config, out: str | os.PathLike, picture: str | os.PathLike | None) -> dict:
    """Calibrate with a whole configuration and write JSON and picture.

    Parameters
    ----------
    config : Config
        The configuration.
    out : path
        The JSON file.
    picture : path or None
        PNG or SVG of measured against theory; drawn also if a demand is not met, then not under
        this name but with ``.failed`` before its suffix.

    Returns
    -------
    dict
        The calibration.

    Raises
    ------
    DemandNotMet
        If a demand is not met.
    """
    from slipstitch.protocol import run_protocol

    started = start_clock()
    calibration = calibrate(config.calibrate, config.simulation, run_protocol)
    record = provenance_record(
        "calibrate",
        config={"simulation": config.simulation, "calibrate": config.calibrate},
        started=started,
    )
    if picture is not None:
        from slipstitch.calibrate.picture import draw_calibration

        picture = Path(picture)
        if not calibration["met"]:
            picture = picture.with_suffix(f".failed{picture.suffix}")
        with atomic_path(picture) as temporary:
            draw_calibration(calibration, temporary, picture.suffix.lstrip(".") or "png")
        write_sidecar(picture, record)
    write_calibration(calibration, out, record)
    return calibration
