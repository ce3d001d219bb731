"""The runs of the study; separate from the rest, which takes seconds to import."""

import math
from dataclasses import dataclass

from slipstitch.config import Config
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.grid import friction_id, material_id

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
    refinements = [(sides[0], h) for h in dict.fromkeys((0, study.halvings))]
    refinements += [(side, 0) for side in sides[1:]]
    return [
        StudyCase(
            f"{material_id(material)}_{friction_id(friction)}_n{side}_h{halvings}",
            material,
            friction,
            side,
            halvings,
        )
        for side, halvings in refinements
        for material in study.materials
        for friction in study.frictions
    ]


def case_settings(
    case: StudyCase, config: Config, chosen: SimulationSettings
) -> SimulationSettings:
    """Numerical settings of one run.

    Parameters
    ----------
    chosen : SimulationSettings
        Those of the simulations, calibrated.
    """
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
