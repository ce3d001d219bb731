"""Settings of the evaluate stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import Field

from slipstitch.config.section import Section


class EvaluateSettings(Section):
    """Definition of the metrics."""

    viewpoints: Literal["training", "calibrated"] = Field(
        "training",
        description="test videos in by_video, by_simulation and unseen_texture: from all "
        "training viewpoints, or only from the calibrated one",
    )
    friction_step: float = Field(
        0.1, gt=0.0, description="grid step of mu: errors are counted in steps, rounded"
    )
    batch_size: int = Field(8, ge=1, description="batch size, videos")
