"""Is a parameter known well enough to be exported?"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.measurements import COEFFICIENTS
from slipstitch.physics.friction_law import Mechanism, Parameter

LARGEST_FACTOR = 3.0
AT_BOUND = "it lies at the bound of what is looked for"
TOO_WIDE = "it is known to no better than a factor 3"


def not_identified(parameters: dict[str, dict]) -> dict[str, str]:
    """Parameters at a bound, or not known to a factor 3, and why.

    A coefficient is known by itself, as is what a mechanism has beside its size; a size by what
    it differs from that of no effect. A vector is judged as a whole, its bounds by its components.

    Parameters
    ----------
    parameters : name -> estimate and ci95, as in the verdict; of a vector the components as well.
    """
    found = {}
    for coefficient in COEFFICIENTS:
        if entry := parameters.get(coefficient.name):
            lower, upper = np.exp([coefficient.lower, coefficient.upper])
            low, high = entry["ci95"]
            beyond = low < lower or high > upper
            if beyond or entry["estimate"] < 1.01 * lower or entry["estimate"] > 0.99 * upper:
                found[coefficient.name] = AT_BOUND
            elif _is_wide(entry, 0.0):
                found[coefficient.name] = TOO_WIDE
    for mechanism in MECHANISMS.values():
        for i, parameter in enumerate(mechanism.parameters):
            name, null = parameter.name, 0.0 if i else parameter.null
            if mechanism.components:
                name, null = mechanism.components[0], 0.0
            if parameter.name in parameters and _at_bound(parameters[parameter.name], parameter):
                found[name] = AT_BOUND
            elif name in parameters and _is_wide(parameters[name], null):
                found.setdefault(name, TOO_WIDE)
    return found


def not_exported(causes: Iterable[str], unknown: dict[str, str]) -> dict[str, str]:
    """The causes that an extended model leaves out, and why: what of them is unknown."""
    found = {}
    for cause in causes:
        own = [f"{name}: {unknown[name]}" for name in _names(MECHANISMS[cause]) if name in unknown]
        if own:
            found[cause] = ", ".join(own)
    return found


def _names(mechanism: Mechanism) -> tuple[str, ...]:
    return mechanism.components or tuple(p.name for p in mechanism.parameters)


def _at_bound(entry: dict, parameter: Parameter) -> bool:
    low, high = entry["ci95"]
    near = 0.01 * (parameter.upper - parameter.lower)
    below = min(low, entry["estimate"] - near) < parameter.lower
    above = max(high, entry["estimate"] + near) > parameter.upper
    # Many a mechanism starts at its null, which is no bound of what is looked for.
    return bool(
        (below and parameter.lower != parameter.null)
        or (above and parameter.upper != parameter.null)
    )


def _is_wide(entry: dict, null: float) -> bool:
    size = abs(entry["estimate"] - null)
    side = -1.0 if entry["estimate"] < null else 1.0
    low, high = sorted(side * (end - null) for end in entry["ci95"])
    known = high <= LARGEST_FACTOR * size and size <= LARGEST_FACTOR * max(low, 0.0)
    return not known  # also where the interval is no number
