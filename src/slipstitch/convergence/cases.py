"""The runs of the study; separate from the rest, which takes seconds to import."""

import math
from dataclasses import dataclass

from slipstitch.config import Config
from slipstitch.config.grid import material_id
from slipstitch.config.simulation import SimulationSettings


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
    refinements = [(sides[0], h) for h in range(study.halvings + 1)]
    refinements += [(side, 0) for side in sides[1:]]
    return [
        StudyCase(
            f"{material_id(material)}_f{study.frictions.index(friction):02d}_n{side}_h{halvings}",
            material,
            friction,
            side,
            halvings,
        )
        for side, halvings in refinements
        for material in study.materials
        for friction in study.frictions
        if friction in study.finest_frictions or (side == sides[0] and halvings <= 1)
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
    return chosen.model_copy(
        update={
            "vertices_per_side": case.vertices_per_side,
            "time_step_s": chosen.time_step_s / 2**case.halvings,
            "frame_rate_hz": study.frame_rate_hz,
            "frames": math.floor(study.window_s * study.frame_rate_hz + 1e-9) + 1,
        }
    )
