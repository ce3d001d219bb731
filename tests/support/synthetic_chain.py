"""A small results folder with complete records, quickly: invented motion, drawn images.

Nothing in it was simulated or rendered; the records are those that the stages write.
"""

import contextlib
import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.bench.stage_path import StagePath
from slipstitch.catalogue import catalogue_entries
from slipstitch.config import Config, write_config
from slipstitch.config.grid import simulations, viewpoints, write_grid
from slipstitch.provenance import provenance_record, write_parquet, write_sidecar
from slipstitch.render.augmentation import draw_augmentation
from slipstitch.render.surroundings import draw_surroundings
from slipstitch.render.verification import VIEWS
from slipstitch.sample.dataset import write_dataset
from slipstitch.simulate.drop_and_drag import DropAndDrag, draw_perturbation
from slipstitch.simulate.trajectory import Trajectory, write_trajectory
from support import synthetic_cloth, synthetic_results, synthetic_videos


def config(**sections) -> Config:
    """2 fabrics, 4 coefficients, 2 replicates, a test-only texture and viewpoint, 16 pixels."""
    render = {
        "pixels": 16,
        "viewpoints": ["calibrated", "side"],
        "test_viewpoints": ["calibrated_+10"],
        "textures": ["stripes", "tartan"],
        "test_textures": ["chevron"],
        "floors": ["matte", "ceramic", "stainless-steel"],
        "augmentation": {"lamp_m": 0.1, "exposure_stops": 0.5},
    }
    grid = {
        "materials": ["gray-interlock", "ivory-rib-knit"],
        "frictions": [0.1, 0.3, 0.6, 1.0],
        "replicates": 2,
    }
    return synthetic_results.config(
        **{
            "grid": grid,
            "simulation": {"frames": 60, "vertices_per_side": 11},
            "render": render,
            "sample": {"frames": 5},
            "release": {"shard_mb": 0.01},
            **sections,
        }
    )


def write(config: Config, folder: Path, chosen: dict | None = None) -> Path:
    """Write ``results/`` in `folder`, as the workflow does, up to the dataset; return it.

    `chosen`: settings of simulations that the calibration chose instead of the configured ones.
    """
    results = folder / "results"
    with contextlib.chdir(folder), contextlib.redirect_stderr(sys.stdout):
        here = Path("results")
        write_config(config, here / "config.json")
        write_grid(config, here / "grid.parquet")
        synthetic_results.write_calibrate(config, here, chosen)
        told = config.simulation.model_copy(update=chosen or {})
        _write_simulate(config.model_copy(update={"simulation": told}), here)
        shards = _write_render(config, here)
        _write_verification(config, here, shards[:2])
        write_dataset(config, shards, here / "sample")
    return results


def _write_simulate(config: Config, results: Path) -> None:
    for one in simulations(config):
        run = DropAndDrag(one.material, one.friction, one.seed)
        motion = synthetic_cloth.motion(config.simulation.frames, n=11)
        metadata = {
            "material": one.material,
            "friction": one.friction,
            "seed": one.seed,
            "simulation": one.id,
            "perturbation": vars(draw_perturbation(config.simulation, one.seed)),
            "solver": {"steps": 10, "newton_iterations": 30, "largest_residual": 9e-5},
            "stage_path": vars(StagePath()),
        }
        record = provenance_record(
            "simulate",
            inputs=[results / "calibrate/calibration.json"],
            config={"simulation": config.simulation, "catalogue": run.catalogue_entries()},
            seed=one.seed,
        )
        write_trajectory(
            results / f"simulate/{one.id}.parquet",
            Trajectory(**motion, metadata=metadata),
            record,
            residual=np.full(len(motion["frame"]), 9e-5),
        )


def _write_render(config: Config, results: Path) -> list[Path]:
    names = {view["id"]: view["name"] for view in viewpoints(config)}
    paths = synthetic_videos.write_shards(config, results / "render")
    for path in paths:
        simulation, view = path.stem.rsplit("_", 1)
        record = provenance_record(
            "render",
            inputs=[
                results / f"simulate/{simulation}.parquet",
                *filter(None, [config.render.camera_of(names[view])]),
            ],
            config={
                "render": config.render,
                "sample": {"frames": config.sample.frames},
                "viewpoint": names[view],
                "catalogue": catalogue_entries(
                    [names[view]], config.render.texture_ids().values(), config.render.floors
                ),
            },
        )
        notes = {
            "simulation": simulation,
            "viewpoint": {"id": view, "name": names[view]},
            "textures": config.render.texture_ids(),
            "surroundings": draw_surroundings(config.render, config.seed, simulation).record(),
            "augmentation": {
                texture: draw_augmentation(
                    config.render.augmentation, config.seed, simulation, name, names[view]
                ).record()
                for texture, name in config.render.texture_ids().items()
            },
        }
        table = pq.read_table(path)
        column = table.schema.get_field_index("stage_x_m")
        x_m, _ = StagePath().position_m(table["time_s"].to_numpy())
        table = table.set_column(column, "stage_x_m", pa.array(x_m))
        write_parquet(table, path, notes, record)
    return paths


def _write_verification(config: Config, results: Path, shards: list[Path]) -> None:
    comparisons = [
        {"video": f"{path.stem}_t00", "frame": 0, "floor": floor, "psnr_db": psnr_db, "ssim": 0.99,
         "least_psnr_db": least, "as_stored": True, "passed": True}
        for path, floor, psnr_db, least in zip(
            shards, ["matte", "ceramic"], [43.21, 39.87], [38.0, 36.0], strict=True
        )
    ]  # fmt: skip
    out = results / "render/verification.json"
    out.write_text(json.dumps({"images": 2, "comparisons": comparisons}))
    settings = config.render.model_dump(mode="json", exclude=VIEWS)
    record = provenance_record("render", inputs=shards, config={"render": settings})
    write_sidecar(out, record)
