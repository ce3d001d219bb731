"""Lenses calibrated elsewhere: OpenCV's YAML, XML and JSON, ROS camera_info, calibrateCamera's.

All of them say the same in other words: a matrix of three by three, distortion coefficients, and
the size of the image. What the lens model here cannot express is refused.
"""

import contextlib
import json
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from slipstitch.base.errors import BadInput
from slipstitch.images.camera import Lens

# Names in lower case, letters only.
_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsics", "matrix", "mtx", "k", "m")
_DISTORTION = (
    "distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoefs", "distortion", "dist",
    "d",
)  # fmt: skip
_SIZE = ("imagesize", "imagesizepx", "imageshape", "resolution", "size")
_WIDTH, _HEIGHT = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
_LARGEST_FILE = 1_000_000
# A principal point this far from the middle, as a share of the image, is not one.
_OFF_CENTRE = 0.15
NEEDED = "camera_matrix (3x3), distortion_coefficients, image_width and image_height"


def looks_foreign(path: str | os.PathLike) -> bool:
    """Whether a file is a camera calibration of another program."""
    with contextlib.suppress(BadInput, OSError):
        return _value(_content(path), _MATRIX) is not None
    return False


def read_foreign_lens(path: str | os.PathLike) -> Lens:
    """Return the lens in a calibration that another program wrote.

    Parameters
    ----------
    path : path
        YAML or XML of OpenCV's FileStorage, ROS camera_info (a file or a printed message), or JSON
        with the arrays that calibrateCamera returns and the size of the image.

    Raises
    ------
    BadInput
        If the file is none of these, or has a lens of another model.
    """
    content = _content(path)
    matrix = _array(path, content, _MATRIX, "camera_matrix")
    if matrix.size != 9:
        raise BadInput(f"{path}: camera_matrix must be 3x3; needed are {NEEDED}")
    matrix = matrix.reshape(3, 3)
    (focal_x, skew, _), (below, focal_y, _), last = matrix
    if not (focal_x > 0 and focal_y > 0 and below == 0 and np.array_equal(last, [0, 0, 1])):
        raise BadInput(f"{path}: camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
    if abs(skew) > 1e-6 * focal_x:
        raise BadInput(f"{path}: camera_matrix has a skew of {skew:g}; must be 0")
    size = _size(path, content)
    check_principal_point(path, size, matrix[:2, 2])
    return Lens(size, matrix, _distortion(path, content))


def check_principal_point(
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
        raise BadInput(f"{path}: not a camera calibration (YAML, XML or JSON); needed are {NEEDED}")
    return content


def _of_xml(text: str) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("declarations are not read")
    found: dict[str, Any] = {}
    for node in ElementTree.fromstring(text):
        data = node.find("data")
        found[node.tag] = ((node.text if data is None else data.text) or "").split()
    return found


def _value(content: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """The entry of one of these names, the first of them that is there; None if none is."""
    by_name = {re.sub(r"[^a-z]", "", str(key).lower()): value for key, value in content.items()}
    return next((by_name[name] for name in names if by_name.get(name) is not None), None)


def _array(
    path: str | os.PathLike, content: Mapping[str, Any], names: tuple[str, ...], title: str
) -> np.ndarray:
    value = _value(content, names)
    if value is None:
        raise BadInput(f"{path}: no {title}; needed are {NEEDED}")
    value = value.get("data") if isinstance(value, Mapping) else value
    try:
        array = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise BadInput(f"{path}: {title} must contain numbers") from None
    if not np.isfinite(array).all():
        raise BadInput(f"{path}: {title} must contain finite numbers")
    return array


def _size(path: str | os.PathLike, content: Mapping[str, Any]) -> tuple[int, int]:
    if _value(content, _SIZE) is not None:
        size = _array(path, content, _SIZE, "image_size")
    elif _value(content, _WIDTH) is None or _value(content, _HEIGHT) is None:
        raise BadInput(f"{path}: no image_width and image_height; add them, in pixels")
    else:
        of = zip((_WIDTH, _HEIGHT), ("image_width", "image_height"), strict=True)
        size = np.concatenate([_array(path, content, *names) for names in of])
    if size.shape != (2,) or (size < 1).any() or (size % 1 != 0).any():
        raise BadInput(f"{path}: the size of the image must be two whole numbers: width, height")
    return int(size[0]), int(size[1])


def _distortion(path: str | os.PathLike, content: Mapping[str, Any]) -> np.ndarray:
    """k1, k2, p1, p2, k3; what is not given is 0."""
    model = str(_value(content, ("distortionmodel", "cameramodel", "model")) or "").lower()
    if "fisheye" in model or "equidistant" in model:
        raise BadInput(f"{path}: a fisheye lens; only k1, k2, p1, p2, k3 (plumb_bob) are read")
    found = _array(path, content, _DISTORTION, "distortion_coefficients")
    if len(found) not in (0, 4, 5, 8, 12, 14):
        raise BadInput(f"{path}: {len(found)} distortion_coefficients; must be 4 or 5")
    if np.any(found[5:]):
        raise BadInput(
            f"{path}: {len(found)} distortion_coefficients; only k1, k2, p1, p2, k3 are read: "
            "calibrate without the rational, thin prism and tilted models"
        )
    return np.pad(found, (0, max(5 - len(found), 0)))[:5]
