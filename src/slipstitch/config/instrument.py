"""Settings of the instrument stage. Pydantic and the standard library only."""

from typing import Literal

from pydantic import Field, model_validator

from slipstitch.config.section import RecordedSection, Seeds


class InstrumentSettings(RecordedSection):
    """The measuring network, its training and its error bars."""

    NAME = "instrument"

    seeds: Seeds = [0]
    """one instrument per seed"""
    calibration_datasets: list[str] = []
    """datasets of other runs (their results/sample), of which all videos stretch the intervals of
    the average of several seeds too; nothing of them may have trained it"""
    viewpoints: list[str] | None = Field(None, min_length=1)
    """training viewpoints, all rectified to the calibrated view: the calibrated one and members of
    the family bench_1 ...; null: the first of render.viewpoints"""
    knows_pose: bool = False
    """pose of the camera relative to the calibrated view as an input of the network"""
    pixels: int | None = Field(None, ge=32, le=512)
    """side of the input image; null: as rendered"""
    channels: list[int] = Field([16, 32, 64, 96], min_length=2)
    """output channels of the convolutions, each of stride 2"""
    features: int = Field(128, ge=8)
    """number of features per frame"""
    friction_max: float = Field(1.5, gt=0, le=10)
    """upper end of the grid of mu, which starts at 0, in steps of 0.01"""

    epochs: int = Field(60, ge=1)
    """passes through the training videos"""
    batch_size: int = Field(4, ge=1)
    """batch size, videos"""
    learning_rate: float = Field(2e-3, gt=0)
    """maximum learning rate of AdamW; one cycle, cosine"""
    dropout: float = Field(0.1, ge=0, lt=1)
    """dropout of the frames' features"""
    points_weight: float = Field(0.0, ge=0)
    """weight of the loss of the places of nine points of the cloth in every frame, relative to the
    loss of mu; 0: the network does not learn them"""
    through_points: bool = False
    """the recurrent layer sees the places of the points, as the network finds them, and nothing
    else of a frame; requires points_weight"""
    rectification_error: float = Field(0.006, ge=0, le=0.3)
    """augmentation: the image's corners move by up to this share of its side"""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """of the convolutions; auto: bfloat16 where the processor supports it"""
    plateau_margin: float | None = Field(0.05, ge=0.0, lt=1.0)
    """a run fails if its training loss stays above (1 - margin) times the loss of always predicting
    the distribution of the training labels; null: never"""
    checkpoint_interval_s: float = Field(60.0, ge=0.0)
    """minimum time between checkpoints; 0: after every step"""
    draws: int = Field(4, ge=1, le=64)
    """augmented views of a video whose predictions are averaged"""

    @model_validator(mode="after")
    def _points_are_learnt(self) -> "InstrumentSettings":
        if self.through_points and not self.points_weight:
            raise ValueError("through_points requires points_weight above 0")
        return self
