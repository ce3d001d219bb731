"""Settings of the convergence study. Pydantic and the standard library only."""

import math
from itertools import pairwise

from pydantic import Field, field_validator, model_validator

from slipstitch.config.section import Fabrics, Frictions, Section


class ConvergenceSettings(Section):
    """Runs of drop-and-drag to compare, and the criterion of convergence.

    Every fabric and coefficient is simulated at the settings of the section ``simulation``, on
    finer meshes, and with everything finer that stepping in time depends on: the time step halved
    so often and never longer where the motion is steady, the error allowed to a step and the
    tolerance divided by four each time, and the stiffness of folds implicit.
    """

    materials: Fabrics = Field(
        (
            "ivory-rib-knit",
            "pink-ribbon-brown",
            "white-dots-on-blk",
            "navy-sparkle-sweat",
            "camel-ponte-roma",
            "gray-interlock",
            "11oz-black-denim",
            "white-swim-solid",
            "tango-red-jet-set",
            "royal-target",
        ),
        min_length=1,
        description="fabrics of the catalogue",
    )
    frictions: Frictions = Field(
        (0.1, 0.5, 1.5),
        min_length=1,
        description="friction coefficients, increasing, multiples of 0.001; between two, the worse "
        "of them is said",
    )
    vertices_per_side: tuple[int, ...] = Field(
        (41, 81),
        min_length=1,
        description="vertices per side of the meshes, increasing, with vertices at common "
        "positions on the cloth",
    )
    halvings: int = Field(
        2,
        ge=0,
        le=6,
        description="number of halvings of the time step; 0: only meshes are compared",
    )
    window_s: float = Field(
        56.0,
        gt=0,
        le=131,
        description="simulated part of the protocol; 56 s cover the drop, the first stroke and the "
        "first reversal",
    )

    @field_validator("vertices_per_side")
    @classmethod
    def _share_places(cls, sides: tuple[int, ...]) -> tuple[int, ...]:
        if any(after <= before for before, after in pairwise(sides)) or sides[0] < 5:
            raise ValueError("meshes must increase along the list, from 5 vertices per side")
        if math.gcd(*(side - 1 for side in sides)) < 4:
            raise ValueError(
                f"meshes of {', '.join(map(str, sides))} vertices per side have too few "
                "positions in common: one less than each must be a multiple of 4 or more, e.g. "
                "41, 61, 81"
            )
        return sides

    @model_validator(mode="after")
    def _compares_something(self) -> "ConvergenceSettings":
        if not self.halvings and len(self.vertices_per_side) < 2:
            raise ValueError(
                "nothing to compare: halvings must be at least 1, or vertices_per_side must "
                "contain a second mesh"
            )
        return self
