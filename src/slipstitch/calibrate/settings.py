"""Settings of the calibrate stage. Pydantic and the standard library only."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Friction = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)]


class CalibrateSettings(BaseModel):
    """Which known-answer checks must hold before anything is simulated, and how closely.

    Every experiment runs with the numerical settings of the section ``simulation``; an empty list
    of friction coefficients leaves its experiment out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    incline_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.5, 1.2), description="inclined plane: friction coefficients"
    )
    incline_margin: float = Field(
        1e-3,
        gt=0.0,
        lt=0.5,
        description="inclined plane: must stick at tan(slope) = (1 - margin) mu and slide at "
        "(1 + margin) mu",
    )
    incline_steep: float = Field(
        1.5, gt=1.0, le=10.0, description="acceleration is compared at tan(slope) = this times mu"
    )
    incline_creep_m: float = Field(
        1e-6, gt=0.0, description="largest creep of a body that must stick (m in 1 s)"
    )
    incline_acceleration: float = Field(
        1e-3, gt=0.0, lt=1.0, description="largest relative error of the acceleration"
    )

    flat_drag_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.5, 1.0), description="flat drag: friction coefficients"
    )
    flat_drag_pull: float = Field(
        5e-3, gt=0.0, lt=1.0, description="largest relative error of the pull"
    )

    strip_drag_frictions: tuple[Friction, ...] = Field(
        (0.1, 0.3, 0.6, 1.0, 1.5), description="steady strip drag: friction coefficients"
    )
    strip_drag_gravity_length_m: float = Field(
        0.02, gt=0.0, le=0.1, description="steady strip drag: (B/w)^(1/3) of the strip"
    )
    strip_drag_pull: float = Field(
        0.01, gt=0.0, lt=1.0, description="largest relative error of the pull"
    )
    strip_drag_tail_m: float = Field(
        1e-3, gt=0.0, description="largest error of the distance from the tail's end to the holder"
    )
