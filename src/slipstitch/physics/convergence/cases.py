"""The runs of the study. Imports little: rules of the workflow list them."""

import math
import os
from dataclasses import dataclass
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock
from slipstitch.config import Config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import friction_id, material_id

HALVINGS = 2  # of the time step, in the runs with finer steps
SEED = 0  # of the perturbation of the bench, the same for all runs
FRAME_RATE_HZ = 12.0  # of the comparisons: a fold that rolls over takes some tenths of a second


@dataclass(frozen=True)
class StudyCase:
    """One run: a fabric and a friction coefficient at a mesh and a number of halvings."""

    id: str
    material: str
    friction: float
    vertices_per_side: int
    halvings: int

    @property
    def pair(self) -> tuple[str, float]:
        """Fabric and friction coefficient."""
        return self.material, self.friction


def cases(config: Config) -> list[StudyCase]:
    """The runs of the study, those at the chosen settings first."""
    study = config.convergence
    sides = study.vertices_per_side
    refinements = [(sides[0], 0), (sides[0], HALVINGS), *((side, 0) for side in sides[1:])]
    return [
        StudyCase(f"{name}_{friction_id(mu)}_n{side}_h{halvings}", material, mu, side, halvings)
        for side, halvings in refinements
        for material in study.materials
        for name in [material_id(material)]
        for mu in study.frictions
    ]


def case_settings(
    case: StudyCase, config: Config, chosen: SimulationSettings
) -> SimulationSettings:
    """Numerical settings of one run, from those chosen for the simulations."""
    study = config.convergence
    step_s = chosen.time_step_s / 2**case.halvings
    implicit = {"bending_stiffness_at": "end"} if case.halvings else {}
    return chosen.model_copy(
        update=implicit
        | {
            "vertices_per_side": case.vertices_per_side,
            "time_step_s": step_s,
            # Among the finer steps none is long, however steady the motion.
            "steady_step_s": step_s if case.halvings else chosen.steady_step_s,
            # Of second order in the step, as the error of one step of implicit Euler.
            "step_error_m": chosen.step_error_m / 4**case.halvings,
            "friction_tolerance": chosen.friction_tolerance / 4**case.halvings,
            "frame_rate_hz": FRAME_RATE_HZ,
            "frames": math.floor(study.window_s * FRAME_RATE_HZ + 1e-9) + 1,
        }
    )


def simulate_case(
    config: Config, name: str, out: str | os.PathLike, calibration: str | os.PathLike | None
) -> tuple[dict[str, Any], float]:
    """Simulate the case with an id and write it; return the solver's counts, and CPU time in s."""
    from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag
    from slipstitch.physics.simulation.trajectory import write_trajectory

    started = start_clock()
    case = {case.id: case for case in cases(config)}.get(name)
    if case is None:
        raise BadInput(f"the study has no case {name!r}; its ids look like {cases(config)[0].id}")
    settings = case_settings(case, config, config.simulation)
    run = DropAndDrag(case.material, case.friction, SEED)
    trajectory, columns = simulate_drop_and_drag(run, settings)
    trajectory.metadata["case"] = case.id
    inputs, sections = [calibration] if calibration else [], {"simulation": settings}
    record = provenance_record(
        "convergence", inputs=inputs, config=sections, seed=SEED, started=started
    )
    write_trajectory(out, trajectory, record, **columns)
    return trajectory.metadata["solver"], record["cpu_s"]
