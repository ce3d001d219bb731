"""Is a parameter known well enough to be exported?"""

from __future__ import annotations

import numpy as np

from slipstitch.criticise.measurements import COEFFICIENTS

LARGEST_FACTOR = 3.0


def not_identified(parameters: dict[str, dict]) -> dict[str, str]:
    """Coefficients of friction that are not known to a factor 3, or lie at a bound, and why.

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
            found[coefficient.name] = "it lies at the bound of what is looked for"
        elif high > LARGEST_FACTOR * estimate or estimate > LARGEST_FACTOR * max(low, 0.0):
            found[coefficient.name] = "it is known to no better than a factor 3"
    return found
