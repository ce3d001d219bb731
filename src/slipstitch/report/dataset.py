"""Dataset section of the report: images by label, sizes of the splits."""

from collections.abc import Mapping
from typing import Any

from slipstitch.base.page.figures import png_uri
from slipstitch.base.page.wording import evenly
from slipstitch.design.grid import Simulation, simulations, textures, viewpoints
from slipstitch.design.sampled_frames import sampled_frames
from slipstitch.report.results import Results
from slipstitch.report.simulations import MOST_FRICTIONS_SHOWN

# The middle of the first forward stroke (paper, Sec. 4.1: 7 s down, then 31 s per stroke).
MID_STROKE_S = 22.5


def dataset(results: Results) -> dict[str, Any] | None:
    """Sampled images: by material and friction, by viewpoint and texture, and two whole videos."""
    rows = results.manifest()
    if rows is None:
        return None
    config = results.config
    by_name = {row["video"]: row for row in rows}
    grid = [simulation for simulation in simulations(config) if simulation.replicate_id == "r00"]
    kept = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    time_s = kept / config.simulation.frame_rate_hz
    mid_stroke = [int(abs(time_s - MID_STROKE_S).argmin())]
    view = viewpoints(config)[0]
    texture = textures(config)[0]

    def cell(simulation: Simulation, texture_id: str, view_id: str, position: list[int]):
        row = by_name.get(f"{simulation.id}_{texture_id}_{view_id}")
        images = results.images(row, position) if row else []
        return png_uri(images[0]) if images else None

    frictions = evenly(config.grid.frictions, MOST_FRICTIONS_SHOWN)
    materials = {
        material: [
            cell(simulation, texture["id"], view["id"], mid_stroke)
            for simulation in grid
            if simulation.material == material and simulation.friction in frictions
        ]
        for material in config.grid.materials
    }
    same = [simulation for simulation in grid if simulation.material == grid[0].material]
    middle = same[len(same) // 2]
    views = {
        item["name"] + (" (mirrors)" if item["floor_role"] == "test" else ""): [
            cell(middle, kind["id"], item["id"], mid_stroke) for kind in textures(config)
        ]
        for item in viewpoints(config)
    }
    strips = []
    for simulation in dict.fromkeys((same[0], same[-1])):
        row = by_name.get(f"{simulation.id}_{texture['id']}_{view['id']}")
        positions = evenly(range(len(kept)), 10)
        images = results.images(row, list(positions)) if row else []
        if images:
            strips.append(
                {
                    "title": f"{simulation.material}, µ = {simulation.friction:g}",
                    "images": [png_uri(image) for image in images],
                }
            )
    sides = {
        split: {
            side: sum(
                row[f"split_{split}"] == side and row["floor_role"] == "train" for row in rows
            )
            for side in ("train", "validation", "test")
        }
        for split in ("by_video", "by_simulation")
    }
    held_out = {row["simulation"] for row in rows if row["split_by_simulation"] == "test"}
    return {
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "frictions": frictions,
        "materials": materials,
        "view": view["name"],
        "texture": texture["name"],
        "textures": [item["name"] + _role(item) for item in textures(config)],
        "views": views,
        "middle": f"{middle.material}, µ = {middle.friction:g}",
        "strips": strips,
        "sides": sides,
        "held_out": len(held_out),
    }


def _role(item: Mapping[str, str]) -> str:
    return " (test only)" if item["role"] == "test" else ""
