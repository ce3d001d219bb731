"""Dataset section of the report: images by label, whole videos frame by frame, sizes of splits."""

from collections.abc import Mapping, Sequence
from typing import Any

from slipstitch.base.page.figures import data_uri
from slipstitch.base.page.wording import evenly
from slipstitch.design.grid import Simulation, sampled_frames, simulations, textures, viewpoints
from slipstitch.design.splits import SIDES
from slipstitch.report.physics import MOST_FRICTIONS_SHOWN
from slipstitch.report.results import Results

# The middle of the first forward stroke (paper, Sec. 4.1: 7 s down, then 31 s per stroke).
MID_STROKE_S = 22.5
FRAMES_IN_STRIP = 10
MOST_MATERIALS_SHOWN = 4
# A page that a browser opens at once, at the paper's scale too.
FILM_BYTES_MAX = 3_000_000


def dataset(results: Results) -> dict[str, Any] | None:
    """Sampled images: by material and friction, by viewpoint and texture, and two whole videos."""
    rows, config = results.manifest(), results.config
    if rows is None:
        return None
    by_name = {row["video"]: row for row in rows}
    view, texture = viewpoints(config)[0], textures(config)[0]
    kept = sampled_frames(config.simulation.frames, config.sample.frames_kept)
    time_s = kept / config.simulation.frame_rate_hz
    middle = [int(abs(time_s - MID_STROKE_S).argmin())]

    def images(one: Simulation, positions: Sequence[int], texture_id: str, view_id: str):
        row = by_name.get(f"{one.id}_{texture_id}_{view_id}")
        return [data_uri(image) for image in (results.images(row, positions) if row else [])]

    def cell(one: Simulation, texture_id: str = texture["id"], view_id: str = view["id"]):
        return next(iter(images(one, middle, texture_id, view_id)), None)

    grid = [one for one in simulations(config) if one.replicate_id == "r00"]
    frictions = evenly(config.grid.frictions, MOST_FRICTIONS_SHOWN)
    same = [one for one in grid if one.material == grid[0].material]
    chosen = same[len(same) // 2]
    ends = [one for one in same if one.friction in (frictions[0], frictions[-1])]
    every, shown = evenly(range(len(kept)), FRAMES_IN_STRIP), (texture["id"], view["id"])
    strips = {f"{one.material}, µ = {one.friction:g}": images(one, every, *shown) for one in ends}
    return {
        "videos": len(rows),
        "images": sum(row["frames"] for row in rows),
        "frictions": [f"µ = {friction:g}" for friction in frictions],
        "materials": {
            name: [cell(o) for o in grid if o.material == name and o.friction in frictions]
            for name in evenly(config.grid.materials, MOST_MATERIALS_SHOWN)
        },
        "view": view["name"],
        "textures": [
            item["name"] + (" (test)" if item["role"] == "test" else "")
            for item in textures(config)
        ],
        "views": {
            item["name"] + (" (mirrors)" if item["floor_role"] == "test" else ""): [
                cell(chosen, kind["id"], item["id"]) for kind in textures(config)
            ]
            for item in viewpoints(config)
        },
        "middle": f"{chosen.material}, µ = {chosen.friction:g}",
        "strips": {title: frames for title, frames in strips.items() if frames},
        "parts": {split: _parts(rows, split) for split in ("by_video", "by_simulation")},
        "held_out": len({r["simulation"] for r in rows if r["split_by_simulation"] == "test"}),
    }


def _parts(rows: Sequence[Mapping[str, Any]], split: str) -> list[int]:
    """Number of videos to train, to validate and to test."""
    sides = [row[f"split_{split}"] for row in rows if row["floor_role"] == "train"]
    return [sides.count(side) for side in SIDES]


def film(results: Results) -> dict[str, str] | None:
    """The film of the simulation in the middle of those that have one, if it is small."""
    folder = results.folder / "render" / "preview"
    there = [one for one in results.simulated() if (folder / f"{one.id}.mp4").exists()]
    one = there[len(there) // 2] if there else None
    content = results.content("render", "preview", f"{one.id}.mp4") if one else None
    if not one or not content or len(content) > FILM_BYTES_MAX:
        return None
    title = f"{one.material}, µ = {one.friction:g}"
    return {"title": title, "video": data_uri(content, "video/mp4")}
