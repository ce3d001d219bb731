"""Settings of the calibrate stage. Pydantic and the standard library only."""

from pydantic import BaseModel, ConfigDict


class CalibrateSettings(BaseModel):
    """Which known-answer checks must hold before anything is simulated."""

    model_config = ConfigDict(extra="forbid", frozen=True)
