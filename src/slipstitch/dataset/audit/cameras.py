"""The cameras of a simulation's videos: they follow the stage, whatever the cloth does."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slipstitch.config import Config
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.release.records import carried_file, recorded_name
from slipstitch.design.grid import Simulation
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.images.bench_camera import Rectifier
from slipstitch.images.shots import Shot, camera_record
from slipstitch.images.view import View
from slipstitch.physics.simulation.drop_and_drag import draw_perturbation
from slipstitch.physics.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Cameras:
    """What filmed a simulation from a viewpoint, computed without the simulation.

    Attributes
    ----------
    contents : Contents
        The release; a camera file is taken from it.
    config : Config
    simulation : Simulation
    viewpoint_id : str
    """

    contents: Contents
    config: Config
    simulation: Simulation
    viewpoint_id: str

    @cached_property
    def view(self) -> View:
        """The view that is filmed."""
        config, render = self.config, self.config.render
        if render.camera:
            path = recorded_name(render.camera, self.contents.artefacts) or render.camera
            carried = self.contents.folder / carried_file(path)
            render = render.model_copy(update={"camera": str(carried)})
            config = config.model_copy(update={"render": render})
        name = render.viewpoint_ids()[self.viewpoint_id]
        return View.identified(config, f"{self.simulation.id}.parquet", self.viewpoint_id, name)

    @cached_property
    def bare(self) -> Trajectory:
        """Times and stage of the simulation, its cloth four corners that do not move."""
        settings = self.config.simulation
        count = settings.frames
        times_s = np.arange(count) / settings.frame_rate_hz
        x_m, z_m = StagePath(**dict(settings.stage)).position_m(times_s)
        simulation = self.simulation
        z_m = z_m + draw_perturbation(settings, simulation.seed, simulation.replicate).height_m
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1.0)])
        rest_m = SIDE_M * np.column_stack([np.zeros(4), corners * [1, -1]])
        return Trajectory(
            rest_m, corners, np.zeros((1, 3), int), np.zeros(1, int), np.arange(count), times_s,
            x_m, z_m, np.zeros((count, 4, 3), np.float32),
        )  # fmt: skip

    @cached_property
    def shots(self) -> list[Shot]:
        """The frames that are rendered, and the crop of each."""
        return self.view.shots(self.bare)

    def record(self) -> dict[str, Any]:
        """The entry ``camera`` of a shard's metadata."""
        return camera_record(self.shots, self.view.settings, self.view.bench_camera)

    @cached_property
    def rectify(self) -> Rectifier:
        """Brings images into the calibrated viewpoint."""
        return self.view.rectifier(self.bare)

    def pose(self) -> dict[str, float]:
        """The entry ``pose`` of a shard's metadata."""
        return self.rectify.pose(self.shots[0].camera)
