"""Results of the convergence study for runs similar to a given one, for its metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.bench.gravity import GRAVITY_M_S2
from slipstitch.config.simulation import SimulationSettings, StageSettings
from slipstitch.material import load_fabric

# Written by `slipstitch convergence publish`.
MEASURED = Path(__file__).with_name("convergence.json")


def bending_length_m(material: str) -> float:
    """(ke / rho g)^(1/3) of nearly flat cloth, the mean over directions: how a fabric drapes."""
    fabric = load_fabric(material)
    stiffness_N_m = fabric.bending_N_m[:, 0].mean()
    return float(np.cbrt(stiffness_N_m / fabric.areal_density_kg_m2 / GRAVITY_M_S2))


def measured_convergence(
    material: str,
    friction: float,
    settings: SimulationSettings,
    step_s: float,
    measured: Path = MEASURED,
) -> dict[str, Any] | None:
    """The studied case nearest to a run: the fabric that drapes most alike, then the friction.

    Parameters
    ----------
    material, friction, settings
        Of the run.
    step_s : float
        The time step that it uses.
    measured : path
        Summary of a study.

    Returns
    -------
    dict or None
        ``nearest`` (material, friction), ``studied`` (time_step_s, vertices_per_side, window_s),
        ``applies`` (whether the run is at least as fine, and its stage moves as the paper's),
        ``time_step`` and ``mesh`` (distances to the finest run, timing of events; see
        `slipstitch.convergence.study.summary`), ``converged`` (None: not known), and ``note`` in
        words. None if no study came with the package.
    """
    if not measured.is_file():
        return None
    study = json.loads(measured.read_text(encoding="utf-8"))
    length_m = bending_length_m(material)

    def far(case):
        return abs(np.log(bending_length_m(case["material"]) / length_m)), abs(
            case["friction"] - friction
        )

    case = min(study["cases"], key=far)
    studied = study["studied"]
    same_stage = settings.stage == StageSettings()
    applies = (
        same_stage
        and step_s <= studied["time_step_s"] * (1 + 1e-9)
        and settings.vertices_per_side >= studied["vertices_per_side"]
    )
    return {
        "nearest": {"material": case["material"], "friction": case["friction"]},
        "studied": studied,
        "applies": applies,
        "time_step": case["time_step"],
        "mesh": case["mesh"],
        "converged": case["converged"] if applies else None,
        "note": _note(case, applies) if same_stage else "other stage path: not studied",
    }


def _note(case: dict[str, Any], applies: bool) -> str:
    if not applies:
        return "coarser than the studied settings: unknown"
    parts = []
    for key, name in (("time_step", "finest time step"), ("mesh", "finest mesh")):
        found = case[key]
        if found is None:
            parts.append(f"{name.removeprefix('finest ')} not studied")
        else:
            parts.append(
                f"{1e3 * found['mean_m']:.2f} mm from the {name} on average, "
                f"{1e3 * found['mean_largest_m']:.2f} mm at the worst time, "
                f"{1e3 * found['worst_m']:.1f} mm at the worst vertex, events up to "
                f"{found['event_shift_s']:.2f} s apart"
            )
    verdict = {True: "converged", False: "not converged", None: "convergence unknown"}[
        case["converged"]
    ]
    return f"{verdict} at {case['material']}, friction {case['friction']:g}: {'; '.join(parts)}"
