"""Common parts of the sections of the configuration, and its former keys.

A former key became a constant beside its use: files and records that name one with the value of the
constant are still accepted. Pydantic and the standard library only.
"""

import json
from collections.abc import Callable, Collection, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from slipstitch.config.catalogue import fabric_names

#: Section -> key -> the value of the constant.
FORMER_KEYS: dict[str, dict[str, Any]] = json.loads(
    Path(__file__).with_name("former_keys.json").read_text(encoding="utf-8")
)
#: Sections of which every key is a former one.
FORMER_SECTIONS = ("evaluate",)


def without_former_keys(section: str, values: Any) -> Any:
    """Return the values of a section, and of sections in it, without former keys.

    FormerKeyError if a former key has another value than the constant that it became. `section` is
    its name, e.g. ``render``, empty for the whole configuration; values that are no mapping are
    returned as they are.
    """
    if not isinstance(values, Mapping):
        return values
    former = FORMER_KEYS.get(section, {})
    kept = {}
    for key, value in values.items():
        name = f"{section}.{key}" if section else key
        if key not in former:
            inner = without_former_keys(name, value)
            if name not in FORMER_SECTIONS or inner:
                kept[key] = inner
        elif json.loads(json.dumps(value)) != former[key]:
            raise FormerKeyError(name, former[key], value)
    return kept


class FormerKeyError(ValueError):
    """A former key with another value than the constant that it became."""

    def __init__(self, name: str, fixed: Any, given: Any):
        fixed, given = json.dumps(fixed), json.dumps(given)
        super().__init__(f"{name}: no longer a key; it is always {fixed}, not {given}")
        self.location = tuple(name.split("."))


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


def known(
    kind: str,
    catalogue: Callable[[], Collection[str]],
    is_free: Callable[[str], bool] = lambda name: False,
) -> AfterValidator:
    """Make a check that a name, or each of several, is in a catalogue, unless it is free."""

    def check(names: Any) -> Any:
        for name in [names] if isinstance(names, str) else names:
            if name not in catalogue() and not is_free(name):
                raise ValueError(f"unknown {kind} {name!r}; known: {', '.join(catalogue())}")
        return names

    return AfterValidator(check)


def once(problem: str) -> AfterValidator:
    """Make a check that no name is given twice; `problem` says what is wrong otherwise."""

    def check(names: Any) -> Any:
        if names and len(set(names)) != len(names):
            raise ValueError(f"{problem}: {', '.join(names)}")
        return names

    return AfterValidator(check)


def apart(section: Section, *kinds: str) -> None:
    """Refuse a section of which a list for training and the one for testing share something."""
    for kind in kinds:
        both = sorted(set(getattr(section, kind)) & set(getattr(section, f"test_{kind}")))
        if both:
            raise ValueError(f"{kind} and test_{kind} share {', '.join(map(str, both))}")


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
_of_fabric = known("material", fabric_names)
Fabric = Annotated[str, _of_fabric]
Fabrics = Annotated[tuple[str, ...], _of_fabric, once("duplicate material")]
Seeds = Annotated[list[int], Field(min_length=1), AfterValidator(_different)]
