"""A view: one simulation from one viewpoint, with all that its videos are made of.

Everything is decided here before anything is rendered: the motion, the camera and its errors, floor
and lamp, the frames, what the cloth wears, and the camera effects of each video.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS, catalogue_entries
from slipstitch.config.render import RenderSettings
from slipstitch.design.grid import films, floors_of, is_reflective, texture_ids, viewpoint_ids
from slipstitch.design.interpolation import Interpolation, interpolations
from slipstitch.images.bench_camera import BenchCamera, Rectifier, draw_bench_camera
from slipstitch.images.calibrated_view import CalibratedView, cloth_size
from slipstitch.images.camera_effects import CameraEffects, draw_camera_effects, pixel_noise
from slipstitch.images.cloth_interpolation import interpolated
from slipstitch.images.shots import Shot, shots
from slipstitch.images.surroundings import Surroundings, draw_surroundings
from slipstitch.images.textures import worn_texture
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory


def usable_trajectory(path: str | os.PathLike) -> Trajectory:
    """A trajectory that can be rendered; BadInput if it cannot."""
    trajectory = read_trajectory(path)
    if trajectory.uv.min() < -1e-9 or trajectory.uv.max() > 1 + 1e-9:
        raise BadInput(f"{path}: texture coordinates are outside 0 ... 1")
    if min(cloth_size(trajectory)) <= 0 or trajectory.stage_z_m.min() < 0:
        raise BadInput(f"{path}: the cloth has no extent or hangs below the floor")
    return trajectory


@dataclass(frozen=True)
class View:
    """One simulation from one viewpoint.

    Attributes
    ----------
    trajectory_path : path
        Its name without suffix is the simulation's id.
    viewpoint_id, viewpoint : str
        As the rows call it, and its name in the catalogue.
    settings : RenderSettings
    frames_sampled : int
        How many frames the sample stage uses.
    seed : int
        The configuration's.
    interpolation : Interpolation, optional
        Of simulations in the trajectory's folder: the film shows it, not the trajectory as it is.
    textures : mapping
        Id -> name of the textures that the cloth wears, on which the light does not depend.
    """

    trajectory_path: str | os.PathLike
    viewpoint_id: str
    viewpoint: str
    settings: RenderSettings
    frames_sampled: int
    seed: int
    interpolation: Interpolation | None = None
    textures: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, config: Config, trajectory_path: str | os.PathLike, viewpoint: str) -> "View":
        """The view of a configuration, with a viewpoint by its id or its name.

        Raises
        ------
        BadInput
            If there is no such viewpoint.
        """
        ids = viewpoint_ids(config.render)
        name = ids.get(viewpoint, viewpoint)
        if name not in VIEWPOINTS:
            known = ", ".join(f"{key} ({value})" for key, value in ids.items())
            raise BadInput(
                f"no viewpoint {viewpoint!r}; the configuration has {known}; "
                f"known names: {', '.join(VIEWPOINTS)}"
            )
        # A viewpoint given by name keeps its id if the configuration has one.
        named = next((key for key, value in ids.items() if value == name), name)
        return cls.identified(
            config, trajectory_path, viewpoint if viewpoint in ids else named, name
        )

    @classmethod
    def identified(
        cls, config: Config, trajectory_path: str | os.PathLike, viewpoint_id: str, viewpoint: str
    ) -> "View":
        """The view of a configuration, with id and name of a viewpoint.

        A simulation or viewpoint that the configuration does not have is filmed in all textures.
        """
        key = (Path(trajectory_path).stem, viewpoint_id)
        return cls(
            trajectory_path,
            viewpoint_id,
            viewpoint,
            config.render,
            config.sample.frames_kept,
            config.seed,
            interpolations(config).get(key),
            films(config).get(key) or texture_ids(config.render),
        )

    @property
    def simulation(self) -> str:
        """The simulation's id."""
        return Path(self.trajectory_path).stem

    @property
    def bench_camera(self) -> BenchCamera | None:
        """Pose of the camera, if its viewpoint belongs to a family; otherwise None."""
        if not VIEWPOINTS[self.viewpoint].drawn:
            return None
        return draw_bench_camera(self.settings, self.seed, self.simulation, self.viewpoint)

    @property
    def surroundings(self) -> Surroundings:
        """Floor and lamp."""
        return draw_surroundings(self.settings, self.seed, self.simulation, self.viewpoint_id)

    def camera_effects(self) -> dict[str, CameraEffects]:
        """Every texture's id -> the camera effects of its video."""
        settings = self.settings.augmentation
        return {
            identity: draw_camera_effects(
                settings, self.seed, self.simulation, name, self.viewpoint
            )
            for identity, name in self.textures.items()
        }

    def noise(self, texture: str, frame: int) -> np.random.Generator:
        """The random numbers of an image's noise, by the texture's name."""
        return pixel_noise(self.seed, self.simulation, texture, self.viewpoint, frame)

    def worn(self, name: str) -> str:
        """What the cloth wears for a texture of this name, as `textures.texture` takes it."""
        return worn_texture(name, self.seed, self.simulation, self.viewpoint)

    @property
    def other_floors(self) -> str:
        """The key of the floors that this viewpoint does not show."""
        return "floors" if is_reflective(self.settings, self.viewpoint_id) else "reflective_floors"

    @property
    def parents(self) -> list[Path]:
        """Trajectories of the simulations that the film's cloth is made of."""
        path = Path(self.trajectory_path)
        if self.interpolation is None:
            return [path]
        return [path.with_stem(name) for name in self.interpolation.weights]

    def trajectory(self) -> Trajectory:
        """The motion that the film shows: the simulation's, or one between several.

        Raises
        ------
        BadInput
            If a trajectory cannot be rendered, or does not fit the others.
        """
        if self.interpolation is None:
            return usable_trajectory(self.trajectory_path)
        parents = {path.stem: usable_trajectory(path) for path in self.parents}
        return interpolated(parents, self.interpolation.weights, self.simulation)

    def shots(self, trajectory: Trajectory) -> list[Shot]:
        """The frames to render, and the camera of each."""
        how = (self.viewpoint, self.settings, self.frames_sampled, self.bench_camera)
        return shots(trajectory, *how)

    def rectifier(self, trajectory: Trajectory) -> Rectifier:
        """What brings the images into the calibrated viewpoint."""
        calibrated = CalibratedView.of_trajectory(trajectory, self.viewpoint, self.settings)
        return Rectifier(self.bench_camera, calibrated)

    def inputs(self) -> list:
        """The files that the light depends on."""
        camera = self.settings.camera_of(self.viewpoint)
        return [*self.parents, *([camera] if camera else [])]

    def catalogue_entries(self, textures: Iterable[str] = ()) -> dict:
        """What the record says of the catalogue: viewpoint, floors, and the textures composed."""
        floors = floors_of(self.settings, self.viewpoint_id)
        return catalogue_entries([self.viewpoint], textures, floors)
