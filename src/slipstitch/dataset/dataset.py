"""Writing the dataset: the frames of every simulation's videos and the manifest of all videos."""

import os
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.progress import progress
from slipstitch.base.provenance import provenance_record, read_metadata, start_clock
from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.dataset.images import pixels_digest, write_frames
from slipstitch.dataset.manifest import write_manifest
from slipstitch.dataset.probes import PIXELS, check_nothing_told
from slipstitch.dataset.shards import decode, read_shard, simulations_of
from slipstitch.dataset.videos import resized
from slipstitch.design.grid import Simulation, films, simulations, textures, viewpoints
from slipstitch.design.interpolation import filmed_friction, interpolations
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.design.splits import (
    check_no_simulation_on_both_sides,
    sides_of_simulations,
    split_by_video,
)
from slipstitch.images.camera import POSE
from slipstitch.images.surroundings import MATTE


def manifest_sides(config: Config) -> dict[str, tuple[str, str]]:
    """Every video of the grid -> its side in split_by_video and in split_by_simulation.

    Videos in a test-only texture or from a test-only viewpoint are test videos by video; by
    simulation they go with their simulation (and never train, whatever their side). Simulations of
    a test-only fabric or friction coefficient are test simulations in both. A video on a floor of
    the second training set has the side of the same video on its own floor.
    """
    grid = simulations(config)
    trained = [
        simulation
        for simulation in grid
        if "test" not in (simulation.material_role, simulation.friction_role)
    ]
    fractions = (config.sample.validation_fraction, config.sample.test_fraction)
    of_simulation = sides_of_simulations(config)
    views = viewpoints(config)
    main = {view["name"]: view["id"] for view in reversed(views)}  # each name's first id
    trainable = [
        f"{simulation.id}_{texture['id']}_{main[view]}"
        for simulation in trained
        for texture in textures(config)
        for view in config.render.viewpoints
        if texture["role"] == "train"
    ]
    of_video = split_by_video(trainable, *fractions, seed=config.seed)
    names = {view["id"]: view["name"] for view in views}
    sides = {}
    for (name, view), worn in films(config).items():
        for texture in worn:
            twin = f"{name}_{texture}_{main[names[view]]}"
            sides[f"{name}_{texture}_{view}"] = (of_video.get(twin, "test"), of_simulation[name])
    return sides


def write_dataset(
    config: Config, shards: Iterable[str | os.PathLike], out_dir: str | os.PathLike
) -> list[dict[str, Any]]:
    """Write ``{simulation}.parquet`` and ``manifest.parquet`` from image shards.

    Parameters
    ----------
    config : Config
        Grid, textures, viewpoints, pixels, frames and splits.
    shards : iterable of paths
        All image shards of the grid.
    out_dir : path

    Returns
    -------
    list of dict
        The manifest's rows.

    Raises
    ------
    BadInput
        If a shard is damaged, a video or frame of the grid is missing, there twice or not of the
        grid, an image cannot be decoded or has the wrong size, no valid split exists, or something
        without contact tells the friction coefficient (`slipstitch.dataset.probes`).
    """
    started = start_clock()
    frames = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    sides = manifest_sides(config)
    grid = {simulation.id: simulation for simulation in simulations(config)}
    paths_of: dict[str, list[str]] = defaultdict(list)
    for path in map(str, shards):
        for name in simulations_of(path):
            if name not in grid:
                raise BadInput(f"{path}: simulation {name!r} is not in the configured grid")
            paths_of[name].append(path)
    missing = [name for name in grid if name not in paths_of]
    if missing:
        raise BadInput(
            f"no image shard of simulation {missing[0]} "
            f"({len(missing)} of the grid's {len(grid)} simulations missing)"
        )

    rows: list[dict[str, Any]] = []
    first: list[np.ndarray] = []
    sizes: list[int] = []
    for simulation in progress(grid.values(), "sample: ", unit="simulation"):
        written, images, in_bytes = _write_simulation(
            config, simulation, paths_of[simulation.id], frames, sides, Path(out_dir)
        )
        rows += written
        first += [resized(image[None], PIXELS)[0] for image in images]
        sizes += in_bytes
    check_nothing_told(str(out_dir), rows, np.stack(first), np.array(sizes))
    check_no_simulation_on_both_sides(
        [row["simulation"] for row in rows], [row["split_by_simulation"] for row in rows]
    )
    record = provenance_record(
        "sample",
        inputs=[Path(out_dir) / f"{name}.parquet" for name in grid],
        config=config.model_dump(mode="json", include={"seed", "grid", "render", "sample"}),
        seed=config.seed,
        started=started,
    )
    write_manifest(rows, out_dir, record)
    return rows


def _write_simulation(
    config: Config,
    simulation: Simulation,
    paths: list[str],
    frames: np.ndarray,
    sides: dict[str, tuple[str, str]],
    out_dir: Path,
) -> tuple[list[dict[str, Any]], list[np.ndarray], list[int]]:
    """Write one simulation's frames.

    Returns
    -------
    list of dict, list of ndarray, list of int
        Its rows, sorted by video, their first frames and the sizes of these frames' files (bytes).
    """
    started = start_clock()
    between = interpolations(config)
    videos: dict[tuple[str, str], list] = {}
    frictions: dict[str, float] = {}
    floors: dict[str, dict[str, Any]] = {}
    poses: dict[str, dict[str, float]] = {}
    points: dict[str, list] = {}
    for path in paths:
        metadata = read_metadata(path)
        floor = metadata.get("surroundings") or MATTE.record()
        for (name, texture, view), images in read_shard(path, frames).items():
            if name != simulation.id:
                continue
            video = f"{simulation.id}_{texture}_{view}"
            if video not in sides:
                raise BadInput(f"{path}: video {video!r} is not in the configured grid")
            if (texture, view) in videos:
                raise BadInput(f"{path}: video {video} is in more than one shard")
            videos[texture, view] = images
            poses[view] = metadata.get("pose") or dict.fromkeys(POSE, 0.0)
            floors[view] = floor
            if marked := metadata.get("marked_points_m"):
                points[view] = [marked[str(image.frame)] for image in images]
            shown = between.get((simulation.id, view))
            if metadata.get("interpolation") != (shown and asdict(shown)):
                raise BadInput(
                    f"{path}: interpolated otherwise than configured (render.interpolation)"
                )
            frictions[view] = filmed_friction(simulation, shown)
    catalogue = {item["id"]: item for item in textures(config) + viewpoints(config)}
    rows, images, first, sizes = [], [], [], []
    file = f"{simulation.id}.parquet"
    for video in sorted(name for name in sides if name.startswith(f"{simulation.id}_")):
        texture, view = video.split("_")[3:]
        if (texture, view) not in videos:
            raise BadInput(f"no images of video {video} in {', '.join(paths)}")
        pixels = []
        for position, image in enumerate(videos[texture, view]):
            where = f"{video} frame {image.frame}"
            pixels.append(decode(image.png, where, config.render.pixels))
            images.append(
                {
                    "video": video,
                    "simulation": simulation.id,
                    "texture": texture,
                    "viewpoint": view,
                    "material": simulation.material,
                    "friction": frictions[view],
                    "position": position,
                    "frame": image.frame,
                    "time_s": image.time_s,
                    "stage_x_m": image.stage_x_m,
                    "image": {"bytes": image.png, "path": f"{video}_{image.frame:04d}.png"},
                }
            )
        first.append(pixels[0])
        sizes.append(len(videos[texture, view][0].png))
        view_name = catalogue[view]["name"]
        turn = VIEWPOINTS[view_name].azimuth_deg - VIEWPOINTS["calibrated"].azimuth_deg
        by_video, by_simulation = sides[video]
        rows.append(
            {
                "video": video,
                "simulation": simulation.id,
                "material_id": simulation.material_id,
                "friction_id": simulation.friction_id,
                "replicate_id": simulation.replicate_id,
                "texture_id": texture,
                "viewpoint_id": view,
                "material": simulation.material,
                "friction": frictions[view],
                "interpolated": (simulation.id, view) in between,
                "texture": catalogue[texture]["name"],
                "viewpoint": view_name,
                "material_role": simulation.material_role,
                "friction_role": simulation.friction_role,
                "texture_role": catalogue[texture]["role"],
                "viewpoint_role": catalogue[view]["role"],
                "floor_role": catalogue[view]["floor_role"],
                "viewpoint_turn_deg": turn,
                **{f"pose_{name}": poses[view][name] for name in POSE},
                "floor": floors[view]["floor"],
                "floor_reflectance": floors[view]["reflectance"],
                "floor_roughness": floors[view]["roughness"],
                "split_by_video": by_video,
                "split_by_simulation": by_simulation,
                "frames": len(frames),
                "pixels": config.render.pixels,
                "pixels_sha256": pixels_digest(np.stack(pixels)),
                "file": file,
            }
        )
    record = provenance_record(
        "sample",
        inputs=paths,
        config=config.model_dump(mode="json", include={"seed", "grid", "render", "sample"}),
        seed=config.seed,
        started=started,
    )
    write_frames(images, out_dir / file, record, {"marked_points_m": points})
    return rows, first, sizes
