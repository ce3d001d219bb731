"""A view: one simulation from one viewpoint, with all that its videos are made of.

Everything is decided here before anything is rendered: the motion, the camera and its errors, floor
and lamp, the frames, what the cloth wears, and the camera effects of each video.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record
from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS, catalogue_entries
from slipstitch.config.render import RenderSettings
from slipstitch.design import grid
from slipstitch.design.interpolation import Interpolation, interpolations
from slipstitch.images import calibrated_view
from slipstitch.images.calibrated_view import BenchCamera, CalibratedView, Rectifier
from slipstitch.images.camera import Camera
from slipstitch.images.encoding import CameraEffects, draw_camera_effects
from slipstitch.images.surroundings import Surroundings, draw_surroundings, drawn_by, generator
from slipstitch.images.textures import worn_texture
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory

#: A frame of which one edge in a hundred is strained more is no cloth; simulated: 0.022 at most.
STRAIN_MAX = 0.03


@dataclass(frozen=True)
class Shot:
    """One frame to render: its row in the trajectory, its number, its time, its camera."""

    row: int
    frame: int
    time_s: float
    camera: Camera

    def share_in_image(self, trajectory: Trajectory) -> float:
        """Share of the cloth's vertices that project into the image."""
        place = self.camera.project(trajectory.positions_m[self.row].astype(np.float64))
        inside = (place > -0.5) & (place < self.camera.pixels - 0.5)
        return float(inside.all(axis=1).mean())


@dataclass(frozen=True)
class View:
    """One simulation from one viewpoint."""

    trajectory_path: str | os.PathLike  # its name without suffix is the simulation's id
    # as the rows call it, and its name in the catalogue
    viewpoint_id: str
    viewpoint: str
    settings: RenderSettings
    frames_sampled: int  # how many frames the sample stage uses
    seed: int  # the configuration's
    # of simulations in the trajectory's folder: the film shows it, not the trajectory as it is
    interpolation: Interpolation | None = None
    # id -> name of the textures that the cloth wears, on which the light does not depend
    textures: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, config: Config, trajectory_path: str | os.PathLike, viewpoint: str) -> "View":
        """The view of a configuration, with a viewpoint by its id or its name; else BadInput."""
        ids = grid.viewpoint_ids(config.render)
        name = ids.get(viewpoint, viewpoint)
        if name not in VIEWPOINTS:
            known = ", ".join(f"{key} ({value})" for key, value in ids.items())
            raise BadInput(
                f"no viewpoint {viewpoint!r}; the configuration has {known}; "
                f"known names: {', '.join(VIEWPOINTS)}"
            )
        # A viewpoint given by name keeps its id if the configuration has one.
        named = next((key for key, value in ids.items() if value == name), name)
        identity = viewpoint if viewpoint in ids else named
        return cls.identified(config, trajectory_path, identity, name)

    @classmethod
    def identified(
        cls, config: Config, trajectory_path: str | os.PathLike, viewpoint_id: str, viewpoint: str
    ) -> "View":
        """The view with id and name of a viewpoint, of any: in all textures then."""
        key = (Path(trajectory_path).stem, viewpoint_id)
        made = config.render, config.sample.frames_kept, config.seed
        shown = interpolations(config).get(key)
        textures = grid.films(config).get(key) or grid.texture_ids(config.render)
        return cls(trajectory_path, viewpoint_id, viewpoint, *made, shown, textures)

    @property
    def simulation(self) -> str:
        """The simulation's id."""
        return Path(self.trajectory_path).stem

    @property
    def bench_camera(self) -> BenchCamera | None:
        """Pose of the camera, if its viewpoint belongs to a family; otherwise None."""
        if not VIEWPOINTS[self.viewpoint].drawn:
            return None
        return calibrated_view.draw_bench_camera(self.seed, self.simulation, self.viewpoint)

    @property
    def surroundings(self) -> Surroundings:
        """Floor and lamp."""
        return draw_surroundings(self.settings, self.seed, self.simulation, self.viewpoint_id)

    def camera_effects(self) -> dict[str, CameraEffects]:
        """Every texture's id -> the camera effects of its video."""
        drawn_for = self.settings.augmentation, self.seed, self.simulation
        return {
            identity: draw_camera_effects(*drawn_for, name, self.viewpoint)
            for identity, name in self.textures.items()
        }

    def noise(self, texture: str, frame: int) -> np.random.Generator:
        """The random numbers of an image's noise, the same for all videos of a bench."""
        bench = drawn_by(self.simulation, self.viewpoint)
        return generator(self.seed, bench, texture, self.viewpoint, str(frame))

    def worn(self, name: str) -> str:
        """What the cloth wears for a texture of this name, as `textures.texture` takes it."""
        return worn_texture(name, self.seed, self.simulation, self.viewpoint)

    @property
    def parents(self) -> list[Path]:
        """Trajectories of the simulations that the film's cloth is made of."""
        path = Path(self.trajectory_path)
        if self.interpolation is None:
            return [path]
        return [path.with_stem(name) for name in self.interpolation.weights]

    def trajectory(self) -> Trajectory:
        """The motion that the film shows: the simulation's, or one between several."""
        if self.interpolation is None:
            return usable_trajectory(self.trajectory_path)
        parents = {path.stem: usable_trajectory(path) for path in self.parents}
        return interpolated(parents, self.interpolation.weights, self.simulation)

    def calibrated(self, trajectory: Trajectory) -> CalibratedView:
        """The crop and the mean cloth over the course of the film."""
        return CalibratedView.of_trajectory(trajectory, self.viewpoint, self.settings)

    def shots(self, trajectory: Trajectory) -> list[Shot]:
        """The frames to render, and the camera of each."""
        settings, bench, calibrated = self.settings, self.bench_camera, self.calibrated(trajectory)
        count = len(trajectory.frame)
        sampled = settings.frames == "sampled"
        result = []
        for row in grid.sampled_frames(count, self.frames_sampled) if sampled else range(count):
            time_s = float(trajectory.time_s[row])
            camera = calibrated.crop(time_s)
            if bench:
                pixels = round(settings.pixels * settings.bench_camera.oversampling)
                room = calibrated_view.bench_room(
                    camera, float(trajectory.stage_x_m[row]), calibrated.room(time_s)
                )
                camera = calibrated_view.crop_to(bench.pose(*calibrated.pose), room, pixels)
            result.append(Shot(int(row), int(trajectory.frame[row]), time_s, camera))
        return result

    def rectifier(self, trajectory: Trajectory) -> Rectifier:
        """What brings the images into the calibrated viewpoint."""
        return Rectifier(self.bench_camera, self.calibrated(trajectory))

    def record(
        self,
        stage: str,
        started: tuple[float, float],
        unused: Mapping[str, Any],
        files: Iterable = (),
        textures: Iterable[str] = (),
    ) -> dict:
        """Provenance of the light, or with textures (by name) and their `files` of images.

        `unused` are the keys of the settings that do not matter, as of `BaseModel.model_dump`.
        """
        reflective = grid.is_reflective(self.settings, self.viewpoint_id)
        other_floors = "floors" if reflective else "reflective_floors"
        shown = self.settings.model_dump(mode="json", exclude={**unused, other_floors: True})
        camera = self.settings.camera_of(self.viewpoint)
        floors = grid.floors_of(self.settings, self.viewpoint_id)
        return provenance_record(
            stage,
            inputs=[*self.parents, *([camera] if camera else []), *files],
            config={
                "render": shown,
                "sample": {"frames": self.frames_sampled},
                "viewpoint": self.viewpoint,
                "catalogue": catalogue_entries([self.viewpoint], textures, floors),
            },
            seed=self.seed,
            started=started,
        )


def camera_record(wanted: list[Shot], bench: BenchCamera | None = None) -> dict:
    """The cameras of all shots, as a shard's metadata holds them."""
    first = wanted[0].camera
    crops = {shot.frame: shot.camera.matrix for shot in wanted}
    return {
        "convention": "OpenCV: x_camera = rotation x_world + translation_m; x right, y down, "
        "z forward; the centre of the first pixel is (0, 0); no distortion",
        "pixels": first.pixels,
        "bench": bench and asdict(bench),
        "rotation": first.rotation.tolist(),
        "translation_m": first.translation_m.tolist(),
        "frames": {
            str(frame): {"focal_px": matrix[0, 0], "principal_point_px": matrix[:2, 2].tolist()}
            for frame, matrix in crops.items()
        },
    }


def recorded_shots(record: dict, trajectory: Trajectory) -> list[Shot]:
    """The shots whose `camera_record` this is."""
    rotation, translation = np.array(record["rotation"]), np.array(record["translation_m"])
    rows = {int(frame): row for row, frame in enumerate(trajectory.frame)}
    result = []
    for frame, crop in record["frames"].items():
        focal, (x, y) = crop["focal_px"], crop["principal_point_px"]
        matrix = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
        camera = Camera(rotation, translation, matrix, record["pixels"])
        row = rows[int(frame)]
        result.append(Shot(row, int(frame), float(trajectory.time_s[row]), camera))
    return result


def usable_trajectory(path: str | os.PathLike) -> Trajectory:
    """A trajectory that can be rendered; BadInput if it cannot."""
    trajectory = read_trajectory(path)
    if trajectory.uv.min() < -1e-9 or trajectory.uv.max() > 1 + 1e-9:
        raise BadInput(f"{path}: texture coordinates are outside 0 ... 1")
    if min(calibrated_view.cloth_size(trajectory)) <= 0 or trajectory.stage_z_m.min() < 0:
        raise BadInput(f"{path}: the cloth has no extent or hangs below the floor")
    return trajectory


def interpolated(
    parents: Mapping[str, Trajectory], weights: Mapping[str, float], own: str
) -> Trajectory:
    """The weighted mean of trajectories on one mesh, frame by frame as far as it is a cloth.

    Where edges collapse in the mean, a frame shows the film's `own` simulation.
    """
    first, total = parents[own], sum(weights.values())
    for name, other in parents.items():
        for key in ("faces", "uv", "frame", "time_s", "stage_x_m"):
            if not np.array_equal(getattr(other, key), getattr(first, key)):
                raise BadInput(f"{name}: its {key} is not that of {own}")
    mean_m, mean_z_m = np.zeros(first.positions_m.shape), np.zeros_like(first.stage_z_m)
    for name, weight in weights.items():
        mean_m += weight / total * parents[name].positions_m
        mean_z_m += weight / total * parents[name].stage_z_m
    whole = edge_strain(first, mean_m) <= STRAIN_MAX
    return replace(
        first,
        positions_m=np.where(whole[:, None, None], mean_m, first.positions_m).astype(np.float32),
        stage_z_m=np.where(whole, mean_z_m, first.stage_z_m),
        metadata={**first.metadata, "interpolated_frames": int(whole.sum())},
    )


def edge_strain(trajectory: Trajectory, positions_m: np.ndarray) -> np.ndarray:
    """The 99th percentile over the edges of the absolute strain of cloths (T, V, 3), shape (T,)."""
    sides = np.sort(trajectory.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    tail, head = np.unique(sides, axis=0).T
    rest_m = trajectory.rest_positions_m
    lengths_m = np.linalg.norm(positions_m[:, tail] - positions_m[:, head], axis=2)
    strain = lengths_m / np.linalg.norm(rest_m[tail] - rest_m[head], axis=1) - 1
    return np.percentile(np.abs(strain), 99, axis=1)
