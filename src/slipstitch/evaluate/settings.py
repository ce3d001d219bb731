"""Settings of the evaluate stage. Pydantic and the standard library only."""

from pydantic import BaseModel, ConfigDict


class EvaluateSettings(BaseModel):
    """What the networks are evaluated on."""

    model_config = ConfigDict(extra="forbid", frozen=True)
