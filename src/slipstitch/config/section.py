"""Common parts of the sections of the configuration. Pydantic and the standard library only."""

from itertools import pairwise
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from slipstitch.config.catalogue import fabric_names
from slipstitch.config.former import without_former_keys


class Section(BaseModel):
    """Keys that belong together, each with its meaning below: none may be unknown, none changes."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class RecordedSection(Section):
    """A section that trajectories or trained models hold; those may name former keys."""

    NAME: ClassVar[str]

    @model_validator(mode="before")
    @classmethod
    def _without_former_keys(cls, values: Any) -> Any:
        return without_former_keys(cls.NAME, values)


def _in_the_catalogue(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in fabric_names():
            raise ValueError(f"unknown material {name!r}; known: {', '.join(fabric_names())}")
    return names


def _named_once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        raise ValueError(f"duplicate material: {', '.join(names)}")
    return names


def _increasing(frictions: tuple[float, ...]) -> tuple[float, ...]:
    if any(after <= before for before, after in pairwise(frictions)):
        raise ValueError("friction coefficients must increase along the list")
    if too_fine := [f for f in frictions if abs(1000 * f - round(1000 * f)) > 1e-6]:
        raise ValueError(f"must be a multiple of 0.001, as its id is, not {too_fine[0]:g}")
    return frictions


def _different(seeds: list[int]) -> list[int]:
    if len(set(seeds)) != len(seeds) or min(seeds) < 0:
        raise ValueError("seeds must be distinct and non-negative")
    return seeds


FRICTION_MAX = 10.0
Friction = Annotated[float, Field(ge=0.0, le=FRICTION_MAX)]
Frictions = Annotated[tuple[Friction, ...], AfterValidator(_increasing)]
Fabric = Annotated[str, AfterValidator(lambda name: _in_the_catalogue((name,))[0])]
Fabrics = Annotated[tuple[str, ...], AfterValidator(_in_the_catalogue), AfterValidator(_named_once)]
Seeds = Annotated[list[int], Field(min_length=1), AfterValidator(_different)]
