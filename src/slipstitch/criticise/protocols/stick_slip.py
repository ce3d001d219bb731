"""A slider pulled by a spring at constant speed: steady stick-slip in closed form.

While it slips, the slider is a mass on a spring under constant kinetic friction. With extension e
of the spring, m e'' + k e = F_k in the slip (drive at constant speed), starting at e = F_s / k with
e' = V and ending when the slider stops.
"""

from __future__ import annotations

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
    def period_s(self) -> float:
        """The natural period 2 pi sqrt(m / k)."""
        return 2 * np.pi * np.sqrt(self.mass_kg / self.spring_N_m)

    @property
    def inertial_force(self) -> float:
        """V sqrt(k m), N: the spring force that the drive speed alone swings by."""
        return self.speed_m_s * np.sqrt(self.spring_N_m * self.mass_kg)


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


def steady_cycle(slider: Slider, law: FrictionLaw, rest: Contact, motion: Contact) -> Cycle:
    """The cycle that a slider which starts from rest, its spring relaxed, settles in.

    The first slip comes after the rest of ``rest`` and the time in which the spring loads. Each
    slip ends as far below the kinetic friction as it began above it, so the next
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
    for _ in range(60):
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
