"""A clip simulated and rendered again from its record, and compared."""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.provenance import read_metadata, write_json
from slipstitch.config import Config
from slipstitch.config.load import without_law
from slipstitch.dataset.audit.auditing import find_clip
from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.images import decode, read_shard
from slipstitch.dataset.release.records import Artefact, carried_file, recorded_name, rows_digest

# How and beside what it ran; the trajectory's digest is of its times too.
_OF_THE_RUN = frozenset({"device", "simulated_at_once", "trajectory_sha256"})


@dataclass(frozen=True)
class Rebuilt:
    """A clip made again beside the released one."""

    clip: str
    same_motion: bool  # whether the simulation gave the same bits
    same_pixels: bool
    images_differing: int
    images: int
    largest_difference: int  # of a channel of a pixel, 0 ... 255
    psnr_db: float | None  # None if equal
    # What the records of the simulation and of the rendering tell otherwise
    differing: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.same_pixels and self.same_motion and not self.differing


def _run(*words: str) -> None:
    """Run a verb of Slipstitch; Blender wants a process of its own."""
    answer = subprocess.run(
        [sys.executable, "-m", "slipstitch", *words], capture_output=True, text=True
    )
    if answer.returncode:
        errors = answer.stderr.strip().splitlines()
        raise SlipstitchError(f"slipstitch {words[0]}: {errors[-1] if errors else 'failed'}")


def _configuration(contents: Contents, config: Config, folder: Path) -> Path:
    """The release's configuration, with files from outside taken from the release."""
    whole = config.model_dump(mode="json")
    simulation, render = whole["simulation"], whole["render"]
    files = {simulation["model"], render["camera"], *config.render.texture_files()} - {None}

    def taken_along(name: str | None) -> str | None:
        path = recorded_name(name, contents.artefacts) if name and name in files else None
        return str((contents.folder / carried_file(path)).resolve()) if path else name

    for section, key in ((simulation, "model"), (render, "camera")):
        section[key] = taken_along(section[key])
    for key in ("textures", "test_textures"):
        render[key] = [taken_along(name) for name in render[key]]
    write_json(folder / "config.json", whole)
    return folder / "config.json"


def rebuild(contents: Contents, clip: str) -> Rebuilt:
    """Render a clip again with the code that is installed.

    From the simulations that the release carries; where it carries none, they are made again too.
    BadInput if the release has no such clip, or lacks what it takes; SlipstitchError if the
    simulation or the rendering fails.
    """
    row = find_clip(contents, clip)
    stages = ("simulate", "render", "calibrate.calibration")
    simulated, rendered, calibrated = (contents.of_stage(row, stage) for stage in stages)
    of_view = [one for one in rendered if Path(one.path).stem.endswith(row["viewpoint_id"])]
    if contents.config is None or not (simulated and of_view and calibrated):
        raise BadInput(f"{contents.folder}: the records behind {clip} are not whole")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = _configuration(contents, contents.config, folder)
        shard = folder / "shard.parquet"
        # Of an interpolated film all simulations that its cloth is made of.
        trajectories = {one.path: folder / Path(one.path).name for one in simulated}
        for path, trajectory in trajectories.items():
            carried = contents.folder / carried_file(path)
            if carried.is_file():  # filmed again from the simulation that the release carries
                shutil.copyfile(carried, trajectory)
                continue
            _run(
                "simulate", "--config", str(config), "--simulation", trajectory.stem,
                "--calibration", str(contents.folder / carried_file(calibrated[0].path)),
                "--out", str(trajectory),
            )  # fmt: skip
        same_motion = all(
            rows_digest(trajectories[one.path]) == one.rows_sha256 for one in simulated
        )
        _run(
            "render", "--config", str(config),
            "--trajectory", str(folder / f"{row['simulation']}.parquet"),
            "--viewpoint", row["viewpoint_id"], "--out", str(shard),
        )  # fmt: skip
        table = pq.read_table(contents.folder / row["shard"], columns=["frame", "image"])
        table = table.slice(row["first_row"], row["frames"])
        videos = read_shard(shard, table["frame"].to_numpy())
        key = (row["simulation"], row["texture_id"], row["viewpoint_id"])
        if key not in videos:
            raise BadInput(f"{clip}: not among the {len(videos)} videos rendered again")
        again, released = (
            np.stack([decode(png, clip, row["pixels"]) for png in images])
            for images in (
                [frame.png for frame in videos[key]],
                [image["bytes"] for image in table["image"].to_pylist()],
            )
        )
        differing = [*_differing(of_view[0], shard)]
        for one in simulated:
            differing += _differing(one, trajectories[one.path])
    return compare(clip, released, again, same_motion, tuple(differing))


def _differing(recorded: Artefact, made: Path) -> list[str]:
    """Entries of a record's metadata that a file made again has otherwise."""
    then, now = (_comparable(metadata) for metadata in (recorded.metadata, read_metadata(made)))
    return [f"{name} of {recorded.path}" for name, value in then.items() if now.get(name) != value]


def _comparable(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """What must be the same in a file made again; not where the law lay, whose content must."""
    kept = {name: value for name, value in metadata.items() if name not in _OF_THE_RUN}
    if isinstance(kept.get("settings"), dict):
        kept["settings"] = without_law(kept["settings"])
    return kept


def compare(
    clip: str,
    released: np.ndarray,
    again: np.ndarray,
    same_motion: bool,
    differing: tuple[str, ...] = (),
) -> Rebuilt:
    """Compare two arrays of images, uint8 of equal shape; the rest as in `Rebuilt`."""
    difference = released.astype(np.int16) - again
    mean_square = float(np.mean(np.square(difference, dtype=np.float64)))
    return Rebuilt(
        clip=clip,
        same_motion=same_motion,
        same_pixels=not difference.any(),
        images_differing=int(difference.any(axis=(1, 2, 3)).sum()),
        images=len(released),
        largest_difference=int(np.abs(difference).max()),
        psnr_db=round(10 * np.log10(255**2 / mean_square), 2) if mean_square else None,
        differing=differing,
    )


def in_words(done: Rebuilt) -> str:
    """The comparison as a line."""
    motion = "the same motion, bit by bit" if done.same_motion else "ANOTHER MOTION"
    told = f"; its records TELL OTHERWISE: {', '.join(done.differing)}" if done.differing else ""
    if done.same_pixels:
        pixels = f"all {done.images} images have equal pixels"
    else:
        pixels = (
            f"{done.images_differing} of {done.images} images DIFFER, "
            f"by up to {done.largest_difference} of 255, {done.psnr_db} dB"
        )
    return f"{done.clip}: made again, {motion}; {pixels}{told}"
