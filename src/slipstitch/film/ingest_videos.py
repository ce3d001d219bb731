"""Captures as a dataset: the same files as for simulated videos, and the data on each video."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, read_parquet, start_clock, write_parquet
from slipstitch.config import Config
from slipstitch.config.catalogue import fabric_names
from slipstitch.dataset.manifest import dataset_digest, read_manifest, write_manifest
from slipstitch.dataset.videos import ROLES, pixels_digest, write_frames
from slipstitch.design.grid import material_id
from slipstitch.film.captures_table import Capture, read_captures
from slipstitch.film.frame_schedule import Schedule
from slipstitch.film.stage_video import StageVideo, read_stage_video
from slipstitch.images.camera_file import read_camera_file
from slipstitch.images.encoding import encode_png

CAPTURES = "captures.parquet"
OF_CAPTURE = (
    *("pair", "material", "substrate", "repeat"),
    *("mu_ref", "mu_ref_error", "reflective", "surrogate"),
)
_OF_VIDEO = ("frame_interval_s", "longest_gap_s", "view_angle_deg")
CAPTURES_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("video", *OF_CAPTURE[:3])),
        ("repeat", pa.int32()),
        *((name, pa.float64()) for name in ("mu_ref", "mu_ref_error")),
        *((name, pa.bool_()) for name in ("reflective", "surrogate")),
        ("start_s", pa.float64()),
        ("start_found", pa.bool_()),
        *((name, pa.float64()) for name in ("start_residual_m", "stage_speed", *_OF_VIDEO)),
        *((name, pa.string()) for name in ("notes", "dataset_digest")),
    ]
)
# No texture and no viewpoint of the catalogue: both are the bench's own.
_TEXTURE, _VIEW = "t00", "v00"


def ingest(
    config: Config,
    table: str | Path,
    out_dir: str | Path,
    reference: str | Path | None = None,
    progress=iter,
) -> list[dict[str, Any]]:
    """Bring the videos of a captures table into a dataset; return the rows of ``captures.parquet``.

    Parameters
    ----------
    config : Config
        Of the dataset that the networks were trained on: frames, pixels, crop, viewpoint.
    table, reference : path
        See `slipstitch.film.captures_table.read_captures`.
    out_dir : path
        ``{capture}.parquet``, ``manifest.parquet`` as `slipstitch sample` writes them, and
        ``captures.parquet``.
    progress : callable
        Wraps the list of captures.

    BadInput if the table, a camera file or a video cannot be used.
    """
    started = start_clock()
    captures = read_captures(table, reference)
    schedule = Schedule.of(config)
    lenses = {path: read_camera_file(path) for path in {capture.camera for capture in captures}}
    manifest, known = [], []
    for capture in progress(captures):
        video = read_stage_video(
            capture.video,
            lenses[capture.camera],
            schedule,
            start_s=capture.start_s,
            frame_rate_hz=capture.frame_rate_hz,
        )
        manifest.append(_write_video(config, capture, video, schedule, Path(out_dir)))
        known.append(_known(capture, video))
    digest = dataset_digest(manifest)
    inputs = [table, *filter(None, [reference]), *lenses, *(capture.video for capture in captures)]
    record = _record(config, inputs, started)
    write_manifest(manifest, out_dir, record)
    rows = [{**row, "dataset_digest": digest} for row in known]
    table_of = pa.Table.from_pylist(rows, schema=CAPTURES_SCHEMA)
    write_parquet(table_of, Path(out_dir) / CAPTURES, {}, record)
    return rows


def _record(config: Config, inputs: Sequence, started) -> dict[str, Any]:
    keys = config.model_dump(mode="json", include={"simulation", "render", "sample"})
    return provenance_record("capture", inputs=inputs, config=keys, started=started)


def _write_video(
    config: Config, capture: Capture, video: StageVideo, schedule: Schedule, out_dir: Path
) -> dict[str, Any]:
    """Write one capture's frames; return its row of the manifest."""
    started = start_clock()
    name = f"{capture.id}_{_TEXTURE}_{_VIEW}"
    of_both: dict[str, Any] = {"video": name, "simulation": capture.id}
    of_both |= {"material": capture.material, "friction": capture.mu_ref}
    images = [
        {
            **of_both,
            "texture": _TEXTURE,
            "viewpoint": _VIEW,
            "position": k,
            "frame": int(schedule.frame[k]),
            "time_s": float(video.time_s[k]),
            "stage_x_m": float(video.stage_x_m[k]),
            "image": {"bytes": encode_png(image), "path": f"{name}_{schedule.frame[k]:04d}.png"},
        }
        for k, image in enumerate(video.frames)
    ]
    file = f"{capture.id}.parquet"
    write_frames(images, out_dir / file, _record(config, [capture.video, capture.camera], started))
    known = capture.material in fabric_names()
    return {
        **of_both,
        "material_id": material_id(capture.material) if known else "other",
        "friction_id": capture.pair,
        "replicate_id": f"r{capture.repeat:02d}",
        "texture_id": _TEXTURE,
        "viewpoint_id": _VIEW,
        "texture": "its own",
        "viewpoint": "calibrated",
        **dict.fromkeys([f"{kind}_role" for kind in ROLES], "test"),
        "viewpoint_turn_deg": 0.0,
        **{f"pose_{name}": value for name, value in video.pose.items()},
        "floor": capture.substrate,
        "floor_reflectance": None,
        "floor_roughness": None,
        "interpolated": False,
        "split_by_video": "test",
        "split_by_simulation": "test",
        "frames": len(images),
        "pixels": schedule.pixels,
        "pixels_sha256": pixels_digest(video.frames),
        "file": file,
    }


def _known(capture: Capture, video: StageVideo) -> dict[str, Any]:
    return {
        "video": f"{capture.id}_{_TEXTURE}_{_VIEW}",
        **{name: getattr(capture, name) for name in OF_CAPTURE},
        "start_s": video.start.time_s,
        "start_found": video.start.found,
        "start_residual_m": video.start.residual_m,
        "stage_speed": video.time_base and video.time_base.rate,
        **{name: getattr(video, name) for name in _OF_VIDEO},
        "notes": "; ".join(video.notes),
    }


def read_known(dataset: str | Path) -> list[dict[str, Any]]:
    """Rows of ``captures.parquet``, by video; BadInput if they are of another dataset."""
    path = Path(dataset) / CAPTURES
    rows = read_parquet(path, CAPTURES_SCHEMA.names).to_pylist()
    manifest, digest = read_manifest(dataset)
    videos = sorted(row["video"] for row in manifest)
    if sorted(row["video"] for row in rows) != videos or {
        row["dataset_digest"] for row in rows
    } != {digest}:
        raise BadInput(f"{path}: does not belong to the dataset in the same folder")
    return sorted(rows, key=lambda row: row["video"])
