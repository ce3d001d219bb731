"""Labels of every video of the grid: what configuration and seed decide before rendering."""

from dataclasses import asdict
from typing import Any

from slipstitch.config import Config
from slipstitch.config.catalogue import VIEWPOINTS
from slipstitch.design.grid import films, simulations, textures, viewpoints
from slipstitch.design.interpolation import filmed_friction, interpolations
from slipstitch.design.splits import sides_of_simulations, split_by_video


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


def video_labels(config: Config) -> dict[str, dict[str, Any]]:
    """Every video of the grid -> the manifest's columns that configuration and seed decide.

    Left out are the pose of the camera, the floor and the digest of the pixels, which rendering
    decides. Videos are sorted by their id.
    """
    calibrated = VIEWPOINTS["calibrated"].azimuth_deg
    catalogue = {item["id"]: item for item in textures(config) + viewpoints(config)}
    grid = {simulation.id: simulation for simulation in simulations(config)}
    between = interpolations(config)
    labels = {}
    for video, (by_video, by_simulation) in sorted(manifest_sides(config).items()):
        name, texture, view = video.rsplit("_", 2)
        simulation, shown = grid[name], between.get((name, view))
        of_grid = {key: value for key, value in asdict(simulation).items() if key != "seed"}
        del of_grid["id"]
        labels[video] = {
            "video": video,
            "simulation": name,
            **of_grid,
            "friction": filmed_friction(simulation, shown),
            "interpolated": shown is not None,
            "texture_id": texture,
            "texture": catalogue[texture]["name"],
            "texture_role": catalogue[texture]["role"],
            "viewpoint_id": view,
            "viewpoint": catalogue[view]["name"],
            "viewpoint_role": catalogue[view]["role"],
            "viewpoint_turn_deg": VIEWPOINTS[catalogue[view]["name"]].azimuth_deg - calibrated,
            "floor_role": catalogue[view]["floor_role"],
            "split_by_video": by_video,
            "split_by_simulation": by_simulation,
            "frames": config.sample.frames_kept,
            "pixels": config.render.pixels,
            "file": f"{name}.parquet",
        }
    return labels
