"""The known-answer experiments of the calibration and their tolerances."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from slipstitch.base.errors import SlipstitchError

# What is demanded of the simulator: beyond what rounding and mesh explain, an error is a bug.
INCLINE_FRICTIONS = (0.1, 0.5, 1.2)
INCLINE_MARGIN = 1e-3  # a body sticks so much below tan(slope) = mu, and slides so much above
INCLINE_STEEP = 1.5  # acceleration is compared at tan(slope) = this times mu
INCLINE_CREEP_M = 1e-6  # in 1 s, of a body that must stick
INCLINE_ACCELERATION = 1e-3  # relative
FLAT_DRAG_FRICTIONS = (0.1, 0.5, 1.0)
FLAT_DRAG_PULL = 5e-3  # relative
STRIP_DRAG_FRICTIONS = (0.1, 0.3, 0.6, 1.0, 1.5)
STRIP_DRAG_GRAVITY_LENGTH_M = 0.02  # (B/w)^(1/3)
STRIP_DRAG_PULL = 0.01  # relative
STRIP_DRAG_TAIL_M = 1e-3

Runner = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True)
class Check:
    """One number of one experiment, held against theory.

    Attributes
    ----------
    name : str
        What is compared, e.g. ``strip-drag pull``.
    protocol : str
        The experiment, as ``slipstitch protocol`` knows it.
    options : dict
        Its options: friction, slope_deg, gravity_length_m.
    measured, theory : float or None
        Simulator's and theory's number, in ``unit``; None if the experiment gave none.
    error : float or None
        Their distance, relative to theory or in ``unit``.
    demand : float
        The largest error allowed.
    relative : bool
        Whether error and limit are relative.
    unit : str
        Unit of the numbers; empty if they have none.
    met : bool
        Whether the error is within the limit; never if it is not a number.
    """

    name: str
    protocol: str
    options: dict[str, float]
    measured: float | None
    theory: float | None
    error: float | None
    demand: float
    relative: bool
    unit: str
    met: bool

    def describe(self) -> str:
        """One line: check, options, measured, theory, limit."""
        where = ", ".join(f"{key} {value:.6g}" for key, value in self.options.items())
        unit = f" {self.unit}" if self.unit else ""
        demand = f"{100 * self.demand:g} %" if self.relative else f"{self.demand:g}{unit}"
        return (
            f"{self.name} at {where}: measured {_shown(self.measured)}{unit}, "
            f"theory {_shown(self.theory)}{unit}, allowed difference {demand}"
        )

    def as_dict(self) -> dict[str, Any]:
        """The check as JSON can hold it."""
        return asdict(self)


def _shown(value: float | None) -> str:
    return "nothing" if value is None else f"{value:.6g}"


def compare(
    name: str,
    protocol: str,
    options: Mapping[str, float],
    measured: Any,
    theory: Any,
    demand: float,
    *,
    relative: bool = False,
    unit: str = "",
) -> Check:
    """Hold a measured number against theory's.

    Parameters
    ----------
    name, protocol, options
        As in `Check`.
    measured, theory : float, bool or None
        The two numbers; anything that is not finite counts as missing.
    demand : float
        Largest error allowed.
    relative : bool
        Whether the error is relative to theory's number.
    unit : str
        Unit of the numbers.
    """
    found, expected = _finite(measured), _finite(theory)
    error = None
    if found is not None and expected is not None:
        error = abs(found - expected)
        if relative:
            error = error / abs(expected) if expected else (0.0 if error == 0.0 else None)
    return Check(
        name=name,
        protocol=protocol,
        options=dict(options),
        measured=found,
        theory=expected,
        error=error,
        demand=demand,
        relative=relative,
        unit=unit,
        met=error is not None and error <= demand,
    )


def _finite(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


@dataclass(frozen=True)
class Experiment:
    """One run of a protocol and the checks made on its result."""

    protocol: str
    options: dict[str, float]
    judge: Callable[[Mapping[str, Any]], list[Check]]

    def describe(self) -> str:
        """Protocol and options in one line."""
        return " ".join(
            [self.protocol, *(f"{key}={value:.6g}" for key, value in self.options.items())]
        )

    def run(self, runner: Runner) -> tuple[list[Check], dict[str, Any]]:
        """Run it and judge it.

        Parameters
        ----------
        runner : callable
            Takes protocol and options, returns the result's keys and values.

        Returns
        -------
        checks : list of Check
        result : dict
            What the protocol returned.

        Raises
        ------
        SlipstitchError
            If the protocol fails, or its result lacks a key; the message names the experiment.
        """
        try:
            result = dict(runner(self.protocol, self.options))
        except SlipstitchError as error:
            raise type(error)(f"{self.describe()}: {error}") from error
        try:
            return self.judge(result), result
        except KeyError as error:
            raise SlipstitchError(f"{self.describe()}: no {error} in its result") from error


def _incline(friction: float) -> list[Experiment]:
    def at(multiple: float, judge) -> Experiment:
        options = {"friction": friction, "slope_deg": math.degrees(math.atan(multiple * friction))}
        return Experiment("incline", options, lambda result: judge(options, result))

    def sticks(options, result):
        return [
            compare("incline sticks", "incline", options, result["sticks"], 1.0, 0.0),
            compare(
                "incline creep",
                "incline",
                options,
                result["creep_m"],
                0.0,
                INCLINE_CREEP_M,
                unit="m",
            ),
        ]

    def slides(options, result):
        return [compare("incline sticks", "incline", options, result["sticks"], 0.0, 0.0)]

    def accelerates(options, result):
        return [
            compare(
                "incline acceleration",
                "incline",
                options,
                result["acceleration_m_s2"],
                result["theory_acceleration_m_s2"],
                INCLINE_ACCELERATION,
                relative=True,
                unit="m/s²",
            )
        ]

    return [
        at(1.0 - INCLINE_MARGIN, sticks),
        at(1.0 + INCLINE_MARGIN, slides),
        at(INCLINE_STEEP, accelerates),
    ]


def _flat_drag(friction: float) -> Experiment:
    options = {"friction": friction}

    def judge(result):
        return [
            compare(
                "flat-drag pull over weight",
                "flat-drag",
                options,
                result["pull_over_weight"],
                result["theory_pull_over_weight"],
                FLAT_DRAG_PULL,
                relative=True,
            )
        ]

    return Experiment("flat-drag", options, judge)


def _strip_drag(friction: float) -> Experiment:
    options = {"friction": friction, "gravity_length_m": STRIP_DRAG_GRAVITY_LENGTH_M}

    def judge(result):
        return [
            compare(
                "strip-drag pull",
                "strip-drag",
                options,
                result["pull_over_w_m"],
                result["theory_pull_over_w_m"],
                STRIP_DRAG_PULL,
                relative=True,
                unit="m",
            ),
            compare(
                "strip-drag tail",
                "strip-drag",
                options,
                result["holder_ahead_of_tail_m"],
                result["theory_holder_ahead_of_tail_m"],
                STRIP_DRAG_TAIL_M,
                unit="m",
            ),
        ]

    return Experiment("strip-drag", options, judge)


def experiments() -> list[Experiment]:
    """Return the experiments, the cheap ones first."""
    inclines = [item for friction in INCLINE_FRICTIONS for item in _incline(friction)]
    return [
        *inclines,
        *(_flat_drag(friction) for friction in FLAT_DRAG_FRICTIONS),
        *(_strip_drag(friction) for friction in STRIP_DRAG_FRICTIONS),
    ]
