"""A small results folder with complete records, quickly: invented motion, drawn images.

Nothing in it was simulated or rendered; the records are those that the stages write.
"""

import base64
import contextlib
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from slipstitch.base.provenance import provenance_record, start_clock, write_json, write_parquet
from slipstitch.config import Config, write_config
from slipstitch.dataset.dataset import write_dataset
from slipstitch.dataset.videos import decode
from slipstitch.design.grid import Simulation, simulations, write_grid
from slipstitch.design.stage_path import StagePath
from slipstitch.images import verification
from slipstitch.images.encoding import encode_png
from slipstitch.images.image_shards import _description
from slipstitch.images.packing import shade
from slipstitch.images.surroundings import draw_surroundings
from slipstitch.images.view import View
from slipstitch.physics.friction_law.extended_model import read_extended_model
from slipstitch.physics.simulation.convergence import measured_convergence
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, draw_perturbation
from slipstitch.physics.simulation.trajectory import Trajectory, write_trajectory
from support import synthetic_cloth, synthetic_results, synthetic_videos


def config(**sections) -> Config:
    """2 fabrics, 4 coefficients, 2 replicates, a test-only texture and viewpoint, 16 pixels."""
    render = {
        "pixels": 16, "viewpoints": ["calibrated", "side"], "test_viewpoints": ["calibrated_+10"],
        "textures": ["stripes", "tartan"], "test_textures": ["chevron"],
        "floors": ["matte", "ceramic", "stainless-steel"],
        "augmentation": {"lamp_m": 0.1, "exposure_stops": 0.5},
    }  # fmt: skip
    grid = {"materials": ["gray-interlock", "ivory-rib-knit"], "frictions": [0.1, 0.3, 0.6, 1.0]}
    small = {
        "grid": grid | {"replicates": 2}, "simulation": {"frames": 60, "vertices_per_side": 11},
        "render": render, "sample": {"frames": 5}, "release": {"shard_mb": 0.01},
    }  # fmt: skip
    return synthetic_results.config(**small | sections)


def write(config: Config, folder: Path) -> Path:
    """Write ``results/`` in `folder`, as the workflow does, up to the dataset; return it."""
    results = folder / "results"
    with contextlib.chdir(folder), contextlib.redirect_stderr(sys.stdout):
        here = Path("results")
        write_config(config, here / "config.json")
        write_grid(config, here / "grid.parquet")
        synthetic_results.write_calibrate(config, here)
        _write_simulate(config, here)
        shards = _write_render(config, here)
        _write_verification(config, here, shards)
        write_dataset(config, shards, here / "sample")
    return results


def _write_simulate(config: Config, results: Path) -> None:
    model = config.simulation.model
    step_s = 1 / config.simulation.frame_rate_hz / 5  # the largest below 84 ms that fits
    for one in simulations(config):
        run = DropAndDrag(one.material, one.friction, one.seed, one.replicate)
        motion = synthetic_cloth.motion(config.simulation.frames, n=11)
        names = ("material", "friction", "seed", "material_id", "friction_id", "replicate_id")
        metadata = {name: getattr(one, name) for name in names} | {
            "simulation": one.id,
            "settings": config.simulation.model_dump(mode="json"),
            "perturbation": vars(draw_perturbation(config.simulation, one.seed, one.replicate)),
            "solver": {"steps": 400, "newton_iterations": 1200, "largest_residual": 4.7e-4},
            "stage_path": vars(StagePath()),
            "extended_model": asdict(read_extended_model(model)) if model else None,
            "step_s": step_s,
            "device": "cpu",
            "convergence": measured_convergence(one.material, one.friction, config.simulation),
        }
        motion["pinned"] = np.array([0, 10])  # 11 vertices 2 cm apart, held by tabs of 1 cm
        record = provenance_record(
            "simulate",
            inputs=[results / "calibrate/calibration.json", *([model] if model else [])],
            config={"simulation": config.simulation, "catalogue": run.catalogue_entries()},
            seed=one.seed,
        )
        write_trajectory(
            results / f"simulate/{one.id}.parquet",
            Trajectory(**motion, metadata=metadata),
            record,
            residual=np.full(len(motion["frame"]), 4.7e-4),
        )


def _write_render(config: Config, results: Path) -> list[Path]:
    """Drawn images with what the render stage says of its own; nothing is rendered."""
    of_grid = {one.id: one for one in simulations(config)}
    paths = synthetic_videos.write_shards(config, results / "render")
    for path in paths:
        simulation, view = path.stem.rsplit("_", 1)
        filmed = View.of(config, results / f"simulate/{simulation}.parquet", view)
        trajectory = _on_path(config, filmed.trajectory(), of_grid[simulation])
        pack = shade(filmed, trajectory)
        notes, record = _description(filmed, pack, trajectory, [], start_clock())
        # As the render stage writes them: frame by frame, all textures of each.
        table = pq.read_table(path).sort_by([("frame", "ascending"), ("texture", "ascending")])
        column = table.schema.get_field_index("stage_x_m")
        x_m, _ = StagePath().position_m(table["time_s"].to_numpy())
        table = table.set_column(column, "stage_x_m", pa.array(x_m))
        write_parquet(table, path, notes, record)
    return paths


def _on_path(config: Config, trajectory: Trajectory, one: Simulation) -> Trajectory:
    """A trajectory whose clamps move as the bench's do."""
    x_m, z_m = StagePath().position_m(trajectory.time_s)
    z_m = z_m + draw_perturbation(config.simulation, one.seed, one.replicate).height_m
    return replace(trajectory, stage_x_m=x_m, stage_z_m=z_m)


def _write_verification(config: Config, results: Path, shards: list[Path]) -> None:
    """Drawn as the workflow draws them; the direct renders are the images and some noise."""
    tables = {path: pq.read_table(path) for path in sorted(shards)}
    rows = [(path, k) for path, table in tables.items() for k in range(len(table))]
    comparisons, inputs = [], set()
    for number in verification.drawn_rows(config.seed, config.render.verified_images, len(rows)):
        path, k = rows[number]
        row = tables[path].slice(k, 1).to_pylist()[0]
        floor = draw_surroundings(config.render, config.seed, row["simulation"], row["viewpoint"])
        composed = decode(row["image"]["bytes"], str(path))
        noise = np.random.default_rng(number).integers(-2, 3, composed.shape)
        direct = np.clip(composed + noise, 0, 255).astype(np.uint8)
        video = f"{row['simulation']}_{row['texture']}_{row['viewpoint']}"
        pictures = [base64.b64encode(encode_png(one)).decode() for one in (composed, direct)]
        near = verification.psnr_db(composed, direct), verification.ssim(composed, direct)
        least_db = verification.LEAST_PSNR_DB[floor.reflects]
        of_image = video, row["frame"], floor.floor, *near, least_db, True, *pictures
        comparisons.append(verification.Comparison(*of_image))
        inputs.update([path, results / f"simulate/{row['simulation']}.parquet"])
    content = {"comparisons": [asdict(one) | {"passed": one.passed} for one in comparisons]}
    settings = {"render": config.render.model_dump(mode="json", exclude=verification.VIEWS)}
    record = provenance_record("render", inputs=inputs, config=settings, seed=config.seed)
    write_json(results / "render/verification.json", content, record)
