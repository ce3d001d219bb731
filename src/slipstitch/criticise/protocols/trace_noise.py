"""How noisy traces are, told by the traces themselves.

Features are read off traces by thresholds and errors that follow the stated uncertainty; where the
noise is far more, slips are seen where none are, and the features are wrong before any inference.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi_square

# Uncertainties are usually stated this much too small; only more is allowed for before reading.
USUAL_UNDERSTATEMENT = 1.25
FEWEST_READINGS = 30
# Median of |z| of a normal variable; beyond as many deviations a trace bends.
MEDIAN_DEVIATION = 0.6745
BENDS = 4.0


@dataclass(frozen=True)
class TraceNoise:
    """Noise of a sensor over what is stated, with its 95 % interval, and its quantity's name."""

    sensor: str
    quantity: str
    factor: float
    ci95: tuple[float, float]

    @property
    def allowance(self) -> float:
        """By what stated uncertainties are multiplied before features are read."""
        return max(self.factor / USUAL_UNDERSTATEMENT, 1.0)


def off_neighbours(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Deviations of readings (n,) from the cubic through two neighbours on each side, (n - 4,).

    They are in units of one reading's noise; places need not be evenly spaced.
    """
    if len(x) < 5:
        return np.zeros(0)
    places = np.stack([x[:-4], x[1:-3], x[3:-1], x[4:]])
    values = np.stack([y[:-4], y[1:-3], y[3:-1], y[4:]])
    middle = x[2:-2]
    weights = np.ones_like(places)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[i] *= (middle - places[j]) / (places[i] - places[j])
        result = (y[2:-2] - (weights * values).sum(axis=0)) / np.sqrt(1 + (weights**2).sum(axis=0))
    return result[np.isfinite(result)]


def noise_of(
    sensor: str, quantity: str, deviations: Iterable[np.ndarray], robust: bool = True
) -> TraceNoise:
    """Noise from deviations in units of what is stated.

    ``robust``: by their median, so that the places where a trace bends do not count.
    """
    z = np.concatenate([np.zeros(0), *deviations])
    if len(z) < FEWEST_READINGS:
        return TraceNoise(sensor, quantity, 1.0, (0.0, np.inf))
    if robust:
        factor = np.median(np.abs(z)) / MEDIAN_DEVIATION
        z = z[np.abs(z) <= BENDS * factor]
        factor = np.median(np.abs(z)) / MEDIAN_DEVIATION
    else:
        factor = np.sqrt(np.mean(z**2))
    # A median tells as much as a mean square of a third of the readings; neighbours share them.
    degrees = len(z) / (7.0 if robust else 1.0)
    low, high = factor * np.sqrt(degrees / chi_square.ppf([0.975, 0.025], degrees))
    return TraceNoise(sensor, quantity, float(factor), (float(low), float(high)))
