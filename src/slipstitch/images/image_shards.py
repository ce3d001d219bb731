"""From the light of a simulation from one viewpoint to its image shard: textures and cameras."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa

from slipstitch.base.provenance import parquet_stream, provenance_record, read_metadata, start_clock
from slipstitch.config import Config
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import encode_png
from slipstitch.images.keypoints import keypoints_m
from slipstitch.images.packing import Pack, read_pack, shade
from slipstitch.images.textures import texture_file
from slipstitch.images.view import Shot, View
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


def composed_images(
    view: View, pack: Pack, trajectory: Trajectory
) -> Iterator[tuple[Shot, str, np.ndarray]]:
    """Every frame in every texture: shot, texture id, image (pixels, pixels, 3) uint8."""
    effects, rectifier = view.camera_effects(), view.rectifier(trajectory)
    worn = [view.worn(name) for name in view.textures.values()]
    for shot, shading, sight in pack.frames(trajectory):
        composed = compose_light(join(shading, sight), worn)
        rectified = rectifier.at(shot.camera, shot.time_s)
        for (identity, name), light in zip(view.textures.items(), composed, strict=True):
            noise = view.noise(name, shot.frame)
            yield shot, identity, rectified(effects[identity].photograph(light, noise))


def render_shard(
    view: View, out: str | os.PathLike, *, pack_path: str | os.PathLike | None = None, progress=iter
) -> dict:
    """Make the image shard of one simulation from one viewpoint, with every texture.

    Parameters
    ----------
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
    cv2.setNumThreads(1)
    trajectory = view.trajectory()
    files = [file for name in view.textures.values() if (file := texture_file(name))]
    if pack_path is None:
        pack = shade(view, trajectory, progress)
    else:
        pack = read_pack(pack_path, view, trajectory)
    # PNG does not compress any further.
    how = {name: "zstd" for name in SCHEMA.names if name != "image"}
    images = 0
    with parquet_stream(out, SCHEMA, compression=how) as stream:
        group: list[dict] = []
        for shot, identity, image in composed_images(view, pack, trajectory):
            group.append(_row(view, trajectory, shot, identity, image))
            images += 1
            # A group holds some tens of images, whole frames of them.
            if len(group) >= _GROUP and identity == list(view.textures)[-1]:
                stream.write(group)
                group = []
        if group:
            stream.write(group)
        files += [] if pack_path is None else [Path(pack_path)]
        stream.describe(*_description(view, pack, trajectory, files, started))
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
            named = read_metadata(pack_path).get("viewpoint", {})
        except (OSError, ValueError):
            named = {}  # read_pack says what is wrong with it
        view = View.identified(config, trajectory_path, named.get("id", ""), named.get("name", ""))
        out = folder / pack_path.name
        done = render_shard(view, out, pack_path=pack_path)
        yield out, done | {"viewpoint": view.viewpoint}


def keypoints_record(trajectory: Trajectory, wanted: list[Shot]) -> dict[str, list[float]]:
    """Frame -> places of the cloth's keypoints, 27 numbers to 0.01 mm."""
    points_m = keypoints_m(trajectory.positions_m, trajectory.uv, trajectory.stage_x_m)
    return {str(shot.frame): points_m[shot.row].ravel().round(5).tolist() for shot in wanted}


def _row(view: View, trajectory: Trajectory, shot: Shot, texture: str, image: np.ndarray) -> dict:
    video = f"{view.simulation}_{texture}_{view.viewpoint_id}"
    return {
        "simulation": view.simulation,
        "texture": texture,
        "viewpoint": view.viewpoint_id,
        "frame": shot.frame,
        "time_s": float(trajectory.time_s[shot.row]),
        "stage_x_m": float(trajectory.stage_x_m[shot.row]),
        "image": {"bytes": encode_png(image), "path": f"{video}_{shot.frame:06d}.png"},
    }


def _description(
    view: View, pack: Pack, trajectory: Trajectory, files: list, started: tuple[float, float]
) -> tuple[dict, dict]:
    """Metadata and provenance of the shard."""
    effects = view.camera_effects()
    metadata = pack.metadata | {
        "viewpoint": {"id": view.viewpoint_id, "name": view.viewpoint},
        "textures": dict(view.textures),
        "augmentation": {identity: asdict(one) for identity, one in effects.items()},
        "pose": view.rectifier(trajectory).pose(pack.shots[0].camera),
        "marked_points_m": keypoints_record(trajectory, pack.shots),
    }
    record = provenance_record(
        "render",
        inputs=[*view.inputs(), *files],
        config={
            "render": view.settings.model_dump(
                mode="json", exclude={"verified_images", view.other_floors}
            ),
            "sample": {"frames": view.frames_sampled},
            "viewpoint": view.viewpoint,
            "catalogue": view.catalogue_entries(view.textures.values()),
        },
        seed=view.seed,
        started=started,
    )
    return metadata, record
