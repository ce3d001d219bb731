"""From a trajectory to the image shard of one viewpoint."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa

from slipstitch.errors import BadInput
from slipstitch.provenance import provenance_record, start_clock, write_parquet
from slipstitch.render.camera import Camera, Pose, cloth_room, crop_to, turned
from slipstitch.render.camera_file import read_camera_file
from slipstitch.render.catalogue import VIEWPOINTS
from slipstitch.render.composition import LIGHT_OVERSAMPLING, Layers, compose, make_layers
from slipstitch.render.settings import RenderSettings
from slipstitch.sample.frames import sampled_frames
from slipstitch.simulate.trajectory import Trajectory, read_trajectory

SCHEMA = pa.schema(
    [
        ("simulation", pa.string()),
        ("texture", pa.string()),
        ("viewpoint", pa.string()),
        ("frame", pa.int32()),
        ("time_s", pa.float64()),
        ("stage_x_m", pa.float64()),
        ("image", pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
    ]
)


@dataclass(frozen=True)
class Shot:
    """One frame to render."""

    row: int
    frame: int
    camera: Camera


def shots(
    trajectory: Trajectory, viewpoint: str, settings: RenderSettings, frames_sampled: int
) -> list[Shot]:
    """The frames to render and the crop of each.

    Parameters
    ----------
    trajectory : Trajectory
    viewpoint : str
        By name.
    settings : RenderSettings
    frames_sampled : int
        How many frames the sample stage uses.
    """
    count = len(trajectory.frame)
    if settings.frames == "all":
        rows = np.arange(count)
    else:
        rows = sampled_frames(count, frames_sampled)
    width, length = _size(trajectory)
    x, z = trajectory.stage_x_m, trajectory.stage_z_m
    fixed = viewpoint_pose(viewpoint, settings)
    result = []
    for row in rows:
        where = (x, z) if settings.crop == "fixed" else (x[row], z[row])
        room = cloth_room(*where, width, length)
        camera = crop_to(fixed, room, settings.pixels)
        result.append(Shot(int(row), int(trajectory.frame[row]), camera))
    return result


def viewpoint_pose(viewpoint: str, settings: RenderSettings) -> Pose:
    """Where a viewpoint's fixed camera stands: as calibrated, or as the catalogue says."""
    seen_from = VIEWPOINTS[viewpoint]
    path = settings.camera_of(viewpoint)
    if path is None:
        return seen_from
    turn = seen_from.azimuth_deg - VIEWPOINTS["calibrated"].azimuth_deg
    return turned(*read_camera_file(path).pose, turn)


def _size(trajectory: Trajectory) -> tuple[float, float]:
    """Width and length (m) of the cloth at rest, over which u and v run from 0 to 1.

    By least squares, whatever plane the rest mesh lies in.
    """
    design = np.column_stack([trajectory.uv, np.ones(len(trajectory.uv))])
    along = np.linalg.lstsq(design, trajectory.rest_positions_m, rcond=None)[0]
    width, length = np.linalg.norm(along[:2], axis=1)
    return float(width), float(length)


def render_layers(
    trajectory: Trajectory, wanted: list[Shot], settings: RenderSettings
) -> Iterator[tuple[Shot, Layers]]:
    """Render the frames one by one; each comes with its `Layers`."""
    from slipstitch.render.blender import FLOOR_M, ClothScene

    scene = ClothScene(trajectory.faces, trajectory.uv, threads=settings.threads)
    for shot in wanted:
        positions = trajectory.positions_m[shot.row]
        radiance, uv = scene.render(
            positions,
            shot.camera.at_resolution(settings.pixels * LIGHT_OVERSAMPLING),
            samples=settings.samples,
            seed=shot.frame,
        )
        yield (
            shot,
            make_layers(
                radiance,
                uv,
                positions.astype(np.float64),
                trajectory.faces,
                trajectory.uv,
                FLOOR_M,
                shot.camera,
            ),
        )


def encode_png(image: np.ndarray) -> bytes:
    """PNG file of an RGB image (H, W, 3) uint8."""
    # Level 3 is twice as fast as libpng's default for files a few percent larger.
    good, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not good:
        raise RuntimeError("OpenCV could not encode a PNG")
    return data.tobytes()


def render_shard(
    trajectory_path: str | os.PathLike,
    out: str | os.PathLike,
    *,
    settings: RenderSettings,
    viewpoint_id: str,
    viewpoint: str,
    frames_sampled: int,
    progress=iter,
) -> dict:
    """Render one simulation from one viewpoint with every texture of the settings.

    Parameters
    ----------
    trajectory_path : path
        Its name without suffix is the simulation's id.
    out : path
        Parquet file, one row an image; written whole or not at all.
    settings : RenderSettings
    viewpoint_id, viewpoint : str
        As the rows call it, and its name in the catalogue.
    frames_sampled : int
    progress : callable
        Wraps the list of frames, to show how far the work is.

    Returns
    -------
    dict
        Number of frames, images, and the smallest share of the cloth's vertices in an image.

    Raises
    ------
    BadInput
        If the trajectory cannot be used.
    """
    started = start_clock()
    cv2.setNumThreads(settings.threads)
    trajectory = read_trajectory(trajectory_path)
    if trajectory.uv.min() < -1e-9 or trajectory.uv.max() > 1 + 1e-9:
        raise BadInput(f"{trajectory_path}: texture coordinates lie outside 0 ... 1")
    if min(_size(trajectory)) <= 0 or trajectory.stage_z_m.min() < 0:
        raise BadInput(f"{trajectory_path}: the cloth has no extent or hangs below the floor")
    wanted = shots(trajectory, viewpoint, settings, frames_sampled)
    simulation = Path(trajectory_path).stem
    names = settings.texture_ids()
    columns: dict[str, list] = {name: [] for name in SCHEMA.names}
    for shot, layers in render_layers(trajectory, progress(wanted), settings):
        for texture_id, image in zip(names, compose(layers, list(names.values())), strict=True):
            video = f"{simulation}_{texture_id}_{viewpoint_id}"
            row = (
                simulation,
                texture_id,
                viewpoint_id,
                shot.frame,
                float(trajectory.time_s[shot.row]),
                float(trajectory.stage_x_m[shot.row]),
                {"bytes": encode_png(image), "path": f"{video}_{shot.frame:06d}.png"},
            )
            for name, value in zip(SCHEMA.names, row, strict=True):
                columns[name].append(value)
    inside = min(share_in_image(trajectory, shot) for shot in wanted)
    metadata = {
        "simulation": simulation,
        "viewpoint": {"id": viewpoint_id, "name": viewpoint},
        "textures": names,
        "camera": _camera_record(wanted, settings),
        "smallest_share_of_cloth_in_image": inside,
    }
    record = provenance_record(
        "render",
        inputs=[trajectory_path, *filter(None, [settings.camera_of(viewpoint)])],
        config={
            "render": settings,
            "sample": {"frames": frames_sampled},
            "viewpoint": viewpoint,
        },
        started=started,
    )
    # PNG does not compress any further.
    write_parquet(
        pa.table(columns, schema=SCHEMA),
        out,
        metadata,
        record,
        compression={name: "zstd" for name in SCHEMA.names if name != "image"},
    )
    return {
        "frames": len(wanted),
        "images": len(columns["frame"]),
        "smallest_share_of_cloth_in_image": inside,
    }


def share_in_image(trajectory: Trajectory, shot: Shot) -> float:
    """Share of the cloth's vertices that project into the image."""
    place = shot.camera.project(trajectory.positions_m[shot.row].astype(np.float64))
    inside = (place > -0.5) & (place < shot.camera.pixels - 0.5)
    return float(inside.all(axis=1).mean())


def _camera_record(wanted: list[Shot], settings: RenderSettings) -> dict:
    first = wanted[0].camera
    return {
        "convention": "OpenCV: x_camera = rotation x_world + translation_m; x right, y down, "
        "z forward; the centre of the first pixel is (0, 0); no distortion",
        "crop": settings.crop,
        "pixels": settings.pixels,
        "rotation": first.rotation.tolist(),
        "translation_m": first.translation_m.tolist(),
        "frames": {
            str(shot.frame): {
                "focal_px": shot.camera.matrix[0, 0],
                "principal_point_px": shot.camera.matrix[:2, 2].tolist(),
            }
            for shot in wanted
        },
    }
