"""The times of the protocol that a network sees, and the calibrated view at each."""

from dataclasses import dataclass

import numpy as np

from slipstitch.config import Config
from slipstitch.design.grid import sampled_frames
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.images.calibrated_view import CalibratedView, viewpoint_pose


@dataclass(frozen=True)
class Schedule(CalibratedView):
    """The frames of a dataset's videos."""

    frame: np.ndarray  # (n,) int: numbers in the simulation
    frame_rate_hz: float  # frame k is at k / this, counted from the start of the stage's motion
    path: StagePath

    @classmethod
    def of(cls, config: Config) -> "Schedule":
        """The schedule of the dataset that a configuration makes, in the calibrated view."""
        simulation = config.simulation
        path, rate_hz = StagePath(**dict(simulation.stage)), simulation.frame_rate_hz
        return cls(
            viewpoint_pose("calibrated", config.render),
            config.render.pixels,
            path.position_m,
            np.arange(int(simulation.recorded_s * rate_hz) + 1) / rate_hz,
            (SIDE_M, SIDE_M),
            sampled_frames(simulation.frames, config.sample.frames),
            rate_hz,
            path,
        )

    @property
    def time_s(self) -> np.ndarray:
        """Times of the frames from the start of the stage's motion."""
        return self.frame / self.frame_rate_hz
