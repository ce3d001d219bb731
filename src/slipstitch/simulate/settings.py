"""Settings of the simulate stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SimulationSettings(BaseModel):
    """How one drop-and-drag run is simulated."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vertices_per_side: int = Field(41, ge=5, le=401)
    time_step_s: float = Field(0.02, gt=0, le=0.1)
    frames: int = Field(300, ge=1, le=100_000)
    frame_rate_hz: float = Field(2.4, gt=0)
    friction_tolerance: float = Field(1.0e-3, gt=0, lt=1)
    newton_iterations_max: int = Field(40, ge=1)
    damping_s: float = Field(0.002, ge=0)
    pins: Literal["tabs", "corner"] = "tabs"
