"""The strip experiment with one numerical setting changed at a time."""

import os
import time
from collections.abc import Callable, Mapping
from typing import Any

from slipstitch.base.errors import NotConverged
from slipstitch.base.progress import note, progress
from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config.simulation import BASE, KEYS, CalibrateSettings, SimulationSettings
from slipstitch.physics import GRAVITY_M_S2

STRIP_YOUNG_MODULI_PA = (6.5e8, 6.5e9)  # of its fabrics: Γ = 2.4 and 0.24
KEPT = (
    *("slip_strain", "flat_strain", "regime", "friction_read_from_strain"),
    *("newton_iterations", "shape_strain"),
)
STEPS_OF_SHAPE = 4  # every so many vertices of a shape are kept
DENSITY_THICKNESS_LENGTH = (0.2, 1.0e-3, 0.2)  # kg/m^2, m, m: as the protocol has them

# What an experiment does not exercise: the grid's mesh, what is recorded, the bench, and the law.
NOT_NUMERICAL = {
    *("vertices_per_side", "frames", "frame_rate_hz", "stage", "pins", "settle_s"),
    *("model", "warp", "self_contact", "thickness_m", "layer_friction"),
    *("yaw_sd_deg", "height_sd_m", "fabric_sd_rel", "natural_curl_per_m"),
    *("curl_side", "ideal_replicates"),
}

RunProtocol = Callable[[str, dict[str, Any], SimulationSettings], Mapping[str, Any]]


def gamma_of(young_modulus_Pa: float) -> float:
    """Γ = ρ g L³ / B of the strip, B = E t³/12."""
    density, thickness, length = DENSITY_THICKNESS_LENGTH
    return 12 * density * GRAVITY_M_S2 * length**3 / (young_modulus_Pa * thickness**3)


def verified_settings(simulation: SimulationSettings) -> dict[str, Any]:
    """The numerical settings that the experiments exercise, as JSON can hold them."""
    return simulation.model_dump(mode="json", exclude=NOT_NUMERICAL)


def variations(
    key: str, settings: CalibrateSettings, simulation: SimulationSettings
) -> list[dict[str, Any]]:
    """All settings to be tried, values of `KEYS`: but for one key as configured, or all."""
    base = {one: getattr(simulation, one, settings.strip_vertices) for one in KEYS}
    if key == BASE:
        return [base]
    values = getattr(settings, f"sweep_{key}")
    return [base | {key: value} for value in sorted(set(values)) if value != base[key]]


def sweep_inputs(
    key: str, settings: CalibrateSettings, simulation: SimulationSettings
) -> dict[str, Any]:
    """The settings that the runs of one key depend on: they are rerun when one changes."""
    return {
        "tried": variations(key, settings, simulation),
        "frictions": settings.strip_frictions,
        "young_moduli_Pa": STRIP_YOUNG_MODULI_PA,
        "simulation": verified_settings(simulation),
    }


def _run(modulus, friction, vertices, simulation, run_protocol) -> dict[str, Any]:
    from slipstitch.physics.experiments.strip import strip_slip_strain, theory_regime

    options = {"friction": friction, "gamma": gamma_of(modulus), "vertices": vertices}
    began, result, failure = time.process_time(), {}, None
    try:
        result = run_protocol("strip", options, simulation)
    except NotConverged as error:
        failure = str(error)
    shape_m = result.get("shape_m", [])[::STEPS_OF_SHAPE]
    return {
        "young_modulus_Pa": modulus,
        "friction": friction,
        **{key: result.get(key) for key in KEPT},
        "theory_slip_strain": strip_slip_strain(friction),
        "theory_regime": theory_regime(friction),
        "shape_m": [[round(value, 6) for value in point] for point in shape_m],
        "failure": failure,
        "cpu_s": round(time.process_time() - began, 3),
    }


def sweep(
    key: str, settings: CalibrateSettings, simulation: SimulationSettings, run_protocol: RunProtocol
) -> list[dict[str, Any]]:
    """Push the strip with all settings of one key; one line each on stderr.

    Each result has ``key``, ``settings`` and ``runs``, by fabric and friction coefficient.
    """
    results = []
    for tried in progress(variations(key, settings, simulation), unit="setting"):
        numerical = {name: value for name, value in tried.items() if name != "vertices"}
        with_them = simulation.model_copy(update=numerical)
        runs = [
            _run(modulus, friction, int(tried["vertices"]), with_them, run_protocol)
            for modulus in STRIP_YOUNG_MODULI_PA
            for friction in settings.strip_frictions
        ]
        results.append({"key": key, "settings": tried, "runs": runs})
        cpu_s = sum(run["cpu_s"] for run in runs)
        shown = "as configured" if key == BASE else f"{key} = {tried[key]:g}"
        note(f"strip, {shown}: {cpu_s:.1f} CPU s")
    return results


def sweep_to_file(config, key: str, out: str | os.PathLike) -> list[dict[str, Any]]:
    """Try the settings of one key with the strip and write the runs, judged by nobody yet."""
    from slipstitch.physics.experiments.registry import run_protocol

    started = start_clock()
    trials = sweep(key, config.calibrate, config.simulation, run_protocol)
    sections = {"simulation": config.simulation, "calibrate": config.calibrate}
    record = provenance_record("calibrate.sweep", config=sections, started=started)
    inputs = sweep_inputs(key, config.calibrate, config.simulation)
    write_json(out, [trial | {"inputs": inputs} for trial in trials], record, indent=None)
    return trials
