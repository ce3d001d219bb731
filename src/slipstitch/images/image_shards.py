"""Image shards: composed from the light of a simulation from one viewpoint, read, and previewed."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pyarrow as pa

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import evenly
from slipstitch.config import Config
from slipstitch.images.camera import keypoints_m
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import decode_image, encode_png
from slipstitch.images.packing import Pack, read_pack, shade
from slipstitch.images.textures import texture_file
from slipstitch.images.view import Shot, View
from slipstitch.physics.simulation.trajectory import Trajectory

SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("simulation", "texture", "viewpoint")),
        ("frame", pa.int32()),
        *((name, pa.float64()) for name in ("time_s", "stage_x_m")),
        ("image", pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
    ]
)

_GROUP = 64


def composed_images(
    view: View, pack: Pack, trajectory: Trajectory
) -> Iterator[tuple[Shot, str, np.ndarray]]:
    """Every frame in every texture: shot, texture id, image (pixels, pixels, 3) uint8."""
    effects, rectifier = view.camera_effects(), view.rectifier(trajectory)
    worn = [view.worn(name) for name in view.textures.values()]
    for shot, shading, sight in pack.frames(trajectory):
        composed = compose_light(join(shading, sight), worn)
        rectified = rectifier.at(shot.camera, shot.time_s)
        for (identity, name), light in zip(view.textures.items(), composed, strict=True):
            noise = view.noise(name, shot.frame)
            yield shot, identity, rectified(effects[identity].photograph(light, noise))


def render_shard(
    view: View, out: str | os.PathLike, *, pack_path: str | os.PathLike | None = None, progress=iter
) -> dict:
    """Make the image shard of one simulation from one viewpoint, with every texture.

    The light is from the file `pack_path` or rendered in Blender; the pixels are the same. Return
    the numbers of frames and images, and the smallest share of the cloth in an image; else
    BadInput.
    """
    started = provenance.start_clock()
    cv2.setNumThreads(1)
    trajectory = view.trajectory()
    files = [file for name in view.textures.values() if (file := texture_file(name))]
    if pack_path is None:
        pack = shade(view, trajectory, progress)
    else:
        pack = read_pack(pack_path, view, trajectory)
        files.append(Path(pack_path))
    # PNG does not compress any further.
    how = {name: "zstd" for name in SCHEMA.names if name != "image"}
    # A group holds some tens of images, whole frames of them.
    size = -(-_GROUP // len(view.textures)) * len(view.textures)
    rows = (_row(view, trajectory, *one) for one in composed_images(view, pack, trajectory))
    groups = iter(lambda: list(islice(rows, size)), [])
    provenance.write_row_groups(
        out, SCHEMA, groups,
        lambda: _description(view, pack, trajectory, files, started), compression=how,
    )  # fmt: skip
    return {
        "frames": len(pack.shots),
        "images": len(pack.shots) * len(view.textures),
        "smallest_share_of_cloth_in_image": pack.metadata["smallest_share_of_cloth_in_image"],
    }


def render_shards_from_packs(
    config: Config, trajectory_path: str | os.PathLike, pack_paths: Iterable[Path], folder: Path
) -> Iterator[tuple[Path, dict]]:
    """Make the image shards of one simulation without Blender, from the light of its viewpoints.

    Yield each, named as its pack, with what `render_shard` returns, and ``viewpoint``, by name.
    """
    for pack_path in pack_paths:
        try:
            named = provenance.read_metadata(pack_path).get("viewpoint", {})
        except (OSError, ValueError):
            named = {}  # read_pack says what is wrong with it
        view = View.identified(config, trajectory_path, named.get("id", ""), named.get("name", ""))
        out = folder / pack_path.name
        done = render_shard(view, out, pack_path=pack_path)
        yield out, done | {"viewpoint": view.viewpoint}


def _row(view: View, trajectory: Trajectory, shot: Shot, texture: str, image: np.ndarray) -> dict:
    video = f"{view.simulation}_{texture}_{view.viewpoint_id}"
    return {
        "simulation": view.simulation,
        "texture": texture,
        "viewpoint": view.viewpoint_id,
        "frame": shot.frame,
        "time_s": float(trajectory.time_s[shot.row]),
        "stage_x_m": float(trajectory.stage_x_m[shot.row]),
        "image": {"bytes": encode_png(image), "path": f"{video}_{shot.frame:06d}.png"},
    }


def _description(
    view: View, pack: Pack, trajectory: Trajectory, files: list, started: tuple[float, float]
) -> tuple[dict, dict]:
    effects = view.camera_effects()
    points_m = keypoints_m(trajectory.positions_m, trajectory.uv, trajectory.stage_x_m)
    points_m = points_m.reshape(len(points_m), -1).round(5)  # of each frame 27 numbers
    metadata = pack.metadata | {
        "viewpoint": {"id": view.viewpoint_id, "name": view.viewpoint},
        "textures": dict(view.textures),
        "augmentation": {identity: asdict(one) for identity, one in effects.items()},
        "pose": view.rectifier(trajectory).pose(pack.shots[0].camera),
        "marked_points_m": {str(shot.frame): points_m[shot.row].tolist() for shot in pack.shots},
    }
    unused = {"verified_images": True}
    record = view.record("render", started, unused, files, view.textures.values())
    return metadata, record


_SHEET_COLUMNS = 9
_SECONDS = 12.0
_SMALLEST_VIDEO_PX = 224
_GAP = 2


def read_images(path: str | os.PathLike) -> dict[tuple[str, str, str], dict[int, bytes]]:
    """PNG files of a shard: (simulation, texture, viewpoint) -> frame -> bytes; else BadInput."""
    table = provenance.read_parquet(path, SCHEMA.names)
    videos: dict[tuple[str, str, str], dict[int, bytes]] = {}
    for row in table.to_pylist():
        key = (row["simulation"], row["texture"], row["viewpoint"])
        videos.setdefault(key, {})[row["frame"]] = row["image"]["bytes"]
    return videos


def preview(
    shards: Sequence[str | os.PathLike],
    sheet: str | os.PathLike | None = None,
    video: str | os.PathLike | None = None,
) -> None:
    """Make a contact sheet and a video of image shards, usually all viewpoints of a simulation.

    `sheet` (PNG) has for every viewpoint a row of the first texture through time, then, at one
    time, all textures; `video` (MP4) the viewpoints side by side. BadInput without a frame in
    common.
    """
    started = provenance.start_clock()
    videos = {}
    for path in shards:
        for key, frames in read_images(path).items():
            if key in videos:
                raise BadInput(f"{path}: holds {'_'.join(key)}, which is also in another shard")
            videos[key] = {number: (data, path) for number, data in frames.items()}
    numbers = [set(frames) for frames in videos.values()]
    common = sorted(set.intersection(*numbers)) if numbers else []
    if not common:
        raise BadInput(f"no common frame in {', '.join(map(str, shards))}")
    views: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    for key in sorted(videos):
        simulation, _, view = key
        views.setdefault((simulation, view), []).append(key)
    firsts = [keys[0] for keys in views.values()]

    def image(key: tuple[str, str, str], number: int) -> np.ndarray:
        data, path = videos[key][number]
        return decode_image(data, f"{path}: {'_'.join(key)} frame {number}")

    record = provenance.provenance_record("render", inputs=shards, started=started)
    if sheet is not None:
        times, middle = evenly(common, _SHEET_COLUMNS), common[len(common) // 2]
        rows = [[image(first, number) for number in times] for first in firsts]
        for keys in views.values():
            for k in range(0, len(keys) if len(keys) > 1 else 0, _SHEET_COLUMNS):
                rows.append([image(key, middle) for key in keys[k : k + _SHEET_COLUMNS]])
        with provenance.recorded_path(sheet, record) as temporary:
            temporary.write_bytes(cv2.imencode(".png", _tile(rows))[1].tobytes())
    if video is not None:
        pictures = (_tile([[image(first, number) for first in firsts]]) for number in common)
        with provenance.recorded_path(video, record) as temporary:
            _write_video(temporary, pictures, rate_hz=max(1.0, len(common) / _SECONDS))


def _tile(rows: list[list[np.ndarray]]) -> np.ndarray:
    """Images in a grid with a thin gap, all at the size of the largest."""
    side = max(image.shape[0] for row in rows for image in row)
    size = [(side + _GAP) * count - _GAP for count in (len(rows), max(map(len, rows)))]
    canvas = np.full((*size, 3), 255, dtype=np.uint8)
    for i, row in enumerate(rows):
        for j, image in enumerate(row):
            if image.shape[0] != side:
                image = cv2.resize(image, (side, side), interpolation=cv2.INTER_CUBIC)
            y, x = i * (side + _GAP), j * (side + _GAP)
            canvas[y : y + side, x : x + side] = image
    return canvas


def _write_video(path: Path, pictures, rate_hz: float) -> None:
    """H.264, which browsers play; OpenCV writes MPEG-4 Part 2 only, which they do not."""
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        rate = Fraction(rate_hz).limit_denominator(1000)
        stream = container.add_stream("libx264", rate=rate, options={"threads": "1"})
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            scale = max(1, -(-_SMALLEST_VIDEO_PX // picture.shape[0]))
            picture = np.kron(picture, np.ones((scale, scale, 1), np.uint8))
            # The codec needs even sides.
            picture = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
            if not stream.codec_context.is_open:
                stream.height, stream.width = picture.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode())
