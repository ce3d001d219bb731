"""Settings of the train stage. Pydantic and the standard library only."""

from pydantic import BaseModel, ConfigDict, Field


class TrainSettings(BaseModel):
    """How the networks are trained."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seeds: tuple[int, ...] = Field((0,), min_length=1)
    epochs: int = Field(20, ge=1)
