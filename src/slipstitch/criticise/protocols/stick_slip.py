"""A slider pulled by a spring at constant speed: exact stick-slip, event by event.

While it slips, the slider is a mass on a spring under constant kinetic friction, solved in closed
form, so there is no time step. With extension e of the spring, m e'' + k e = F_k in the slip
(drive at constant speed), starting at e = F_s / k with e' = V and ending when the slider stops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from slipstitch.physics.friction_law import Contact, FrictionLaw

USUAL_REST_S = 10.0  # before the first slip, where it was not recorded


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


@dataclass(frozen=True)
class Cycle:
    """Steady stick-slip on an even track, each (n,); half drops in N, stick time in s."""

    level_N: np.ndarray
    swing_N: np.ndarray
    first_swing_N: np.ndarray
    stick_s: np.ndarray


def steady_cycle(
    slider: Slider, law: FrictionLaw, rest: Contact, motion: Contact, iterations: int = 60
) -> Cycle:
    """The cycle that a slider which starts from rest, its spring relaxed, settles in.

    The first slip comes after the rest of ``rest`` and the time in which the spring loads. Each
    slip ends as far below the kinetic friction as it began above it (:func:`run`), so the next
    stick lasts 2 (F_s - F_k) / (k V); static friction may grow meanwhile.
    """
    loading = slider.spring_N_m * slider.speed_m_s
    kinetic = law.force_limit(motion, static=False)
    resting = np.asarray(rest.dwell_s, float)
    first = law.force_limit(rest, static=True)
    for _ in range(3):  # the loading adds little to the rest, and its logarithm less
        first = law.force_limit(replace(rest, dwell_s=resting + first / loading), static=True)
    first_excess = np.maximum(first - kinetic, 0.0)
    start = replace(rest, dwell_s=np.where(np.isnan(resting), USUAL_REST_S, resting))
    excess = np.maximum(law.force_limit(start, static=True) - kinetic, 0.0)
    for _ in range(iterations):
        stick = 2.0 * excess / loading
        limit = law.force_limit(replace(rest, dwell_s=stick), static=True)
        update = np.maximum(limit - kinetic, 0.0)
        change = np.max(np.abs(update - excess), initial=0.0)
        excess = update
        if change < 1e-9 * np.max(kinetic, initial=1e-12):
            break
    return Cycle(kinetic, swing(slider, excess), swing(slider, first_excess), 2 * excess / loading)


def steady_force(slider: Slider, level_N: float, swing_N: float, time_s: np.ndarray) -> np.ndarray:
    """Spring force of steady stick-slip at times (n,), beginning with a stick."""
    k, v = slider.spring_N_m, slider.speed_m_s
    omega = np.sqrt(k / slider.mass_kg)
    excess = np.sqrt(max(swing_N**2 - slider.inertial_force**2, 0.0))
    stick = 2 * excess / (k * v)
    slip = (2 * np.pi - 2 * np.arctan2(excess / k, v / omega)) / omega
    phase = np.mod(time_s, stick + slip)
    angle = omega * np.maximum(phase - stick, 0.0)
    slipping = excess * np.cos(angle) + k * v / omega * np.sin(angle)
    return level_N + np.where(phase < stick, k * v * phase - excess, slipping)


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
