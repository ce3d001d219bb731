"""Settings of the train stage. Pydantic and the standard library only.

What the paper leaves open and nobody needs to change is decided in `slipstitch.learning.lrcn`.
"""

from typing import Literal

from pydantic import Field, model_validator

from slipstitch.config.section import RecordedSection, Seeds

NETWORKS = ("material_baseline", "friction_baseline", "friction_conditional")
BY_SIMULATION = "by_simulation"
SPLITS = ("by_video", BY_SIMULATION)
#: The videos of by_video's sides and the same on the floors of the second training set.
REFLECTIVE = "by_video_reflective"
TRAINED_ON = (*SPLITS, REFLECTIVE)
REFLECTIVE_SEEDS = (0,)


def split_of(trained_on: str) -> str:
    """The split whose sides a training keeps to."""
    return trained_on.removesuffix("_reflective")


class TrainSettings(RecordedSection):
    """The paper's recurrent convolutional network and its training."""

    NAME = "train"

    seeds: Seeds = [0]
    """one training of every network a seed"""
    splits: list[Literal["by_video", "by_simulation", "by_video_reflective"]] = Field(
        list(SPLITS), min_length=1
    )
    """the paper's split, whole simulations held out, and the paper's split with the videos on
    render.reflective_floors as well, each shown half as often, with seed 0 alone"""

    pixels: int | None = Field(None, ge=16, le=1024)
    """side of the input image; null: as rendered"""
    width: float = Field(0.25, gt=0.0, le=4.0)
    """multiplies the sizes of all layers; the paper's net is 1"""
    channels: list[int] = Field([64, 128, 256, 512], min_length=1)
    """output channels of the blocks conv1 ..."""
    convolutions: list[int] = Field([2, 2, 1, 1], min_length=1)
    """3 x 3 convolutions in each block (a, b, ...)"""
    initialisation: Literal["he", "glorot", "pytorch"] = "he"

    epochs_per_cycle: int = Field(6, ge=1)
    """epochs with the same set of viewpoints: one more each cycle, in the order of
    render.viewpoints, whose first is the calibrated one"""
    fine_tuning_epochs: int = Field(4, ge=0)
    """last epochs, calibrated viewpoint only"""
    flat_epochs: int | None = Field(None, ge=1)
    """before the last cycle, epochs of all viewpoints until the validation loss has not fallen for
    so many, at most eight cycles of them; null: none"""
    keep_all_views: bool = False
    """keep the networks before fine-tuning, and score them in all views, the fine-tuned ones in the
    calibrated view; conditional networks are told the material by the material network before
    fine-tuning"""
    batch_size: int = Field(2, ge=1)
    """videos in a batch"""
    learning_rate: float = Field(1.0, gt=0.0)
    """Adadelta's, until the last cycle"""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """of the convolutions; auto: bfloat16 where the processor computes it"""
    plateau_margin: float | None = Field(0.05, ge=0.0, lt=1.0)
    """a run fails whose training loss stays above (1 - margin) times chance; null: never, for runs
    that are too short to learn"""
    checkpoint_interval_s: float = Field(60.0, ge=0.0)
    """least time between checkpoints; 0: one every step"""

    @model_validator(mode="after")
    def _blocks_agree(self) -> "TrainSettings":
        if len(self.channels) != len(self.convolutions):
            raise ValueError(
                f"channels names {len(self.channels)} blocks, convolutions "
                f"{len(self.convolutions)}: one number per block in both"
            )
        if min(self.channels) < 1 or min(self.convolutions) < 1:
            raise ValueError("channels and convolutions must be positive")
        return self
