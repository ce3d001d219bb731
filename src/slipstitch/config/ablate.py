"""Settings of the ablate stage. Pydantic and the standard library only."""

from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from slipstitch.config.instrument import InstrumentSettings
from slipstitch.config.section import Section, Seeds, once
from slipstitch.config.train import TrainSettings

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
            for variant in variants
            for seed in self.seeds
        ]
