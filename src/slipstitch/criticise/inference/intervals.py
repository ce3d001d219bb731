"""Estimates of parameters with their 95 % intervals, in the units of the specification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from slipstitch.criticise.causes import MECHANISMS
from slipstitch.criticise.inference.fit import Fit


@dataclass(frozen=True)
class Intervals:
    """Of one fit.

    Attributes
    ----------
    specimens : that the fit has seen.
    inflation : of the variance of each mechanism's parameters.
    """

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
