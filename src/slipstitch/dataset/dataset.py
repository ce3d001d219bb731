"""Writing the dataset: the frames of every simulation's videos and the manifest of all videos."""

import os
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.progress import progress
from slipstitch.base.provenance import provenance_record, read_metadata, start_clock
from slipstitch.config import Config
from slipstitch.dataset import videos as video_files
from slipstitch.dataset.manifest import video_labels, write_manifest
from slipstitch.dataset.probes import PIXELS, check_nothing_told
from slipstitch.design.grid import sampled_frames, simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.images.camera import POSE
from slipstitch.images.surroundings import MATTE


def write_dataset(
    config: Config, shards: Iterable[str | os.PathLike], out_dir: str | os.PathLike
) -> list[dict[str, Any]]:
    """Write ``{simulation}.parquet`` and ``manifest.parquet`` from image shards; return the rows.

    BadInput if a shard or image is damaged, a video or frame of the grid is missing, there twice or
    not of the grid, no valid split exists, or something without contact tells the coefficient
    (`probes`).
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
        of_one = (labels[name], paths_of[name])
        written, images, in_bytes = _write_simulation(config, *of_one, Path(out_dir))
        rows += written
        first += [video_files.resized(image[None], PIXELS)[0] for image in images]
        sizes += in_bytes
    check_nothing_told(str(out_dir), rows, np.stack(first), np.array(sizes))
    inputs = [Path(out_dir) / f"{name}.parquet" for name in labels]
    write_manifest(rows, out_dir, _record(config, inputs, started))
    return rows


def _record(config: Config, inputs: Iterable, started: tuple[float, float]) -> dict[str, Any]:
    used = config.model_dump(mode="json", include={"seed", "grid", "render", "sample"})
    return provenance_record(
        "sample", inputs=inputs, config=used, seed=config.seed, started=started
    )


def _shards_of(grid: Mapping[str, Any], shards: Iterable[str]) -> dict[str, list[str]]:
    """Simulation -> its shards; BadInput if it has none, or a shard is of no simulation."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in shards:
        for name in video_files.simulations_of(path):
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
) -> tuple[dict[str, list], dict[str, dict[str, Any]], dict[str, list]]:
    """The sampled frames of a simulation's videos; look and keypoints of each viewpoint."""
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    between = interpolations(config)
    videos: dict[str, list] = {}
    looks: dict[str, dict[str, Any]] = {}
    points: dict[str, list] = {}
    for path in paths:
        metadata = read_metadata(path)
        floor = metadata.get("surroundings") or asdict(MATTE)
        pose = metadata.get("pose") or dict.fromkeys(POSE, 0.0)
        for (name, texture, view), images in video_files.read_shard(path, frames).items():
            if name != simulation:
                continue
            video = f"{name}_{texture}_{view}"
            if video not in labels:
                raise BadInput(f"{path}: video {video!r} is not in the configured grid")
            if video in videos:
                raise BadInput(f"{path}: video {video} is in more than one shard")
            shown = between.get((name, view))
            if metadata.get("interpolation") != (shown and asdict(shown)):
                what = "interpolated otherwise than configured (render.interpolation)"
                raise BadInput(f"{path}: {what}")
            videos[video] = images
            looks[view] = {f"pose_{name}": pose[name] for name in POSE}
            looks[view] |= {f"floor_{name}": floor[name] for name in ("reflectance", "roughness")}
            looks[view]["floor"] = floor["floor"]
            if marked := metadata.get("marked_points_m"):
                points[view] = [marked[str(image["frame"])] for image in images]
    return videos, looks, points


def _write_simulation(
    config: Config, labels: Mapping[str, dict[str, Any]], paths: list[str], out_dir: Path
) -> tuple[list[dict[str, Any]], list[np.ndarray], list[int]]:
    """Write one simulation's frames; return rows, their first frames and these files' sizes."""
    started = start_clock()
    simulation = next(iter(labels.values()))["simulation"]
    videos, looks, points = _read_simulation(config, simulation, labels, paths)
    rows, images, first, sizes = [], [], [], []
    for video, of_video in labels.items():
        if video not in videos:
            raise BadInput(f"no images of video {video} in {', '.join(paths)}")
        named = {name: of_video[name] for name in ("video", "simulation", "material", "friction")}
        named |= {"texture": of_video["texture_id"], "viewpoint": of_video["viewpoint_id"]}
        pixels = []
        for position, image in enumerate(videos[video]):
            data, frame = image["image"]["bytes"], image["frame"]
            pixels.append(video_files.decode(data, f"{video} frame {frame}", config.render.pixels))
            at = {name: image[name] for name in ("frame", "time_s", "stage_x_m")}
            png = {"bytes": data, "path": f"{video}_{frame:04d}.png"}
            images.append(named | at | {"position": position, "image": png})
        first.append(pixels[0])
        sizes.append(len(videos[video][0]["image"]["bytes"]))
        digest = {"pixels_sha256": video_files.pixels_digest(np.stack(pixels))}
        rows.append(of_video | looks[of_video["viewpoint_id"]] | digest)
    path = out_dir / f"{simulation}.parquet"
    record = _record(config, paths, started)
    video_files.write_frames(images, path, record, {"marked_points_m": points})
    return rows, first, sizes
