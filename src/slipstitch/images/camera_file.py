"""Camera files: a real camera's lens and place at the stage, which give a film its scale.

`slipstitch capture camera` writes them. Lenses calibrated elsewhere are read too: OpenCV's YAML,
XML and JSON, ROS camera_info, what calibrateCamera returns. All say the same in other words: a
matrix of three by three, distortion coefficients, the size of the image.
"""

import contextlib
import json
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import write_json
from slipstitch.images.camera import AIM_M, Camera, Lens

FORMAT = "slipstitch camera 1"
CONVENTION = (
    "OpenCV: x_camera = rotation x_stage + translation_m; x right, y down, z forward; the centre "
    "of the first pixel is (0, 0); stage: x along the drag from under the clamps' first place, "
    "y along the cloth's upper edge, z up from the floor"
)
#: Terms of the distortion in OpenCV's order.
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
#: Among the uncertainties: of heights above the floor that the camera tells where the clamps are.
HEIGHT = "clamp_height_m"
_LARGEST_FILE = 1_000_000
# From the middle of the track, 30 cm long, and above the floor. A square of the board given in the
# wrong unit puts the camera at a tenth or ten times of its distance.
_NEAREST_M, _FARTHEST_M, _LOWEST_M = 0.2, 5.0, 0.05
# A principal point this far from the middle, as a share of the image, is not one.
_OFF_CENTRE = 0.15

# What other programs call it: in lower case, letters only.
_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsics", "matrix", "mtx", "k", "m")
_DISTORTION = (
    "distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoefs", "distortion", "dist",
    "d",
)  # fmt: skip
_SIZE = ("imagesize", "imagesizepx", "imageshape", "resolution", "size")
_WIDTH, _HEIGHT = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
_NEEDED = "camera_matrix (3x3), distortion_coefficients, image_width and image_height"


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
    """A camera that can be rendered from; BadInput if the file does not say where it stands."""
    content = _content(path)
    if content.get("format") != FORMAT and _value(content, _MATRIX) is not None:
        raise BadInput(
            f"{path}: a camera calibration of another program, which does not say where the camera "
            "stands: slipstitch capture camera --from FILE --stage-view IMAGE ... makes a camera "
            "file of it"
        )
    if content.get("format") != FORMAT:
        raise BadInput(f"{path}: not a camera file: its format is not {FORMAT!r}")
    if content.get("rotation") is None or content.get("translation_m") is None:
        raise BadInput(
            f"{path}: does not contain the position of the camera; calibrate it with --stage-view"
        )
    size, focal, middle = (
        _numbers(path, content.get(key), key, (2,))
        for key in ("image_size_px", "focal_px", "principal_point_px")
    )
    rotation = _numbers(path, content["rotation"], "rotation", (3, 3))
    translation_m = _numbers(path, content["translation_m"], "translation_m", (3,))
    if (size < 1).any() or (size % 1 != 0).any() or (focal <= 0).any():
        raise BadInput(f"{path}: image_size_px or focal_px is not positive")
    size_px = (int(size[0]), int(size[1]))
    _check_principal_point(path, size_px, middle)
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise BadInput(f"{path}: rotation is not a rotation matrix")
    terms = content.get("distortion")
    if not isinstance(terms, dict) or set(terms) != set(DISTORTION):
        raise BadInput(f"{path}: distortion must contain {', '.join(DISTORTION)}")
    distortion = _numbers(path, [terms[name] for name in DISTORTION], "distortion", (5,))
    with np.errstate(over="ignore", invalid="ignore"):
        check_position(f"{path}: translation_m", -rotation.T @ translation_m)
    matrix = np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1.0]])
    return Camera(rotation, translation_m, matrix, *size_px, distortion)


def stated_height_error_m(path: str | os.PathLike) -> float | None:
    """Standard deviation of heights that a camera tells, if its file states one that can be."""
    uncertainty = _content(path).get("uncertainty")
    stated = uncertainty.get(HEIGHT) if isinstance(uncertainty, Mapping) else None
    return stated if isinstance(stated, float) and 0 < stated < 1 else None


def check_position(where: str, position_m: np.ndarray, hint: str = "") -> None:
    """Refuse a position (3,), in the stage's coordinates, that no camera of a bench has."""
    height_m = float(position_m[2])
    # hypot, because the square of a large number would overflow
    distance_m = math.hypot(*(position_m - AIM_M))
    if height_m <= 0:
        raise BadInput(f"{where}: the camera would be below the floor; is the image mirrored?")
    if not (_NEAREST_M <= distance_m <= _FARTHEST_M and height_m >= _LOWEST_M):
        raise BadInput(
            f"{where}: the camera would stand {distance_m:.2g} m from the middle of the track and "
            f"{100 * height_m:.2g} cm above the floor; must be {_NEAREST_M:g} to {_FARTHEST_M:g} m "
            f"and at least {100 * _LOWEST_M:g} cm{hint}"
        )


def read_foreign_lens(path: str | os.PathLike) -> Lens:
    """Return the lens in a calibration that another program wrote; BadInput if it is none.

    OpenCV's FileStorage (YAML, XML), ROS camera_info, or JSON of calibrateCamera's arrays and size.
    """
    content = _content(path)
    matrix = _foreign_numbers(path, content, _MATRIX, "camera_matrix")
    if matrix.size != 9:
        raise BadInput(f"{path}: camera_matrix must be 3x3; needed are {_NEEDED}")
    matrix = matrix.reshape(3, 3)
    (focal_x, skew, _), (below, focal_y, _), last = matrix
    if not (focal_x > 0 and focal_y > 0 and below == 0 and np.array_equal(last, [0, 0, 1])):
        raise BadInput(f"{path}: camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
    if abs(skew) > 1e-6 * focal_x:
        raise BadInput(f"{path}: camera_matrix has a skew of {skew:g}; must be 0")
    size = _size(path, content)
    _check_principal_point(path, size, matrix[:2, 2])
    return Lens(size, matrix, _distortion(path, content))


def _check_principal_point(
    path: str | os.PathLike, size_px: tuple[int, int], point_px: np.ndarray
) -> None:
    """Refuse a principal point, or a size of the image, whose x and y are swapped."""
    size = np.array(size_px, dtype=np.float64)
    off, swapped = (np.abs(one / size - 0.5).max() for one in (point_px, point_px[::-1]))
    if off > _OFF_CENTRE and swapped < min(_OFF_CENTRE, off / 2):
        x, y = point_px
        raise BadInput(
            f"{path}: the principal point is ({x:g}, {y:g}) in an image of {size_px[0]}x"
            f"{size_px[1]} pixels: x and y, or width and height, are swapped"
        )


def _content(path: str | os.PathLike) -> Mapping[str, Any]:
    """What stands in a calibration of any program, with or without a byte order mark."""
    file = Path(path)
    if not file.is_file():
        raise BadInput(f"{path}: {'is a folder' if file.is_dir() else 'no such file'}")
    if file.stat().st_size > _LARGEST_FILE:
        raise BadInput(f"{path}: not a camera calibration")
    text = file.read_bytes().decode("utf-8-sig", errors="replace").strip()
    content = None
    with contextlib.suppress(ValueError, yaml.YAMLError, ElementTree.ParseError, RecursionError):
        if text.startswith("<"):
            content = _of_xml(text)
        elif text.startswith("{"):
            content = json.loads(text)
        else:
            # FileStorage writes a directive and tags that are none of YAML's.
            plain = re.sub(r"^%YAML.*$", "", text, flags=re.M).replace("!!opencv-matrix", "")
            content = next(iter(yaml.safe_load_all(plain)), None)
    if not isinstance(content, Mapping):
        raise BadInput(
            f"{path}: damaged, or no camera calibration (YAML, XML, JSON); needed are {_NEEDED}"
        )
    return content


def _of_xml(text: str) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("declarations are not read")
    found: dict[str, Any] = {}
    for node in ElementTree.fromstring(text):
        data = node.find("data")
        found[node.tag] = ((node.text if data is None else data.text) or "").split()
    return found


def _numbers(
    path: str | os.PathLike, value: Any, title: str, shape: tuple[int, ...] | None = None
) -> np.ndarray:
    """An array of a file, of a shape, or else flat."""
    if value is None:
        raise BadInput(f"{path}: no {title!r}")
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput(f"{path}: {title} must contain numbers") from None
    if not np.isfinite(array).all() or shape not in (None, array.shape):
        size = f"{'x'.join(map(str, shape))} " if shape else ""
        raise BadInput(f"{path}: {title} must contain {size}finite numbers")
    return array if shape else array.ravel()


def _value(content: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """The entry of one of these names, the first of them that is there; None if none is."""
    by_name = {re.sub(r"[^a-z]", "", str(key).lower()): value for key, value in content.items()}
    return next((by_name[name] for name in names if by_name.get(name) is not None), None)


def _foreign_numbers(
    path: str | os.PathLike, content: Mapping[str, Any], names: tuple[str, ...], title: str
) -> np.ndarray:
    value = _value(content, names)
    if value is None:
        raise BadInput(f"{path}: no {title}; needed are {_NEEDED}")
    return _numbers(path, value.get("data") if isinstance(value, Mapping) else value, title)


def _size(path: str | os.PathLike, content: Mapping[str, Any]) -> tuple[int, int]:
    names = (_SIZE,) if _value(content, _SIZE) is not None else (_WIDTH, _HEIGHT)
    if any(_value(content, one) is None for one in names):
        raise BadInput(f"{path}: no image_width and image_height; add them, in pixels")
    size = np.concatenate([_foreign_numbers(path, content, one, "image_size") for one in names])
    if size.shape != (2,) or (size < 1).any() or (size % 1 != 0).any():
        raise BadInput(f"{path}: the size of the image must be two whole numbers: width, height")
    return int(size[0]), int(size[1])


def _distortion(path: str | os.PathLike, content: Mapping[str, Any]) -> np.ndarray:
    """k1, k2, p1, p2, k3; what is not given is 0."""
    model = str(_value(content, ("distortionmodel", "cameramodel", "model")) or "").lower()
    if "fisheye" in model or "equidistant" in model:
        raise BadInput(f"{path}: a fisheye lens; only k1, k2, p1, p2, k3 (plumb_bob) are read")
    found = _foreign_numbers(path, content, _DISTORTION, "distortion_coefficients")
    if len(found) not in (0, 4, 5, 8, 12, 14):
        raise BadInput(f"{path}: {len(found)} distortion_coefficients; must be 4 or 5")
    if np.any(found[5:]):
        raise BadInput(
            f"{path}: {len(found)} distortion_coefficients; only k1, k2, p1, p2, k3 are read: "
            "calibrate without the rational, thin prism and tilted models"
        )
    return np.pad(found, (0, max(5 - len(found), 0)))[:5]
