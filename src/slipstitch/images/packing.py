"""Shading packs: the light of one simulation from one viewpoint, the complete output of Blender.

Any texture is composed from a pack and the trajectory, without Blender. Light is kept in half
precision (relative error 2^-11, under a tenth of an 8-bit level), its high and low bytes apart,
which compresses better. Packs are read and written frame by frame.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass

import cv2
import numpy as np
import pyarrow as pa

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput
from slipstitch.config.render import RenderSettings
from slipstitch.images.shading import LIGHT_OVERSAMPLING, Shading, Sight, look, separated_light
from slipstitch.images.surroundings import MATTE, Surroundings
from slipstitch.images.view import Shot, View, camera_record, recorded_shots
from slipstitch.physics.simulation.trajectory import Trajectory

_SCHEMA = pa.schema(
    [
        ("frame", pa.int32()),
        ("window", pa.list_(pa.int32())),
        *((name, pa.binary()) for name in ("still", "cloth", "mirrored")),
    ]
)
# What is mirrored has one scattering more to resolve.
_SAMPLES_MIRRORED = 2
#: Largest light that half precision holds.
_BRIGHTEST = 6e4


@dataclass(frozen=True)
class Pack:
    """The light of a simulation from a viewpoint."""

    metadata: dict  # simulation, viewpoint, cameras, surroundings
    shots: list[Shot]
    shadings: Iterable[dict]  # as half-precision bytes, one a shot; may be run through only once

    @property
    def surroundings(self) -> Surroundings:
        """Floor and lamp."""
        record = dict(self.metadata["surroundings"])
        record["lamp_position_m"] = tuple(record["lamp_position_m"])
        return Surroundings(**record)

    def frames(
        self, trajectory: Trajectory, frame: int | None = None
    ) -> Iterator[tuple[Shot, Shading, Sight]]:
        """Each frame's light and what its rays see, or of the one of a number alone."""
        for shot, packed in zip(self.shots, self.shadings, strict=True):
            if frame in (None, shot.frame):
                sight = _sight(trajectory, shot, self.surroundings)
                yield shot, _unpack(packed, shot.camera.pixels), sight


def _sight(trajectory: Trajectory, shot: Shot, surroundings: Surroundings) -> Sight:
    positions = trajectory.positions_m[shot.row].astype(np.float64)
    return look(positions, trajectory.faces, trajectory.uv, shot.camera, surroundings)


def render_shadings(
    trajectory: Trajectory,
    wanted: list[Shot],
    settings: RenderSettings,
    surroundings: Surroundings = MATTE,
) -> Iterator[tuple[Shot, Shading, Sight]]:
    """Render the frames one by one in Blender."""
    from slipstitch.images.blender import ClothScene

    scene = ClothScene(trajectory.faces, trajectory.uv, surroundings)
    samples = settings.samples * (_SAMPLES_MIRRORED if surroundings.reflects else 1)
    for shot in wanted:
        camera = shot.camera.at_resolution(shot.camera.pixels * LIGHT_OVERSAMPLING)
        positions = trajectory.positions_m[shot.row]
        rendering = scene.render(positions, camera, samples=samples, seed=shot.frame)
        sight = _sight(trajectory, shot, surroundings)
        yield shot, separated_light(*rendering, sight), sight


def shade(view: View, trajectory: Trajectory, progress=iter) -> Pack:
    """Render the light of a view of its trajectory; `progress` wraps the list of frames."""
    wanted, surroundings = view.shots(trajectory), view.surroundings
    metadata = {
        "simulation": view.simulation,
        "viewpoint": {"id": view.viewpoint_id, "name": view.viewpoint},
        "camera": camera_record(wanted, view.bench_camera),
        "surroundings": asdict(surroundings),
        "smallest_share_of_cloth_in_image": min(shot.share_in_image(trajectory) for shot in wanted),
        "trajectory_sha256": _digests(view),
        "interpolation": view.interpolation and asdict(view.interpolation),
        "interpolated_frames": trajectory.metadata.get("interpolated_frames"),
    }
    frames = render_shadings(trajectory, progress(wanted), view.settings, surroundings)
    return Pack(metadata, wanted, (_pack(shading, sight) for _, shading, sight in frames))


def write_pack(view: View, out: str | os.PathLike, progress=iter) -> Pack:
    """Render the light of a view into a file, atomically."""
    started = provenance.start_clock()
    pack = shade(view, view.trajectory(), progress)
    groups = (
        [{"frame": shot.frame, **packed}]
        for shot, packed in zip(pack.shots, pack.shadings, strict=True)
    )
    provenance.write_row_groups(
        out, _SCHEMA, groups,
        lambda: (pack.metadata, view.record("render.packing", started, _UNUSED)),
    )  # fmt: skip
    return pack


# What the light does not depend on.
_UNUSED = {
    **dict.fromkeys(("textures", "test_textures", "viewpoints", "test_viewpoints"), True),
    **dict.fromkeys(("test_viewpoint_videos", "verified_images"), True),
    "augmentation": {"exposure_stops", "colour_cast", "noise", "jpeg_quality"},
}


def read_pack(path: str | os.PathLike, view: View, trajectory: Trajectory) -> Pack:
    """Read what `write_pack` wrote of a view and its trajectory; BadInput if it is none."""
    with provenance.open_parquet(path) as file:
        metadata = provenance.read_metadata(file.schema_arrow)
        if file.schema_arrow.names != _SCHEMA.names or "surroundings" not in metadata:
            raise BadInput(f"{path}: not a shading pack")
    if metadata["trajectory_sha256"] != _digests(view):
        raise BadInput(f"{path}: not rendered from {', '.join(map(str, view.parents))}")
    return Pack(metadata, recorded_shots(metadata["camera"], trajectory), _rows(path))


def _digests(view: View) -> str | dict[str, str]:
    """The digest of the trajectory, or of each that the film's cloth is made of, by name."""
    if view.interpolation is None:
        return provenance.file_digest(view.trajectory_path)
    return {path.stem: provenance.file_digest(path) for path in view.parents}


def _rows(path: str | os.PathLike) -> Iterator[dict]:
    with provenance.open_parquet(path) as file:
        groups = file.num_row_groups
    for group in range(groups):
        with provenance.open_parquet(path) as file:
            rows = file.read_row_group(group).to_pylist()
        yield from rows


def _pack(shading: Shading, sight: Sight) -> dict:
    """Half-precision bytes of a frame's light; of the cloth's, what rays meet."""
    side = shading.cloth.shape[-1]
    step = sight.rays // LIGHT_OVERSAMPLING
    met = np.zeros((side, side), dtype=bool)
    y, x = np.divmod(sight.cloth.seen, side * step)
    met[y // step, x // step] = True
    left, top, columns, rows = cv2.boundingRect(met.astype(np.uint8))
    cloth = (shading.cloth * met)[:, top : top + rows, left : left + columns]
    return {
        "window": [top, top + rows, left, left + columns],
        "still": _bytes(shading.still),
        "cloth": _bytes(cloth),
        "mirrored": None if shading.mirrored is None else _bytes(shading.mirrored),
    }


def _unpack(packed: dict, pixels: int) -> Shading:
    top, bottom, left, right = packed["window"]
    cloth = np.zeros((3, LIGHT_OVERSAMPLING * pixels, LIGHT_OVERSAMPLING * pixels), np.float32)
    cloth[:, top:bottom, left:right] = _array(packed["cloth"], (3, bottom - top, right - left))
    mirrored = packed["mirrored"]
    if mirrored is not None:
        mirrored = _array(mirrored, (2, pixels, pixels))
    return Shading(_array(packed["still"], (3, pixels, pixels)), cloth, mirrored)


def _bytes(light: np.ndarray) -> bytes:
    half = np.clip(light, -_BRIGHTEST, _BRIGHTEST).astype("<f2")
    return np.ascontiguousarray(half.ravel().view(np.uint8).reshape(-1, 2).T).tobytes()


def _array(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    halves = np.ascontiguousarray(np.frombuffer(data, np.uint8).reshape(2, -1).T)
    return halves.view("<f2").reshape(shape).astype(np.float32)
