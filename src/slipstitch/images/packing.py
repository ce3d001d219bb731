"""Shading packs: the light of one simulation from one viewpoint, the complete output of Blender.

Any texture is composed from a pack and the trajectory, without Blender. Light is kept in half
precision (relative error 2^-11, under a tenth of an 8-bit level), its high and low bytes apart,
which compresses better. Packs are read and written frame by frame.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    file_digest,
    open_parquet,
    parquet_stream,
    provenance_record,
    read_metadata,
    start_clock,
)
from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS, catalogue_entries
from slipstitch.config.render import RenderSettings
from slipstitch.design.interpolation import Interpolation, interpolations
from slipstitch.images.bench_camera import BenchCamera, draw_bench_camera
from slipstitch.images.interpolation import interpolated
from slipstitch.images.shading import LIGHT_OVERSAMPLING, Shading, Sight, look, shade
from slipstitch.images.shots import (
    Shot,
    camera_record,
    cloth_size,
    recorded_shots,
    share_in_image,
    shots,
)
from slipstitch.images.surroundings import FLOOR_M, MATTE, Surroundings, draw_surroundings
from slipstitch.physics.simulation.trajectory import Trajectory, read_trajectory

_SCHEMA = pa.schema(
    [
        ("frame", pa.int32()),
        ("window", pa.list_(pa.int32())),
        ("still", pa.binary()),
        ("cloth", pa.binary()),
        ("mirrored", pa.binary()),
    ]
)
# What is mirrored has one scattering more to resolve.
_SAMPLES_MIRRORED = 2
#: Largest light that half precision holds.
_BRIGHTEST = 6e4


@dataclass(frozen=True)
class Job:
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
    """

    trajectory_path: str | os.PathLike
    viewpoint_id: str
    viewpoint: str
    settings: RenderSettings
    frames_sampled: int
    seed: int
    interpolation: Interpolation | None

    @classmethod
    def of(cls, config: Config, trajectory_path: str | os.PathLike, viewpoint: str) -> Self:
        """The job of a configuration, with a viewpoint by its id or its name.

        Raises
        ------
        BadInput
            If there is no such viewpoint.
        """
        ids = config.render.viewpoint_ids()
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
        return cls.of_view(config, trajectory_path, identity, name)

    @classmethod
    def of_view(
        cls, config: Config, trajectory_path: str | os.PathLike, viewpoint_id: str, viewpoint: str
    ) -> Self:
        """The job of a configuration, with id and name of a viewpoint."""
        return cls(
            trajectory_path,
            viewpoint_id,
            viewpoint,
            config.render,
            config.sample.frames_kept,
            config.seed,
            interpolations(config).get((Path(trajectory_path).stem, viewpoint_id)),
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
    def other_floors(self) -> str:
        """The key of the floors that this viewpoint does not show."""
        return "floors" if self.settings.reflective(self.viewpoint_id) else "reflective_floors"

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

    def inputs(self) -> list:
        """The files that the light depends on."""
        camera = self.settings.camera_of(self.viewpoint)
        return [*self.parents, *([camera] if camera else [])]

    def catalogue_entries(self, textures: Iterable[str] = ()) -> dict:
        """What the record says of the catalogue: viewpoint, floors, and the textures composed."""
        floors = self.settings.floors_of(self.viewpoint_id)
        return catalogue_entries([self.viewpoint], textures, floors)


@dataclass(frozen=True)
class Pack:
    """The light of a simulation from a viewpoint.

    Attributes
    ----------
    metadata : dict
        Simulation, viewpoint, cameras, surroundings.
    shots : list of Shot
    shadings : iterable of dict
        As half-precision bytes, one a shot; may be run through only once.
    """

    metadata: dict
    shots: list[Shot]
    shadings: Iterable[dict]

    @property
    def surroundings(self) -> Surroundings:
        """Floor and lamp."""
        record = dict(self.metadata["surroundings"])
        record["lamp_position_m"] = tuple(record["lamp_position_m"])
        return Surroundings(**record)

    def frames(self, trajectory: Trajectory) -> Iterator[tuple[Shot, Shading, Sight]]:
        """Each frame's light and what its rays see."""
        for shot, packed in zip(self.shots, self.shadings, strict=True):
            sight = _sight(trajectory, shot, self.surroundings)
            yield shot, _unpack(packed, shot.camera.pixels), sight


def usable_trajectory(path: str | os.PathLike) -> Trajectory:
    """A trajectory that can be rendered; BadInput if it cannot."""
    trajectory = read_trajectory(path)
    if trajectory.uv.min() < -1e-9 or trajectory.uv.max() > 1 + 1e-9:
        raise BadInput(f"{path}: texture coordinates are outside 0 ... 1")
    if min(cloth_size(trajectory)) <= 0 or trajectory.stage_z_m.min() < 0:
        raise BadInput(f"{path}: the cloth has no extent or hangs below the floor")
    return trajectory


def _sight(trajectory: Trajectory, shot: Shot, surroundings: Surroundings) -> Sight:
    positions = trajectory.positions_m[shot.row].astype(np.float64)
    mesh = (positions, trajectory.faces, trajectory.uv)
    return look(*mesh, FLOOR_M, shot.camera, surroundings)


def render_shadings(
    trajectory: Trajectory,
    wanted: list[Shot],
    settings: RenderSettings,
    surroundings: Surroundings = MATTE,
) -> Iterator[tuple[Shot, Shading, Sight]]:
    """Render the frames one by one in Blender."""
    from slipstitch.images.blender import ClothScene

    scene = ClothScene(trajectory.faces, trajectory.uv, surroundings, threads=settings.threads)
    samples = settings.samples * (_SAMPLES_MIRRORED if surroundings.reflects else 1)
    for shot in wanted:
        rendering = scene.render(
            trajectory.positions_m[shot.row],
            shot.camera.at_resolution(shot.camera.pixels * LIGHT_OVERSAMPLING),
            samples=samples,
            seed=shot.frame,
        )
        sight = _sight(trajectory, shot, surroundings)
        yield shot, shade(*rendering, sight), sight


def shade_job(job: Job, trajectory: Trajectory, progress=iter) -> Pack:
    """Render the light of a simulation from a viewpoint.

    Parameters
    ----------
    job : Job
    trajectory : Trajectory
        The job's.
    progress : callable
        Wraps the list of frames, to show how far the work is.
    """
    settings = job.settings
    bench = job.bench_camera
    wanted = shots(trajectory, job.viewpoint, settings, job.frames_sampled, bench)
    surroundings = draw_surroundings(settings, job.seed, job.simulation, job.viewpoint_id)
    metadata = {
        "simulation": job.simulation,
        "viewpoint": {"id": job.viewpoint_id, "name": job.viewpoint},
        "camera": camera_record(wanted, settings, bench),
        "surroundings": surroundings.record(),
        "smallest_share_of_cloth_in_image": min(
            share_in_image(trajectory, shot) for shot in wanted
        ),
        "trajectory_sha256": _digests(job),
        "interpolation": job.interpolation and asdict(job.interpolation),
        "interpolated_frames": trajectory.metadata.get("interpolated_frames"),
    }
    frames = render_shadings(trajectory, progress(wanted), settings, surroundings)
    return Pack(metadata, wanted, (_pack(shading, sight) for _, shading, sight in frames))


def write_pack(job: Job, out: str | os.PathLike, progress=iter) -> Pack:
    """Render the light of a simulation from a viewpoint into a file, atomically."""
    started = start_clock()
    pack = shade_job(job, job.trajectory(), progress)
    with parquet_stream(out, _SCHEMA) as stream:
        for shot, packed in zip(pack.shots, pack.shadings, strict=True):
            stream.write([{"frame": shot.frame, **packed}])
        stream.describe(pack.metadata, _pack_record(job, started))
    return pack


def _pack_record(job: Job, started: tuple[float, float]) -> dict:
    # What the light does not depend on.
    unused: dict = dict.fromkeys(
        (
            "textures",
            "test_textures",
            "viewpoints",
            "test_viewpoints",
            "test_viewpoint_videos",
            "verified_images",
            job.other_floors,
        ),
        True,
    )
    unused["augmentation"] = {"exposure_stops", "colour_cast", "noise", "jpeg_quality"}
    return provenance_record(
        "render.packing",
        inputs=job.inputs(),
        config={
            "render": job.settings.model_dump(mode="json", exclude=unused),
            "sample": {"frames": job.frames_sampled},
            "viewpoint": job.viewpoint,
            "catalogue": job.catalogue_entries(),
        },
        seed=job.seed,
        started=started,
    )


def read_pack(path: str | os.PathLike, job: Job, trajectory: Trajectory) -> Pack:
    """Read what `write_pack` wrote.

    Parameters
    ----------
    path : path
    job : Job
    trajectory : Trajectory
        The job's.

    Raises
    ------
    BadInput
        If the file is missing, damaged, no shading pack, or of another trajectory.
    """
    with open_parquet(path) as file:
        metadata = read_metadata(file.schema_arrow)
        if file.schema_arrow.names != _SCHEMA.names or "surroundings" not in metadata:
            raise BadInput(f"{path}: not a shading pack")
    if metadata["trajectory_sha256"] != _digests(job):
        raise BadInput(f"{path}: not rendered from {', '.join(map(str, job.parents))}")
    return Pack(metadata, recorded_shots(metadata["camera"], trajectory), _rows(path))


def _digests(job: Job) -> str | dict[str, str]:
    """The digest of the trajectory, or of each that the film's cloth is made of, by name."""
    if job.interpolation is None:
        return file_digest(job.trajectory_path)
    return {path.stem: file_digest(path) for path in job.parents}


def _rows(path: str | os.PathLike) -> Iterator[dict]:
    """The pack's rows, a group of them at a time."""
    with open_parquet(path) as file:
        groups = file.num_row_groups
    for group in range(groups):
        with open_parquet(path) as file:
            rows = file.read_row_group(group).to_pylist()
        yield from rows


def _pack(shading: Shading, sight: Sight) -> dict:
    """Half-precision bytes of a frame's light; of the cloth's, what rays meet."""
    side = shading.cloth.shape[-1]
    step = sight.rays // LIGHT_OVERSAMPLING
    met = np.zeros((side, side), dtype=bool)
    y, x = np.divmod(sight.cloth.seen, side * step)
    met[y // step, x // step] = True
    rows, columns = np.flatnonzero(met.any(axis=1)), np.flatnonzero(met.any(axis=0))
    window = [0, 0, 0, 0]
    if len(rows):
        window = [rows[0], rows[-1] + 1, columns[0], columns[-1] + 1]
    top, bottom, left, right = window
    cloth = (shading.cloth * met)[:, top:bottom, left:right]
    return {
        "window": [int(edge) for edge in window],
        "still": _bytes(shading.still),
        "cloth": _bytes(cloth),
        "mirrored": None if shading.mirrored is None else _bytes(shading.mirrored),
    }


def _unpack(packed: dict, pixels: int) -> Shading:
    top, bottom, left, right = packed["window"]
    cloth = np.zeros((3, LIGHT_OVERSAMPLING * pixels, LIGHT_OVERSAMPLING * pixels), np.float32)
    cloth[:, top:bottom, left:right] = _array(packed["cloth"], (3, bottom - top, right - left))
    mirrored = packed["mirrored"]
    if mirrored is not None:
        mirrored = _array(mirrored, (2, pixels, pixels))
    return Shading(_array(packed["still"], (3, pixels, pixels)), cloth, mirrored)


def _bytes(light: np.ndarray) -> bytes:
    half = np.clip(light, -_BRIGHTEST, _BRIGHTEST).astype("<f2")
    return np.ascontiguousarray(half.ravel().view(np.uint8).reshape(-1, 2).T).tobytes()


def _array(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    halves = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(2, -1).T)
    return halves.view("<f2").reshape(shape).astype(np.float32)
