"""Former keys of the configuration: each became a constant beside its use.

Files and records that name one with the value of the constant are still accepted.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
