"""From the light of a simulation from one viewpoint to its image shard: textures and cameras."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
import pyarrow as pa

from slipstitch.base.provenance import parquet_stream, provenance_record, read_metadata, start_clock
from slipstitch.config import Config
from slipstitch.design.grid import films
from slipstitch.images.augmentation import Augmentation, draw_augmentation, pixel_noise
from slipstitch.images.bench_camera import BenchCamera, bench_pixels, relative_pose
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import encode_png
from slipstitch.images.marked_points import marked_points_m
from slipstitch.images.mean_cloth import lags_m
from slipstitch.images.packing import Job, Pack, read_pack, shade_job
from slipstitch.images.pose import POSE
from slipstitch.images.rectification import resample
from slipstitch.images.shots import Shot, cloth_size, viewpoint_pose
from slipstitch.images.textures import texture_file, worn_texture
from slipstitch.physics.simulation.trajectory import Trajectory

SCHEMA = pa.schema(
    [
        ("simulation", pa.string()),
        ("texture", pa.string()),
        ("viewpoint", pa.string()),
        ("frame", pa.int32()),
        ("time_s", pa.float64()),
        ("stage_x_m", pa.float64()),
        ("image", pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
    ]
)

_GROUP = 64


@dataclass(frozen=True)
class FilmJob(Job):
    """A job with the textures that the cloth wears, which its shading does not depend on.

    Attributes
    ----------
    textures : mapping
        Id -> name.
    """

    textures: Mapping[str, str]

    @classmethod
    def of_view(
        cls, config: Config, trajectory_path: str | os.PathLike, viewpoint_id: str, viewpoint: str
    ) -> Self:
        """The job of a configuration, with id and name of a viewpoint.

        A simulation or viewpoint that the configuration does not have is filmed in all textures.
        """
        job = Job.of_view(config, trajectory_path, viewpoint_id, viewpoint)
        worn = films(config).get((job.simulation, viewpoint_id)) or config.render.texture_ids()
        return cls(**vars(job), textures=worn)

    def worn(self, name: str) -> str:
        """What the cloth wears for a texture of this name, as `textures.texture` takes it."""
        return worn_texture(name, self.seed, self.simulation, self.viewpoint)


def cameras(job: FilmJob) -> dict[str, Augmentation]:
    """Every texture's name -> the camera of its video."""
    augmentation = job.settings.augmentation
    return {
        name: draw_augmentation(augmentation, job.seed, job.simulation, name, job.viewpoint)
        for name in job.textures.values()
    }


@dataclass(frozen=True)
class Rectifier:
    """Brings a video's images into the calibrated viewpoint; leaves those that need it not.

    Attributes
    ----------
    job : Job
    trajectory : Trajectory
    bench : BenchCamera, optional
        None: the images are what they shall be.
    viewpoint : tuple of ndarray
        Rotation and translation of the calibrated viewpoint.
    size_m : tuple of float
        Of the cloth.
    lags_m : ndarray (T,)
        Of the mean cloth's lower edge.
    """

    job: Job
    trajectory: Trajectory
    bench: BenchCamera | None
    viewpoint: tuple[np.ndarray, np.ndarray]
    size_m: tuple[float, float]
    lags_m: np.ndarray

    @classmethod
    def of(cls, job: Job, trajectory: Trajectory) -> "Rectifier":
        """The rectifier of a job."""
        viewpoint = viewpoint_pose(job.viewpoint, job.settings)
        size_m = cloth_size(trajectory)
        lags = lags_m(trajectory.stage_x_m, trajectory.stage_z_m, size_m[1])
        return cls(job, trajectory, job.bench_camera, viewpoint, size_m, lags)

    def at(self, shot: Shot) -> Callable[[np.ndarray], np.ndarray]:
        """Of a shot's images: what makes each of them (pixels, pixels, 3) uint8."""
        if self.bench is None:
            return lambda image: image
        place = bench_pixels(
            shot.camera,
            self.bench,
            self.viewpoint,
            self.trajectory,
            self.lags_m,
            shot.row,
            self.job.settings,
            self.size_m,
        )
        return lambda image: resample(image, place, self.job.settings.pixels)[0]

    def pose(self, shots: list[Shot]) -> dict[str, float]:
        """Pose of the camera relative to the calibrated viewpoint, according to its calibration."""
        if self.bench is None:
            return dict.fromkeys(POSE, 0.0)
        stated = self.bench.stated(shots[0].camera)
        return relative_pose(stated.rotation, stated.translation_m, self.viewpoint)


def composed_images(
    job: FilmJob, pack: Pack, trajectory: Trajectory
) -> Iterator[tuple[Shot, str, np.ndarray]]:
    """Every frame in every texture: shot, texture id, image (pixels, pixels, 3) uint8."""
    of = cameras(job)
    rectify = Rectifier.of(job, trajectory)
    for shot, shading, sight in pack.frames(trajectory):
        composed = compose_light(join(shading, sight), list(map(job.worn, job.textures.values())))
        rectified = rectify.at(shot)
        for (identity, name), light in zip(job.textures.items(), composed, strict=True):
            noise = pixel_noise(job.seed, job.simulation, name, job.viewpoint, shot.frame)
            yield shot, identity, rectified(of[name].photograph(light, noise))


def render_shard(
    job: FilmJob,
    out: str | os.PathLike,
    *,
    pack_path: str | os.PathLike | None = None,
    progress=iter,
) -> dict:
    """Make the image shard of one simulation from one viewpoint, with every texture.

    Parameters
    ----------
    job : FilmJob
    out : path
        Parquet file, one row per image; written whole or not at all.
    pack_path : path, optional
        Take the light from this file, instead of rendering it in Blender; the pixels are the same.
    progress : callable
        Wraps the list of frames, to show how far rendering is.

    Returns
    -------
    dict
        Number of frames, images, and the smallest share of the cloth's vertices in an image.

    Raises
    ------
    BadInput
        If the trajectory, the pack or a texture cannot be used.
    """
    started = start_clock()
    cv2.setNumThreads(job.settings.threads)
    trajectory = job.trajectory()
    files = [file for name in job.textures.values() if (file := texture_file(name))]
    if pack_path is None:
        pack = shade_job(job, trajectory, progress)
    else:
        pack = read_pack(pack_path, job, trajectory)
    # PNG does not compress any further.
    how = {name: "zstd" for name in SCHEMA.names if name != "image"}
    images = 0
    with parquet_stream(out, SCHEMA, compression=how) as stream:
        group: list[dict] = []
        for shot, identity, image in composed_images(job, pack, trajectory):
            group.append(_row(job, trajectory, shot, identity, image))
            images += 1
            # A group holds some tens of images, whole frames of them.
            if len(group) >= _GROUP and identity == list(job.textures)[-1]:
                stream.write(group)
                group = []
        if group:
            stream.write(group)
        files += [] if pack_path is None else [Path(pack_path)]
        stream.describe(*_description(job, pack, trajectory, files, started))
    return {
        "frames": len(pack.shots),
        "images": images,
        "smallest_share_of_cloth_in_image": pack.metadata["smallest_share_of_cloth_in_image"],
    }


def render_shards_from_packs(
    config: Config, trajectory_path: str | os.PathLike, pack_paths: Iterable[Path], folder: Path
) -> Iterator[tuple[Path, dict]]:
    """Make the image shards of one simulation without Blender, from the light of its viewpoints.

    Returns
    -------
    iterator of (path, dict)
        Each shard, named as its pack, when it is written; what `render_shard` returns, and
        ``viewpoint``, by name.
    """
    for pack_path in pack_paths:
        try:
            view = read_metadata(pack_path).get("viewpoint", {})
        except (OSError, ValueError):
            view = {}  # read_pack says what is wrong with it
        job = FilmJob.of_view(config, trajectory_path, view.get("id", ""), view.get("name", ""))
        out = folder / pack_path.name
        done = render_shard(job, out, pack_path=pack_path)
        yield out, done | {"viewpoint": job.viewpoint}


def marked_points_record(trajectory: Trajectory, wanted: list[Shot]) -> dict[str, list[float]]:
    """Frame -> places of the cloth's marked points, 27 numbers to 0.01 mm."""
    points_m = marked_points_m(trajectory.positions_m, trajectory.uv, trajectory.stage_x_m)
    return {str(shot.frame): points_m[shot.row].ravel().round(5).tolist() for shot in wanted}


def _row(job: Job, trajectory: Trajectory, shot: Shot, texture: str, image: np.ndarray) -> dict:
    video = f"{job.simulation}_{texture}_{job.viewpoint_id}"
    return {
        "simulation": job.simulation,
        "texture": texture,
        "viewpoint": job.viewpoint_id,
        "frame": shot.frame,
        "time_s": float(trajectory.time_s[shot.row]),
        "stage_x_m": float(trajectory.stage_x_m[shot.row]),
        "image": {"bytes": encode_png(image), "path": f"{video}_{shot.frame:06d}.png"},
    }


def _description(
    job: FilmJob, pack: Pack, trajectory: Trajectory, files: list, started: tuple[float, float]
) -> tuple[dict, dict]:
    """Metadata and provenance of the shard."""
    of = cameras(job)
    augmentation = {identity: of[name].record() for identity, name in job.textures.items()}
    metadata = pack.metadata | {
        "viewpoint": {"id": job.viewpoint_id, "name": job.viewpoint},
        "textures": dict(job.textures),
        "augmentation": augmentation,
        "pose": Rectifier.of(job, trajectory).pose(pack.shots),
        "marked_points_m": marked_points_record(trajectory, pack.shots),
    }
    record = provenance_record(
        "render",
        inputs=[*job.inputs(), *files],
        config={
            "render": job.settings.model_dump(
                mode="json", exclude={"verified_images", job.other_floors}
            ),
            "sample": {"frames": job.frames_sampled},
            "viewpoint": job.viewpoint,
            "catalogue": job.catalogue_entries(job.textures.values()),
        },
        seed=job.seed,
        started=started,
    )
    return metadata, record
