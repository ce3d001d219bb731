"""Estimates of parameters with their 95 % intervals; are they known well enough to be exported?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.fit import Fit
from slipstitch.criticise.measurements import COEFFICIENTS
from slipstitch.physics.friction_law import Mechanism, Parameter

LARGEST_FACTOR = 3.0
AT_BOUND = "it lies at the bound of what is looked for"
TOO_WIDE = "it is known to no better than a factor 3"


@dataclass(frozen=True)
class Intervals:
    """Of one fit; ``inflation`` is that of the variance of each mechanism's parameters."""

    fitted: Fit
    specimens: int
    inflation: dict[str, float]

    @property
    def reach(self) -> float:
        """Half of an interval in standard errors."""
        return float(student.ppf(0.975, max(self.specimens - len(self.fitted.values), 3)))

    def of_sizes(self) -> dict[str, dict]:
        """Every parameter by name, a vector by its size and its direction."""
        result = self.of_parameters()
        for cause in self.fitted.causes:
            if MECHANISMS[cause].components is not None:
                own = {p.name for p in MECHANISMS[cause].parameters}
                result = {name: entry for name, entry in result.items() if name not in own}
                result |= self._size_and_direction(cause)
        return result

    def of_parameters(self) -> dict[str, dict]:
        """Every fitted parameter, vectors by their components."""
        fitted = self.fitted
        owner = {p.name: c for c in fitted.causes for p in MECHANISMS[c].parameters}
        result: dict[str, dict] = {}
        for j, parameter in enumerate(fitted.parameters):
            value = float(fitted.values[j])
            inflated = self.inflation.get(owner.get(parameter.name, ""), 1.0)
            half = self.reach * float(np.sqrt(fitted.covariance[j, j] * inflated))
            if parameter.coefficient:
                estimate, interval = np.exp(value), np.exp([value - half, value + half])
            elif parameter.relative:
                half /= 1 + value
                estimate, interval = value, (1 + value) * np.exp([-half, half]) - 1
            else:
                estimate, interval = value, np.array([value - half, value + half])
            result[parameter.name] = _entry(estimate, interval, parameter.unit)
        return result

    def may_be_nothing(self, cause: str) -> bool:
        """Does the interval of a cause's size hold that of no effect?

        What a mechanism has beside its size is held: of no effect it cannot be told.
        """
        mechanism, entries = MECHANISMS[cause], self.of_sizes()
        if mechanism.components:
            return bool(entries[mechanism.components[0]]["ci95"][0] <= 0)
        names = [p.name for p in self.fitted.parameters]
        own = [names.index(p.name) for p in mechanism.parameters]
        precision = np.linalg.inv(self.fitted.covariance[np.ix_(own, own)])[0, 0]
        half = self.reach * np.sqrt(self.inflation.get(cause, 1.0) / precision)
        first = mechanism.parameters[0]
        size = float(self.fitted.values[own[0]])
        if first.relative:
            return bool(abs(np.log1p(size)) <= half / (1 + size))
        return bool(abs(size - first.null) <= half)

    def _size_and_direction(self, cause: str) -> dict[str, dict]:
        """Two components of a vector as its size and its direction."""
        fitted, components = self.fitted, MECHANISMS[cause].parameters
        fitted_names = [p.name for p in fitted.parameters]
        index = [fitted_names.index(p.name) for p in components]
        x, y = fitted.values[index]
        covariance = fitted.covariance[np.ix_(index, index)] * self.inflation.get(cause, 1.0)
        size = float(np.hypot(x, y))
        along = np.array([x, y]) / max(size, 1e-12)
        across = np.array([-y, x]) / max(size, 1e-12)
        half = self.reach * float(np.sqrt(along @ covariance @ along))
        turn = float(np.degrees(np.sqrt(across @ covariance @ across) / max(size, 1e-12)))
        turn = min(self.reach * turn, 180.0)
        azimuth = float(np.degrees(np.arctan2(y, x)) % 360)
        size_name, direction_name = MECHANISMS[cause].components
        return {
            size_name: _entry(size, [max(size - half, 0.0), size + half], components[0].unit),
            direction_name: _entry(azimuth, [azimuth - turn, azimuth + turn], "deg"),
        }


def _entry(estimate, interval, unit) -> dict:
    return {
        "estimate": float(f"{estimate:.6g}"),
        "ci95": [float(f"{interval[0]:.6g}"), float(f"{interval[1]:.6g}")],
        "unit": unit,
    }


def not_identified(parameters: dict[str, dict]) -> dict[str, str]:
    """Parameters at a bound, or not known to a factor 3, and why.

    A coefficient is known by itself, as is what a mechanism has beside its size; a size by what it
    differs from that of no effect. A vector is judged as a whole, its bounds by its components.
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
