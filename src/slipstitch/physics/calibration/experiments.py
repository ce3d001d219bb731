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
        measured, theory = (
            "nothing" if value is None else f"{value:.6g}" for value in (self.measured, self.theory)
        )
        return (
            f"{self.name} at {where}: measured {measured}{unit}, theory {theory}{unit}, "
            f"allowed difference {demand}"
        )

    def as_dict(self) -> dict[str, Any]:
        """The check as JSON can hold it."""
        return asdict(self)


@dataclass(frozen=True)
class Quantity:
    """A number of a protocol's result, and how far from theory it may be.

    Attributes
    ----------
    name, demand, relative, unit
        As in `Check`.
    key : str
        Of the result.
    theory : float or None
        None: what the result has under ``theory_<key>``.
    """

    name: str
    key: str
    demand: float
    relative: bool = False
    unit: str = ""
    theory: float | None = None

    def check(self, protocol: str, options: dict[str, float], result: Mapping[str, Any]) -> Check:
        """Compare a result with theory; what is not finite counts as missing."""
        found = _finite(result[self.key])
        expected = self.theory
        if expected is None:
            expected = _finite(result[f"theory_{self.key}"])
        error = None
        if found is not None and expected is not None:
            error = abs(found - expected)
            if self.relative:
                error = error / abs(expected) if expected else (0.0 if error == 0.0 else None)
        return Check(
            name=self.name,
            protocol=protocol,
            options=dict(options),
            measured=found,
            theory=expected,
            error=error,
            demand=self.demand,
            relative=self.relative,
            unit=self.unit,
            met=error is not None and error <= self.demand,
        )


def _finite(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


@dataclass(frozen=True)
class Experiment:
    """One run of a protocol and the numbers of its result that are checked."""

    protocol: str
    options: dict[str, float]
    quantities: tuple[Quantity, ...]

    def describe(self) -> str:
        """Protocol and options in one line."""
        options = (f"{key}={value:.6g}" for key, value in self.options.items())
        return " ".join([self.protocol, *options])

    def run(self, runner: Runner) -> tuple[list[Check], dict[str, Any]]:
        """Run the experiment and check its result.

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
            checks = [one.check(self.protocol, self.options, result) for one in self.quantities]
        except KeyError as error:
            raise SlipstitchError(f"{self.describe()}: no {error} in its result") from error
        return checks, result


_STICKS, _SLIDES = (Quantity("incline sticks", "sticks", 0.0, theory=one) for one in (1.0, 0.0))
_CREEP = Quantity("incline creep", "creep_m", INCLINE_CREEP_M, unit="m", theory=0.0)
_ACCELERATES = Quantity(
    "incline acceleration", "acceleration_m_s2", INCLINE_ACCELERATION, True, "m/s²"
)
_SLOPES = (
    (1.0 - INCLINE_MARGIN, (_STICKS, _CREEP)),
    (1.0 + INCLINE_MARGIN, (_SLIDES,)),
    (INCLINE_STEEP, (_ACCELERATES,)),
)
_PULL = Quantity("flat-drag pull over weight", "pull_over_weight", FLAT_DRAG_PULL, True)
_OF_THE_STRIP = (
    Quantity("strip-drag pull", "pull_over_w_m", STRIP_DRAG_PULL, True, "m"),
    Quantity("strip-drag tail", "holder_ahead_of_tail_m", STRIP_DRAG_TAIL_M, unit="m"),
)


def experiments() -> list[Experiment]:
    """All experiments, the cheap ones first."""
    return [
        *(
            Experiment(
                "incline",
                {"friction": mu, "slope_deg": math.degrees(math.atan(multiple * mu))},
                quantities,
            )
            for mu in INCLINE_FRICTIONS
            for multiple, quantities in _SLOPES
        ),
        *(Experiment("flat-drag", {"friction": mu}, (_PULL,)) for mu in FLAT_DRAG_FRICTIONS),
        *(
            Experiment(
                "strip-drag",
                {"friction": mu, "gravity_length_m": STRIP_DRAG_GRAVITY_LENGTH_M},
                _OF_THE_STRIP,
            )
            for mu in STRIP_DRAG_FRICTIONS
        ),
    ]
