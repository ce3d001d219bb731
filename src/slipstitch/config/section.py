"""Common parts of the sections of the configuration. Pydantic and the standard library only."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from slipstitch.material import fabric_names


class Section(BaseModel):
    """Keys that belong together: none may be unknown, none changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _in_the_catalogue(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in fabric_names():
            raise ValueError(f"unknown material {name!r}; known: {', '.join(fabric_names())}")
    return names


def _different(seeds: list[int]) -> list[int]:
    if len(set(seeds)) != len(seeds) or min(seeds) < 0:
        raise ValueError("seeds must be distinct and non-negative")
    return seeds


FRICTION_MAX = 10.0
Friction = Annotated[float, Field(ge=0.0, le=FRICTION_MAX, allow_inf_nan=False)]
Fabric = Annotated[str, AfterValidator(lambda name: _in_the_catalogue((name,))[0])]
Fabrics = Annotated[tuple[str, ...], AfterValidator(_in_the_catalogue)]
Seeds = Annotated[list[int], Field(min_length=1), AfterValidator(_different)]
