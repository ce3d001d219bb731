"""The times of the protocol that a network sees, and the crop at each."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slipstitch.config.render import RenderSettings
from slipstitch.config.sample import SampleSettings
from slipstitch.config.simulation import SimulationSettings
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.images.camera import Camera, Pose, cloth_room, crop_to
from slipstitch.images.mean_cloth import MeanCloth, lags_m
from slipstitch.images.shots import viewpoint_pose


@dataclass(frozen=True)
class Schedule:
    """The frames of a dataset's videos.

    Attributes
    ----------
    frame : ndarray (n,) int
        Numbers in the simulation.
    frame_rate_hz : float
        Frame k is at k / this, counted from the start of the stage's motion.
    pose : Pose
        Of the viewpoint that the networks were trained for.
    pixels : int
        Side of an image.
    follows : bool
        Whether the crop follows the stage.
    duration_s : float
        Of the simulated part of the protocol.
    path : StagePath
    """

    frame: np.ndarray
    frame_rate_hz: float
    pose: Pose
    pixels: int
    follows: bool
    duration_s: float
    path: StagePath = field(default_factory=StagePath)

    @classmethod
    def of(
        cls,
        simulation: SimulationSettings,
        render: RenderSettings,
        sample: SampleSettings,
        viewpoint: str = "calibrated",
    ) -> "Schedule":
        """The schedule of the dataset that a configuration makes, in one viewpoint."""
        return cls(
            sampled_frames(simulation.frames, sample.frames),
            simulation.frame_rate_hz,
            viewpoint_pose(viewpoint, render),
            render.pixels,
            render.crop == "follow",
            simulation.recorded_s,
            StagePath(**dict(simulation.stage)),
        )

    @property
    def time_s(self) -> np.ndarray:
        """Times of the frames from the start of the stage's motion."""
        return self.frame / self.frame_rate_hz

    def crop(self, time_s: float | np.ndarray) -> Camera:
        """The image's camera at a time."""
        if not self.follows:
            time_s = self._simulated_s
        room = cloth_room(*self.path.position_m(time_s), SIDE_M, SIDE_M)
        return crop_to(self.pose, room, self.pixels)

    def cloth(self, time_s: float) -> MeanCloth:
        """Where the cloth is at a time, on average."""
        x_m, z_m = (float(place) for place in self.path.position_m(time_s))
        return MeanCloth(x_m, z_m, float(np.interp(time_s, self._simulated_s, self._lags_m)))

    @cached_property
    def _simulated_s(self) -> np.ndarray:
        return np.arange(int(self.duration_s * self.frame_rate_hz) + 1) / self.frame_rate_hz

    @cached_property
    def _lags_m(self) -> np.ndarray:
        return lags_m(*self.path.position_m(self._simulated_s), SIDE_M)
