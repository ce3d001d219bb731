"""Writing the dataset: the frames of every simulation's videos and the manifest of all videos."""

import os
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.progress import progress
from slipstitch.base.provenance import provenance_record, read_metadata, start_clock
from slipstitch.config import Config
from slipstitch.dataset.images import (
    decode,
    pixels_digest,
    read_shard,
    simulations_of,
    write_frames,
)
from slipstitch.dataset.manifest import video_labels, write_manifest
from slipstitch.dataset.probes import PIXELS, check_nothing_told
from slipstitch.dataset.videos import resized
from slipstitch.design.grid import simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.splits import check_no_simulation_on_both_sides
from slipstitch.images.camera import POSE
from slipstitch.images.surroundings import MATTE


@dataclass
class _Filmed:
    """What the shards of a simulation hold, by video or by viewpoint."""

    videos: dict[str, list] = field(default_factory=dict)
    rendered: dict[str, dict[str, Any]] = field(default_factory=dict)
    points: dict[str, list] = field(default_factory=dict)


def write_dataset(
    config: Config, shards: Iterable[str | os.PathLike], out_dir: str | os.PathLike
) -> list[dict[str, Any]]:
    """Write ``{simulation}.parquet`` and ``manifest.parquet`` from image shards.

    BadInput if a shard is damaged, a video or frame of the grid is missing, there twice or not of
    the grid, an image cannot be decoded or has the wrong size, no valid split exists, or something
    without contact tells the friction coefficient (`slipstitch.dataset.probes`). Return the
    manifest's rows.
    """
    started = start_clock()
    labels: dict[str, dict[str, dict[str, Any]]] = {one.id: {} for one in simulations(config)}
    for video, of_video in video_labels(config).items():
        labels[of_video["simulation"]][video] = of_video
    paths_of = _shards_of(labels, map(str, shards))
    rows: list[dict[str, Any]] = []
    first: list[np.ndarray] = []
    sizes: list[int] = []
    for name in progress(labels, "sample: ", unit="simulation"):
        written, images, in_bytes = _write_simulation(
            config, labels[name], paths_of[name], Path(out_dir)
        )
        rows += written
        first += [resized(image[None], PIXELS)[0] for image in images]
        sizes += in_bytes
    check_nothing_told(str(out_dir), rows, np.stack(first), np.array(sizes))
    check_no_simulation_on_both_sides(
        [row["simulation"] for row in rows], [row["split_by_simulation"] for row in rows]
    )
    inputs = [Path(out_dir) / f"{name}.parquet" for name in labels]
    write_manifest(rows, out_dir, _record(config, inputs, started))
    return rows


def _record(config: Config, inputs: Iterable, started: tuple[float, float]) -> dict[str, Any]:
    return provenance_record(
        "sample",
        inputs=inputs,
        config=config.model_dump(mode="json", include={"seed", "grid", "render", "sample"}),
        seed=config.seed,
        started=started,
    )


def _shards_of(grid: Mapping[str, Any], shards: Iterable[str]) -> dict[str, list[str]]:
    """Simulation -> its shards; BadInput if it has none, or a shard is of no simulation."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in shards:
        for name in simulations_of(path):
            if name not in grid:
                raise BadInput(f"{path}: simulation {name!r} is not in the configured grid")
            found[name].append(path)
    missing = [name for name in grid if name not in found]
    if missing:
        raise BadInput(
            f"no image shard of simulation {missing[0]} "
            f"({len(missing)} of the grid's {len(grid)} simulations missing)"
        )
    return found


def _read_simulation(
    config: Config, simulation: str, labels: Mapping[str, Any], paths: list[str]
) -> _Filmed:
    """The sampled frames of a simulation, and what its shards say of each viewpoint."""
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    between = interpolations(config)
    found = _Filmed()
    for path in paths:
        metadata = read_metadata(path)
        floor = metadata.get("surroundings") or MATTE.record()
        pose = metadata.get("pose") or dict.fromkeys(POSE, 0.0)
        for (name, texture, view), images in read_shard(path, frames).items():
            if name != simulation:
                continue
            video = f"{name}_{texture}_{view}"
            if video not in labels:
                raise BadInput(f"{path}: video {video!r} is not in the configured grid")
            if video in found.videos:
                raise BadInput(f"{path}: video {video} is in more than one shard")
            shown = between.get((name, view))
            if metadata.get("interpolation") != (shown and asdict(shown)):
                raise BadInput(
                    f"{path}: interpolated otherwise than configured (render.interpolation)"
                )
            found.videos[video] = images
            found.rendered[view] = {
                **{f"pose_{name}": pose[name] for name in POSE},
                "floor": floor["floor"],
                "floor_reflectance": floor["reflectance"],
                "floor_roughness": floor["roughness"],
            }
            if marked := metadata.get("marked_points_m"):
                found.points[view] = [marked[str(image.frame)] for image in images]
    return found


def _write_simulation(
    config: Config, labels: Mapping[str, dict[str, Any]], paths: list[str], out_dir: Path
) -> tuple[list[dict[str, Any]], list[np.ndarray], list[int]]:
    """Write one simulation's frames.

    Return its rows, sorted by video, their first frames and the sizes of these frames' files
    (bytes).
    """
    started = start_clock()
    simulation = next(iter(labels.values()))["simulation"]
    filmed = _read_simulation(config, simulation, labels, paths)
    rows, images, first, sizes = [], [], [], []
    for video, of_video in labels.items():
        if video not in filmed.videos:
            raise BadInput(f"no images of video {video} in {', '.join(paths)}")
        pixels = []
        for position, image in enumerate(filmed.videos[video]):
            where = f"{video} frame {image.frame}"
            pixels.append(decode(image.png, where, config.render.pixels))
            images.append(
                {
                    **{name: of_video[name] for name in ("video", "simulation", "material")},
                    "texture": of_video["texture_id"],
                    "viewpoint": of_video["viewpoint_id"],
                    "friction": of_video["friction"],
                    "position": position,
                    "frame": image.frame,
                    "time_s": image.time_s,
                    "stage_x_m": image.stage_x_m,
                    "image": {"bytes": image.png, "path": f"{video}_{image.frame:04d}.png"},
                }
            )
        first.append(pixels[0])
        sizes.append(len(filmed.videos[video][0].png))
        digest = {"pixels_sha256": pixels_digest(np.stack(pixels))}
        rows.append(of_video | filmed.rendered[of_video["viewpoint_id"]] | digest)
    path = out_dir / f"{simulation}.parquet"
    record = _record(config, paths, started)
    write_frames(images, path, record, {"marked_points_m": filmed.points})
    return rows, first, sizes
