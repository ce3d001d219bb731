"""The cloth and the path of the stage that carries its clamps (the paper, Sec. 4.1)."""

from dataclasses import dataclass

import numpy as np

from slipstitch.config.simulation import SIDE_M

__all__ = ["SIDE_M", "TAB_M", "StagePath"]

TAB_M = 0.01  # width of the tabs that hold its upper corners


@dataclass(frozen=True)
class StagePath:
    """Lowering, then strokes forth and back, each with trapezoidal speed."""

    start_height_m: float = 0.21  # height of the clamps above the floor at time 0
    drop_m: float = 0.06  # distance lowered
    stroke_m: float = 0.30  # length of a horizontal stroke
    strokes: int = 4  # forward, back, forward, back
    speed_m_s: float = 0.010
    acceleration_m_s2: float = 0.010

    def _travel_duration_s(self, distance_m: float) -> float:
        ramp_s = self.speed_m_s / self.acceleration_m_s2
        if distance_m < self.speed_m_s * ramp_s:  # never reaches full speed
            return 2 * float(np.sqrt(distance_m / self.acceleration_m_s2))
        return distance_m / self.speed_m_s + ramp_s

    @property
    def lowered_height_m(self) -> float:
        """Height of the clamps above the floor while they are dragged."""
        return self.start_height_m - self.drop_m

    @property
    def drop_duration_s(self) -> float:
        return self._travel_duration_s(self.drop_m)

    @property
    def stroke_duration_s(self) -> float:
        return self._travel_duration_s(self.stroke_m)

    @property
    def duration_s(self) -> float:
        """131 s with the default values."""
        return self.drop_duration_s + self.strokes * self.stroke_duration_s

    def _travelled_m(self, time_s: np.ndarray, distance_m: float) -> np.ndarray:
        duration_s = self._travel_duration_s(distance_m)
        t = np.clip(time_s, 0.0, duration_s)
        a = self.acceleration_m_s2
        ramp_s = min(self.speed_m_s / a, duration_s / 2)
        speeding = 0.5 * a * np.minimum(t, ramp_s) ** 2
        cruising = a * ramp_s * np.clip(t - ramp_s, 0.0, duration_s - 2 * ramp_s)
        left_s = duration_s - np.maximum(t, duration_s - ramp_s)
        slowing = 0.5 * a * (ramp_s**2 - left_s**2)
        return speeding + cruising + slowing

    def position_m(self, time_s: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stage position x and clamp height z at given times, in metres."""
        time_s = np.asarray(time_s, float)
        z = self.start_height_m - self._travelled_m(time_s, self.drop_m)
        x = np.zeros_like(time_s)
        for stroke in range(self.strokes):
            begin_s = self.drop_duration_s + stroke * self.stroke_duration_s
            x = x + (-1) ** stroke * self._travelled_m(time_s - begin_s, self.stroke_m)
        return x, z
