"""Is a parameter known well enough to be exported?"""

from __future__ import annotations

import numpy as np

from slipstitch.criticise.measurements import COEFFICIENTS
from slipstitch.criticise.mechanisms import MECHANISMS

LARGEST_FACTOR = 3.0
AT_BOUND = "it lies at the bound of what is looked for"


def not_identified(parameters: dict[str, dict]) -> dict[str, str]:
    """Parameters at a bound, and coefficients of friction not known to a factor 3, and why.

    Parameters
    ----------
    parameters : name -> estimate and ci95, as in the verdict.
    """
    found = {}
    for coefficient in COEFFICIENTS:
        entry = parameters.get(coefficient.name)
        if entry is None:
            continue
        estimate, (low, high) = entry["estimate"], entry["ci95"]
        lower, upper = np.exp([coefficient.lower, coefficient.upper])
        if estimate < 1.01 * lower or estimate > 0.99 * upper:
            found[coefficient.name] = AT_BOUND
        elif high > LARGEST_FACTOR * estimate or estimate > LARGEST_FACTOR * max(low, 0.0):
            found[coefficient.name] = "it is known to no better than a factor 3"
    for mechanism in MECHANISMS.values():
        for parameter in mechanism.parameters:
            entry = parameters.get(parameter.name)
            # Many a mechanism starts at its null, which is no bound of what is looked for.
            ends = [e for e in (parameter.lower, parameter.upper) if e != parameter.null]
            near = 0.01 * (parameter.upper - parameter.lower)
            if entry and any(abs(entry["estimate"] - end) < near for end in ends):
                found[parameter.name] = AT_BOUND
    return found
