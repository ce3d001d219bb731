"""Stick-slip from event to event: each slip in closed form, so that there is no time step."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StickSlip:
    """Events of a run, each (n,): place, stick time, and extremes of the spring's force."""

    place_m: np.ndarray
    stick_s: np.ndarray
    peak_N: np.ndarray
    trough_N: np.ndarray


def run(slider, static_N, kinetic_N, start_m, end_m, most=100_000):
    """Integrate from event to event, the slider between two places.

    ``static_N`` is of place (m) and stick time (s), ``kinetic_N`` of the place where a slip starts.
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
