"""Settings of the sample stage. Pydantic and the standard library only."""

from pydantic import BaseModel, ConfigDict, Field


class SampleSettings(BaseModel):
    """Which frames of a video the networks see."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    frames: int = Field(30, ge=1)
