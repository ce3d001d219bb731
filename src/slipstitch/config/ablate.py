"""Settings of the ablate stage. Pydantic and the standard library only."""

from typing import Any, Literal, get_args

from pydantic import BaseModel, Field, ValidationError, field_validator

from slipstitch.config.instrument import InstrumentSettings
from slipstitch.config.section import Section, Seeds
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
# What a variant sets itself.
_OWN_TRAIN = ("seeds", "splits", "epochs_per_cycle")
_OWN_INSTRUMENT = ("seeds", "epochs")


class AblateSettings(Section):
    """Questions, networks and budget."""

    questions: list[Question] | None = Field(None, min_length=1)
    """questions to answer; null: all that the dataset can answer"""
    seeds: Seeds = [0, 1, 2]
    """seeds; every variant is trained once per seed"""
    networks: list[Literal["lrcn", "instrument"]] = Field(["lrcn", "instrument"], min_length=1)
    """networks; the instrument is used only for diversity and floors, the other choices do not
    apply to it"""
    passes: int = Field(30, ge=1)
    """passes through the training videos, for every variant of an LRCN"""
    instrument_passes: int = Field(50, ge=1)
    """the same for an instrument"""
    train: dict[str, Any] = Field(default_factory=dict)
    """overrides of keys in the section `train`, e.g. width, pixels"""
    instrument: dict[str, Any] = Field(default_factory=dict)
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

    @field_validator("questions", "networks")
    @classmethod
    def _named_once(cls, names: list[str] | None) -> list[str] | None:
        if names and len(set(names)) != len(names):
            raise ValueError(f"named twice: {', '.join(names)}")
        return names

    @field_validator("train")
    @classmethod
    def _train_keys(cls, changes: dict[str, Any]) -> dict[str, Any]:
        return _checked(changes, TrainSettings, _OWN_TRAIN)

    @field_validator("instrument")
    @classmethod
    def _instrument_keys(cls, changes: dict[str, Any]) -> dict[str, Any]:
        return _checked(changes, InstrumentSettings, _OWN_INSTRUMENT)


def _checked(changes: dict[str, Any], model: type[BaseModel], own: tuple[str, ...]):
    """The changes, if they fit the section that they change."""
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
