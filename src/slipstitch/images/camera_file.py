"""Camera files: a real camera's lens and position at the stage, as written by calibration."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import reading, write_json
from slipstitch.images.camera import AIM_M, Camera, Lens
from slipstitch.images.foreign_camera import check_principal_point, looks_foreign

FORMAT = "slipstitch camera 1"
CONVENTION = (
    "OpenCV: x_camera = rotation x_stage + translation_m; x right, y down, z forward; the centre "
    "of the first pixel is (0, 0); stage: x along the drag from under the clamps' first place, "
    "y along the cloth's upper edge, z up from the floor"
)
#: Terms of the distortion in OpenCV's order.
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
# From the middle of the track: at it no direction is defined, and a bench stands in a room.
_NEAREST_M, _FARTHEST_M = 0.1, 100.0


def lens_record(lens: Lens) -> dict[str, Any]:
    """A lens as a camera file has it."""
    matrix = lens.matrix
    return {
        "image_size_px": list(lens.size_px),
        "focal_px": [matrix[0, 0], matrix[1, 1]],
        "principal_point_px": [matrix[0, 2], matrix[1, 2]],
        "distortion": dict(zip(DISTORTION, lens.distortion, strict=True)),
    }


def camera_record(camera: Camera) -> dict[str, Any]:
    """A camera at its place as a camera file has it."""
    distortion = np.zeros(len(DISTORTION)) if camera.distortion is None else camera.distortion
    return {
        **lens_record(Lens(camera.size_px, camera.matrix, distortion)),
        "rotation": camera.rotation.tolist(),
        "translation_m": camera.translation_m.tolist(),
    }


def write_camera_file(path: str | os.PathLike, content: Mapping[str, Any]) -> None:
    """Write what `read_camera_file` reads, atomically; numbers with all their digits."""
    whole = {"format": FORMAT, "convention": CONVENTION, **content}
    write_json(path, whole, default=float)


def read_camera_file(path: str | os.PathLike) -> Camera:
    """A camera that can be rendered from.

    Raises
    ------
    BadInput
        If the file is missing, no camera file, or does not say where the camera stands, or a place
        that no camera of a bench has.
    """
    if looks_foreign(path):
        raise BadInput(
            f"{path}: a camera calibration of another program, which does not say where the camera "
            "stands: slipstitch capture camera --from FILE --stage-view IMAGE ... makes a camera "
            "file of it"
        )
    with reading(path, "JSON file"):
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BadInput(f"{path}: not a camera file: its format is not {FORMAT!r}")
    if content.get("rotation") is None or content.get("translation_m") is None:
        raise BadInput(
            f"{path}: does not contain the position of the camera; calibrate it with --stage-view"
        )
    size = _numbers(path, content, "image_size_px", (2,))
    focal = _numbers(path, content, "focal_px", (2,))
    middle = _numbers(path, content, "principal_point_px", (2,))
    rotation = _numbers(path, content, "rotation", (3, 3))
    if (size < 1).any() or (size % 1 != 0).any() or (focal <= 0).any():
        raise BadInput(f"{path}: image_size_px or focal_px is not positive")
    check_principal_point(path, (int(size[0]), int(size[1])), middle)
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise BadInput(f"{path}: rotation is not a rotation matrix")
    terms = content.get("distortion")
    if not isinstance(terms, dict) or set(terms) != set(DISTORTION):
        raise BadInput(f"{path}: distortion must contain {', '.join(DISTORTION)}")
    matrix = np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1.0]])
    translation = _numbers(path, content, "translation_m", (3,))
    # hypot, because the square of a large number would overflow
    distance_m = math.hypot(*(rotation @ AIM_M + translation))
    if not _NEAREST_M <= distance_m <= _FARTHEST_M:
        raise BadInput(
            f"{path}: translation_m: the camera is {distance_m:g} m from the middle of the track; "
            f"must be {_NEAREST_M:g} to {_FARTHEST_M:g} m"
        )
    ordered = {"distortion": [terms[name] for name in DISTORTION]}
    distortion = _numbers(path, ordered, "distortion", (5,))
    return Camera(rotation, translation, matrix, int(size[0]), int(size[1]), distortion)


def _numbers(path, content: dict, key: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(content[key], dtype=np.float64)
    except KeyError:
        raise BadInput(f"{path}: no {key!r}") from None
    except (TypeError, ValueError):
        raise BadInput(f"{path}: {key} must contain numbers") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise BadInput(f"{path}: {key} must contain {'x'.join(map(str, shape))} finite numbers")
    return array
