"""How near theory a known-answer experiment must come: pass or fail."""

from collections.abc import Mapping
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
DEMANDS: dict[str, tuple[Demand, ...]] = {
    "incline": (Demand("acceleration_m_s2", 0.01, zero=2e-4),),  # 0.1 mm in 1 s: it sticks
    "tilt": (Demand("slope_at_slip", 0.005),),
    "flat-drag": (Demand("pull_over_weight", 0.005),),
    "strip-drag": (Demand("pull_over_w_m", 0.02), Demand("flat_tail_m", 1e-3, relative=False)),
    "strip": (Demand("regime"), Demand("slip_strain", 0.006, relative=False)),
    "landed-strip": (
        Demand("outcome"),
        Demand("slip_strain", 0.006, relative=False),
        Demand("flat_strain", 0.006, relative=False),
    ),
    "cantilever": (Demand("height_over_width", 0.02),),
    "lateral-buckling": (Demand("critical_gamma", 0.05),),
    "capstan": (Demand("tension_ratio", 0.02),),
}


def verdict(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """Whether a result meets the demands of its experiment.

    Returns
    -------
    dict
        ``passed``, and ``demands``: by key the error (None: not to be compared), what is allowed,
        whether that is relative, and whether it is met.
    """
    rows = {}
    for demand in DEMANDS[name]:
        error = demand.error(result)
        met = error <= demand.allowed or error <= demand.zero
        rows[demand.key] = {
            "error": None if error == inf else error,
            "allowed": demand.allowed,
            "relative": demand.relative,
            "met": met,
        }
    return {"passed": all(row["met"] for row in rows.values()), "demands": rows}
