"""A slider pulled by a spring at constant speed: exact stick-slip, event by event.

While it slips, the slider is a mass on a spring under constant kinetic friction, solved in closed
form, so there is no time step. With extension e of the spring, m e'' + k e = F_k in the slip
(drive at constant speed), starting at e = F_s / k with e' = V and ending when the slider stops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Slider:
    """Mass (kg), spring (N/m) and drive speed (m/s)."""

    mass_kg: float
    spring_N_m: float
    speed_m_s: float

    @property
    def inertial_force(self) -> float:
        """V sqrt(k m), N: the spring force that the drive speed alone swings by."""
        return self.speed_m_s * np.sqrt(self.spring_N_m * self.mass_kg)


@dataclass(frozen=True)
class StickSlip:
    """Events of a run, each (n,): place, stick time, and extremes of the spring's force."""

    place_m: np.ndarray
    stick_s: np.ndarray
    peak_N: np.ndarray
    trough_N: np.ndarray


def swing(slider: Slider, excess_N: np.ndarray | float) -> np.ndarray | float:
    """Half the drop from peak to trough: sqrt((F_s - F_k)^2 + V^2 k m).

    Inertia alone makes drops that grow with the speed, at no change of friction.
    """
    return np.hypot(excess_N, slider.inertial_force)


def run(
    slider: Slider,
    static_N: Callable[[float, float], float],
    kinetic_N: Callable[[float], float],
    start_m: float,
    end_m: float,
    most: int = 100_000,
) -> StickSlip:
    """Integrate from event to event.

    Parameters
    ----------
    static_N : of place (m) and stick time (s): the force at which the slider starts.
    kinetic_N : of place (m), taken at the start of each slip.
    start_m, end_m : places of the slider between which it is followed.
    """
    k, v = slider.spring_N_m, slider.speed_m_s
    omega = np.sqrt(k / slider.mass_kg)
    place, force = start_m, kinetic_N(start_m)
    events = []
    while place < end_m and len(events) < most:
        # The spring loads at k V until it exceeds a static friction that may grow meanwhile.
        stick = max(static_N(place, 0.0) - force, 0.0) / (k * v)
        for _ in range(50):
            update = max(static_N(place, stick) - force, 0.0) / (k * v)
            if abs(update - stick) < 1e-9 + 1e-9 * stick:
                break
            stick = update
        start = force + k * v * stick
        kinetic = min(kinetic_N(place), start)
        a, b = (start - kinetic) / k, v / omega
        # e' = V again (the slider stops) at the angle below; in between the extremes +- r.
        angle = 2 * np.pi - 2 * np.arctan2(a, b)
        r = np.hypot(a, b)
        force = kinetic - k * a
        moved = v * angle / omega + 2 * a
        events.append((place, stick, kinetic + k * r, kinetic - k * r))
        place += max(moved, 1e-9)
    table = np.array(events).reshape(-1, 4)
    return StickSlip(*table.T)
