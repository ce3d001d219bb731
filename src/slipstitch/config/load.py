"""Reading configurations: files are merged key by key and checked, errors reported in one line."""

import contextlib
import difflib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance.files import atomic_path, load_yaml, read_json, read_yaml
from slipstitch.config.model import Config
from slipstitch.config.section import FormerKeyError, without_former_keys

# YAML 1.1 reads 1e-3 as a string, because it wants a point in the mantissa and a sign; here it is
# the number that everybody means.
_SCIENTIFIC = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")


def read_mapping(path: str | os.PathLike) -> dict[str, Any]:
    """The content of a YAML or JSON file as a mapping; BadInput if it holds none."""
    content = read_yaml(path)
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise BadInput(f"{path}: contains {_kind(content)}; must be a mapping of keys")
    return content


def calibrated_settings(path: str | os.PathLike) -> dict[str, Any]:
    """Settings of simulations that a calibration has verified; BadInput if it is none."""
    content = read_json(path)
    settings = content.get("settings") if isinstance(content, dict) else None
    if not isinstance(settings, dict):
        raise Damaged(path, "not a calibration: it contains no settings")
    return without_law(settings)


def without_law(settings: Mapping[str, Any]) -> dict[str, Any]:
    """A calibration's settings but for the law: it used to state it, and does not exercise it."""
    return {name: value for name, value in settings.items() if name != "model"}


def _merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the keys of `over`; mappings are merged, lists are replaced as a whole."""
    merged = dict(base)
    for key, value in over.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            value = _merge(dict(merged[key]), value)
        merged[key] = value
    return merged


def _numbers(value: Any, words: bool = False) -> Any:
    """`value` with scientific notation that YAML took for a string read as a number.

    With `words`, every string is read as YAML reads a bare word.
    """
    if isinstance(value, Mapping):
        return {key: _numbers(item, words) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_numbers(item, words) for item in value]
    if isinstance(value, str) and words:
        with contextlib.suppress(BadInput):  # a word that is no YAML stays as it is
            read = load_yaml(value, "word")
            value = read if isinstance(read, bool | int | float) or read is None else value
    if isinstance(value, str) and _SCIENTIFIC.fullmatch(value):
        return float(value)
    return value


def _kind(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    words = {None: "nothing", True: "true", False: "false"}
    return words[value] if value is None or isinstance(value, bool) else repr(value)


def _known_beside(location: tuple) -> list[str]:
    """The keys of the section of the configuration that holds the key `location`."""
    model: Any = Config
    for key in location[:-1]:
        field = getattr(model, "model_fields", {}).get(key)
        model = field.annotation if field else None
    return list(getattr(model, "model_fields", ()))


def _holds(mapping: Any, location: tuple) -> bool:
    try:
        for key in location:
            mapping = mapping[key]
    except (KeyError, IndexError, TypeError):
        return False
    return True


# Pydantic's words of JSON -> those of who writes YAML.
_WORDS = {
    "Input should be": "must be",
    "List should": "must",
    "Tuple should": "must",
    "a valid array": "a list",
    "a valid boolean": "true or false",
    "a valid integer": "a whole number",
    "an object": "a mapping of keys",
    "a valid": "a",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "Field required": "is missing",
    " after validation": "",
}


def _line(error: Mapping[str, Any]) -> str:
    """One problem in words: key, what is allowed, what it is."""
    location = error["loc"]
    name = ".".join(map(str, location)) or "configuration"
    if error["type"] == "extra_forbidden":
        known = _known_beside(location)
        close = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
        return f"{name}: unknown key; {hint}"
    if error["type"] in ("value_error", "assertion_error"):
        return f"{name}: {error['ctx']['error']}" if location else str(error["ctx"]["error"])
    message = error["msg"]
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    given = "" if error["type"] in ("missing", "too_short", "too_long") else _kind(error["input"])
    return f"{name}: {message}" + (given and f", not {given}")


def resolve_config(
    *mappings: Mapping[str, Any], sources: tuple[str, ...] = (), words: bool = False
) -> Config:
    """The configuration that mappings make, later ones overriding earlier ones key by key.

    `sources` names them in errors: BadInput in one line, for every problem the source, the key,
    what is allowed and what it is. With `words`, numbers may come as strings, as of ``--config``.
    """
    plain = [_numbers(mapping, words) for mapping in mappings]
    merged: dict[str, Any] = {}
    for mapping in plain:
        merged = _merge(merged, mapping)

    def source(location: tuple) -> str:
        named = zip(reversed(plain), reversed(sources), strict=False)
        return next((f"{name}: " for mapping, name in named if _holds(mapping, location)), "")

    try:
        merged = without_former_keys("", merged)
    except FormerKeyError as error:
        raise BadInput(f"{source(error.location)}{error}") from None
    try:
        # JSON, strictly: lists are lists, and neither "3" nor true is a number.
        return Config.model_validate_json(json.dumps(merged), strict=True)
    except ValidationError as error:
        problems = error.errors()
        # A list with a bad entry is also reported as too short: the entry is the thing to say.
        inner = {problem["loc"][:-1] for problem in problems if problem["loc"]}
        lines = [f"{source(one['loc'])}{_line(one)}" for one in problems if one["loc"] not in inner]
        raise BadInput("; ".join(dict.fromkeys(lines))) from None
    except TypeError as error:
        raise BadInput(f"configuration: {error}") from None


def load_config(
    *paths: str | os.PathLike,
    calibration: str | os.PathLike | None = None,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    words: bool = False,
) -> Config:
    """The configuration in YAML or JSON files, later ones overriding earlier ones key by key.

    The verified settings of a calibration override the files, and `overrides`, by the name that an
    error shall say, all that; see `resolve_config`.
    """
    parts: list[tuple[str, Mapping]] = [(os.fspath(path), read_mapping(path)) for path in paths]
    if calibration:
        verified = calibrated_settings(calibration)
        parts.append((os.fspath(calibration), {"simulation": verified}))
    parts += (overrides or {}).items()
    sources, mappings = zip(*parts, strict=True) if parts else ((), ())
    return resolve_config(*mappings, sources=sources, words=words)


def write_config(config: Config, path: str | os.PathLike) -> bool:
    """Write the whole configuration as JSON if the file's content changes; return whether."""
    text = json.dumps(config.model_dump(mode="json"), indent=1) + "\n"
    target = Path(path)
    if target.is_file() and target.read_text(encoding="utf-8") == text:
        return False
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return True
