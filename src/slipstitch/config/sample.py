"""Settings of the sample stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import Field, model_validator

from slipstitch.config.section import Section


class SampleSettings(Section):
    """Number of frames per video, and the test videos."""

    frames: int = Field(30, ge=2, le=10000, description="frames of a video, at regular intervals")
    phases: int = Field(
        1,
        ge=1,
        le=100,
        description="number of phases: this many times the frames are kept, at equal intervals; "
        "the instrument draws its phase at random in training, everything else uses the first",
    )
    validation_fraction: float = Field(
        0.1, ge=0.0, lt=1.0, description="share of the videos (or replicates) for validation"
    )
    test_fraction: float = Field(
        0.1, gt=0.0, lt=1.0, description="share of the videos (or replicates) for testing"
    )
    validation_materials: list[str] = Field(
        [],
        description="fabrics of the grid that by_simulation keeps from training and testing: all "
        "their simulations are for validation, so that error bars allow for an unseen fabric",
    )
    train_only_frictions: list[float] = Field(
        [],
        description="coefficients of the grid that by_simulation never holds out: they train, so "
        "that those next to them are not the end of what a network has seen",
    )
    hold_out: Literal["auto", "replicate", "pair"] = Field(
        "auto",
        description="what by_simulation holds out: the last replicates of every "
        "(material, friction) pair, or whole pairs; auto: replicates if there are at least two",
    )

    @property
    def frames_kept(self) -> int:
        """Frames of a video in the dataset."""
        return self.frames * self.phases

    @model_validator(mode="after")
    def _something_is_left_to_train_on(self) -> "SampleSettings":
        if self.validation_fraction + self.test_fraction >= 1.0:
            raise ValueError("validation_fraction + test_fraction must be below 1")
        return self
