"""How near theory a known-answer experiment must come: pass or fail."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any


@dataclass(frozen=True)
class Demand:
    """The largest error of one measured value.

    Attributes
    ----------
    key : str
        Of the result; theory's value is under ``theory_<key>``. Words must be equal.
    allowed : float
        Largest error, of theory's value if `relative`, else in the value's unit.
    relative : bool
    zero : float
        What counts as 0 where theory says 0.
    """

    key: str
    allowed: float = 0.0
    relative: bool = True
    zero: float = 0.0

    def error(self, result: Mapping[str, Any]) -> float:
        """The error of a result; infinite where one of the two values is missing."""
        measured, expected = result[self.key], result[f"theory_{self.key}"]
        if measured is None or expected is None or isinstance(expected, str):
            return 0.0 if measured == expected else inf
        off = abs(measured - expected)
        if not self.relative or off <= self.zero:
            return off
        return off / abs(expected) if expected else inf


# docs/how/physics.md says how near they really come.


def verdict(demands: Sequence[Demand], result: Mapping[str, Any]) -> dict[str, Any]:
    """Whether a result meets the demands of its experiment.

    Returns
    -------
    dict
        ``passed``, and ``demands``: by key the error (None: not to be compared), what is allowed,
        whether that is relative, and whether it is met.
    """
    rows = {}
    for demand in demands:
        error = demand.error(result)
        met = error <= demand.allowed or error <= demand.zero
        rows[demand.key] = {
            "error": None if error == inf else error,
            "allowed": demand.allowed,
            "relative": demand.relative,
            "met": met,
        }
    return {"passed": all(row["met"] for row in rows.values()), "demands": rows}
