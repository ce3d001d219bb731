"""8-bit images: linear light to sRGB and back, PNG. Loads neither Blender nor kernels."""

import cv2
import numpy as np


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light (IEC 61966-2-1), cut off at 0 and 1."""
    # In steps of 2^-16 the encoding moves by less than 0.06 of an 8-bit level.
    steps = np.rint(np.clip(linear, 0, 1) * (len(_SRGB) - 1)).astype(np.int64)
    return _SRGB[steps]


def _srgb_table() -> np.ndarray:
    linear = np.linspace(0, 1, 2**16 + 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def _linear_table() -> np.ndarray:
    encoded = np.arange(256) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


_SRGB = _srgb_table()
#: Linear light of each 8-bit sRGB level.
LINEAR = _linear_table()


def encode_png(image: np.ndarray) -> bytes:
    """PNG file of an RGB image (H, W, 3) uint8."""
    # Level 3 is twice as fast as libpng's default for files a few percent larger.
    good, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not good:
        raise RuntimeError("OpenCV could not encode a PNG")
    return data.tobytes()
