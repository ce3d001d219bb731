"""Settings of networks, instruments and ablations. Pydantic and the standard library only.

What the paper leaves open and nobody needs to change is decided in `slipstitch.learning.lrcn`.
"""

from itertools import product
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from slipstitch.config.section import RecordedSection, Section, Seeds, once

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
    """distribution of the first weights of convolutions: of He, Glorot, or PyTorch's default"""

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
        blocks = len(self.channels), len(self.convolutions)
        if blocks[0] != blocks[1]:
            counted = "channels names {} blocks, convolutions {}".format(*blocks)
            raise ValueError(f"{counted}: one number per block in both")
        if min(self.channels) < 1 or min(self.convolutions) < 1:
            raise ValueError("channels and convolutions must be positive")
        return self


class InstrumentSettings(RecordedSection):
    """The measuring network, its training and its error bars."""

    NAME = "instrument"

    seeds: Seeds = [0]
    """one instrument per seed"""
    calibration_datasets: list[str] = []
    """datasets of other runs (their results/sample), of which all videos stretch the intervals of
    the average of several seeds too; nothing of them may have trained it"""
    starts_from: str | None = None
    """folder of an instrument of the same sizes: the training goes on from the weights of its
    network number seed; null: from drawn ones"""
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
    """as train.plateau_margin; chance always predicts the distribution of the training labels"""
    checkpoint_interval_s: float = Field(60.0, ge=0.0)
    """minimum time between checkpoints; 0: after every step"""
    draws: int = Field(4, ge=1, le=64)
    """augmented views of a video whose predictions are averaged"""

    @model_validator(mode="after")
    def _points_are_learnt(self) -> "InstrumentSettings":
        if self.through_points and not self.points_weight:
            raise ValueError("through_points requires points_weight above 0")
        return self


Question = Literal["diversity", "conditioning", "schedule", "initialisation", "floors"]
QUESTIONS: tuple[Question, ...] = get_args(Question)
#: Question -> its variants with each network (`slipstitch.learning.ablation.questions`).
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    "diversity": dict.fromkeys(("lrcn", "instrument"), ("replicates", "textures")),
    "conditioning": {"lrcn": ("none", "predicted", "true")},
    "schedule": {"lrcn": ("progressive", "joint")},
    "initialisation": {"lrcn": ("he", "glorot", "pytorch")},
    "floors": dict.fromkeys(("lrcn", "instrument"), ("matte", "mixed")),
}


def _overrides(model: type[BaseModel], own: tuple[str, ...]) -> AfterValidator:
    """Make a check that changes fit a section; those of `own` are the ablation's."""

    def check(changes: dict[str, Any]) -> dict[str, Any]:
        for key in own:
            if key in changes:
                raise ValueError(f"{key} is set by the ablation itself")
        try:
            model.model_validate(changes)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise ValueError(f"{where}: {first['msg']}") from None
        return changes

    return AfterValidator(check)


class AblateSettings(Section):
    """Questions, networks and budget."""

    questions: Annotated[list[Question] | None, once("named twice")] = Field(None, min_length=1)
    """questions to answer; null: all that the dataset can answer"""
    seeds: Seeds = [0, 1, 2]
    """seeds; every variant is trained once per seed"""
    networks: Annotated[list[Literal["lrcn", "instrument"]], once("named twice")] = Field(
        ["lrcn", "instrument"], min_length=1
    )
    """networks; the instrument is used only for diversity and floors, the other choices do not
    apply to it"""
    passes: int = Field(30, ge=1)
    """passes through the training videos, for every variant of an LRCN"""
    instrument_passes: int = Field(50, ge=1)
    """the same for an instrument"""
    train: Annotated[
        dict[str, Any], _overrides(TrainSettings, ("seeds", "splits", "epochs_per_cycle"))
    ] = Field(default_factory=dict)
    """overrides of keys in the section `train`, e.g. width, pixels"""
    instrument: Annotated[dict[str, Any], _overrides(InstrumentSettings, ("seeds", "epochs"))] = (
        Field(default_factory=dict)
    )
    """overrides of keys in the section `instrument`"""

    @property
    def asked(self) -> tuple[Question, ...]:
        """The questions by name, whether stated or all."""
        return tuple(self.questions or QUESTIONS)

    @property
    def results(self) -> list[str]:
        """The results of all trainings: ``{question}/{network}_{variant}_seed{seed}.json``."""
        return [
            f"{question}/{network}_{variant}_seed{seed}.json"
            for question in self.asked
            for network, variants in VARIANTS[question].items()
            if network in self.networks
            for variant, seed in product(variants, self.seeds)
        ]
