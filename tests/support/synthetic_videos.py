"""Made-up image shards for tests of the learning stages: drawn rectangles, no cloth, no physics.

A patterned rectangle goes to and fro. Its lower part lags behind by a length that grows with the
friction coefficient; its height depends on the material; replicates jitter both. So there is
something to learn, and a network that learns nothing cannot pass.
"""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.provenance import attach_metadata
from slipstitch.config import Config, resolve_config
from slipstitch.dataset import dataset
from slipstitch.dataset.manifest import dataset_digest
from slipstitch.design.grid import films, simulations, textures, viewpoints
from slipstitch.images.camera import KEYPOINTS_UV
from slipstitch.images.encoding import encode_png
from slipstitch.images.image_shards import SCHEMA


def config(**sections) -> Config:
    """A grid of 2 materials, 2 frictions, 2 replicates, 2 textures, 2 views; 6 frames at 16 px."""
    grid = {"materials": ["gray-interlock", "ivory-rib-knit"], "frictions": [0.1, 0.6]}
    looks = {"viewpoints": ["calibrated", "side"], "textures": ["stripes", "tartan"]}
    network = {"channels": [64, 128], "convolutions": [1, 1], "precision": "float32"}
    budget = {"epochs_per_cycle": 20, "fine_tuning_epochs": 2, "batch_size": 2}
    small = {
        "grid": grid | {"replicates": 2},
        "simulation": {"frames": 60},
        "render": looks | {"pixels": 16},
        "sample": {"frames": 6},
        "train": network | budget,
    }
    return resolve_config(small, sections)


def draw(
    pixels: int, lean: float, lag: float, height: float, texture: int, view: int
) -> np.ndarray:
    """One frame, uint8 of shape (pixels, pixels, 3)."""
    y, x = np.mgrid[0:pixels, 0:pixels] / (pixels - 1)
    shift = lag * lean * np.clip((y - 0.4) / 0.6, 0, 1)
    across = (x - 0.5 - shift) * (1.0 + 0.5 * view)
    inside = (np.abs(across) < 0.2) & (y > 0.15) & (y < 0.15 + height)
    pattern = 0.6 + 0.3 * np.sin((8 + 7 * texture) * (across if texture % 2 else y))
    colours = np.array([[220, 120, 90], [90, 200, 120], [110, 130, 230]][texture % 3])
    image = np.full((pixels, pixels, 3), 20.0)
    image[inside] = (pattern[..., None] * colours)[inside]
    return image.astype(np.uint8)


def keypoints_m(lean: float, lag: float, height: float) -> np.ndarray:
    """Places (9, 3) of points of the rectangle that `draw` draws, its side 0.2 m."""
    across, below = KEYPOINTS_UV[:, 0] - 0.5, 0.15 + height * KEYPOINTS_UV[:, 1]
    shift = lag * lean * np.clip((below - 0.4) / 0.6, 0, 1)
    return np.stack([0.5 * shift, 0.2 * across, 0.5 * (1 - below)], axis=1)


def write_shards(config: Config, folder: Path, marked: bool = False) -> list[Path]:
    """One shard a (simulation, viewpoint), as the render stage lays them out.

    With the places of marked points or, as before there were any, without.
    """
    total = config.simulation.frames
    numbers = range(0, total, total // config.sample.frames_kept)
    strongest = max(config.grid.frictions)
    fabrics = config.grid.materials + config.grid.test_materials
    paths = []
    for one in simulations(config):
        jitter = np.random.default_rng(one.seed).normal(0, 0.02, 2)
        lag = 0.3 * one.friction / strongest + jitter[0]
        height = 0.45 + 0.12 * fabrics.index(one.material) + jitter[1]
        for v, view in enumerate(viewpoints(config)):
            rows, points = [], {}
            worn = films(config).get((one.id, view["id"]), {})
            for t, texture in enumerate(textures(config)):
                if texture["id"] not in worn:
                    continue
                for frame in numbers:
                    phase = frame / total * 4 * np.pi
                    points[str(frame)] = keypoints_m(np.sin(phase), lag, height).ravel()
                    image = draw(config.render.pixels, np.sin(phase), lag, height, t, v)
                    row = {"simulation": one.id, "texture": texture["id"], "viewpoint": view["id"]}
                    row |= {"frame": frame, "time_s": frame / 2.4}
                    row |= {"stage_x_m": 0.15 * (1 + np.sin(phase))}
                    row["image"] = {"bytes": encode_png(image), "path": f"{frame}.png"}
                    rows.append(row)
            if not worn:
                continue
            path = Path(folder) / f"{one.id}_{view['id']}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            table = pa.Table.from_pylist(rows, schema=SCHEMA)
            if marked:
                places = {frame: place.tolist() for frame, place in points.items()}
                table = attach_metadata(table, {"marked_points_m": places})
            pq.write_table(table, path)
            paths.append(path)
    return paths


def write_dataset(config: Config, folder: Path, marked: bool = False) -> Path:
    """Write the shards and the dataset of them, ``folder/sample``."""
    shards = write_shards(config, folder / "render", marked)
    dataset.write_dataset(config, shards, folder / "sample")
    return folder / "sample"


def images_of(shard: Path) -> dict[tuple[str, int], np.ndarray]:
    """Images of a shard by texture and frame, blue first."""
    images = {}
    for row in pq.read_table(shard).to_pylist():
        encoded = np.frombuffer(row["image"]["bytes"], np.uint8)
        images[row["texture"], row["frame"]] = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    return images


def altered_copy(sample: Path, folder: Path, change, renew_digest: bool = True) -> Path:
    """Copy a dataset; its manifest rows go through `change`."""
    shutil.copytree(sample, folder)
    table = pq.read_table(folder / "manifest.parquet")
    rows = table.to_pylist()
    change(rows)
    changed = pa.Table.from_pylist(rows, schema=table.schema)
    if renew_digest:
        changed = attach_metadata(changed, {"dataset_digest": dataset_digest(rows)})
    pq.write_table(changed, folder / "manifest.parquet")
    return folder
