"""The known-answer experiments of the calibration, and what is demanded of each.

Beyond what rounding and mesh explain, an error is a bug.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from slipstitch.base.errors import SlipstitchError
from slipstitch.physics.experiments.specimen import Demand

INCLINE_FRICTIONS = (0.1, 0.5, 1.2)
INCLINE_MARGIN = 1e-3  # a body sticks so much below tan(slope) = mu, and slides so much above
INCLINE_STEEP = 1.5  # acceleration is compared at tan(slope) = this times mu
FLAT_DRAG_FRICTIONS = (0.1, 0.5, 1.0)
STRIP_DRAG_FRICTIONS = (0.1, 0.3, 0.6, 1.0, 1.5)
STRIP_DRAG_GRAVITY_LENGTH_M = 0.02  # (B/w)^(1/3)
UNITS = {"creep_m": "m", "acceleration_m_s2": "m/s²"} | dict.fromkeys(
    ("pull_over_w_m", "holder_ahead_of_tail_m"), "m"
)

Runner = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True)
class Experiment:
    """One run of a protocol, and the demands on numbers of its result, by name."""

    protocol: str
    options: dict[str, float]
    demands: Mapping[str, Demand]

    def describe(self) -> str:
        """Protocol and options in one line."""
        options = (f"{key}={value:.6g}" for key, value in self.options.items())
        return " ".join([self.protocol, *options])

    def run(self, runner: Runner) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Run the experiment by a function of protocol and options; name it in an error.

        Return a check for each demand (`_check`), and the protocol's result.
        """
        try:
            result = dict(runner(self.protocol, self.options))
        except SlipstitchError as error:
            raise type(error)(f"{self.describe()}: {error}") from error
        return [self._check(*demand, result) for demand in self.demands.items()], result

    def _check(self, name: str, demand: Demand, result: Mapping[str, Any]) -> dict[str, Any]:
        judged = demand.verdict(result)
        return {
            "name": f"{self.protocol} {name}",
            "protocol": self.protocol,
            "options": dict(self.options),
            "measured": _finite(result[demand.key]),
            "theory": _finite(demand.expected(result)),
            "error": judged["error"],
            "demand": demand.allowed,
            "relative": demand.relative,
            "unit": UNITS.get(demand.key, ""),
            "met": judged["met"],
        }


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def describe_check(check: Mapping[str, Any]) -> str:
    """One line: check, options, measured, theory, limit."""
    where = ", ".join(f"{key} {value:.6g}" for key, value in check["options"].items())
    unit = f" {check['unit']}" if check["unit"] else ""
    demand = f"{100 * check['demand']:g} %" if check["relative"] else f"{check['demand']:g}{unit}"
    measured, theory = (
        "nothing" if check[key] is None else f"{check[key]:.6g}" for key in ("measured", "theory")
    )
    return (
        f"{check['name']} at {where}: measured {measured}{unit}, theory {theory}{unit}, "
        f"allowed difference {demand}"
    )


_SLOPES = (
    (
        1.0 - INCLINE_MARGIN,
        {
            "sticks": Demand("sticks", relative=False, theory=1.0),
            "creep": Demand("creep_m", 1e-6, relative=False, theory=0.0),  # in 1 s
        },
    ),
    (1.0 + INCLINE_MARGIN, {"sticks": Demand("sticks", relative=False, theory=0.0)}),
    (INCLINE_STEEP, {"acceleration": Demand("acceleration_m_s2", 1e-3)}),
)
_FLAT_DRAG = {"pull over weight": Demand("pull_over_weight", 5e-3)}
_STRIP_DRAG = {
    "pull": Demand("pull_over_w_m", 0.01),
    "tail": Demand("holder_ahead_of_tail_m", 1e-3, relative=False),
}


def experiments() -> list[Experiment]:
    """All experiments, the cheap ones first."""
    inclines = [
        Experiment(
            "incline",
            {"friction": mu, "slope_deg": math.degrees(math.atan(multiple * mu))},
            demands,
        )
        for mu in INCLINE_FRICTIONS
        for multiple, demands in _SLOPES
    ]
    flat = [Experiment("flat-drag", {"friction": mu}, _FLAT_DRAG) for mu in FLAT_DRAG_FRICTIONS]
    length = {"gravity_length_m": STRIP_DRAG_GRAVITY_LENGTH_M}
    strips = [
        Experiment("strip-drag", {"friction": mu} | length, _STRIP_DRAG)
        for mu in STRIP_DRAG_FRICTIONS
    ]
    return inclines + flat + strips
