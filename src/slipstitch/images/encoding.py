"""From linear light to 8-bit images: sRGB, PNG, and what a camera does to the light.

Camera effects are what networks must be invariant to: seeded, drawn once per video. In the order of
a camera: exposure and colour cast scale the light; the sensor adds shot and read noise; the image
is encoded, and compressed. Loads neither Blender nor kernels.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import check_image
from slipstitch.config.render import AugmentationSettings
from slipstitch.images.surroundings import drawn_by, generator


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """8-bit sRGB of linear light (IEC 61966-2-1), cut off at 0 and 1."""
    # In steps of 2^-16 the encoding moves by less than 0.06 of an 8-bit level.
    steps = np.rint(np.clip(linear, 0, 1) * (len(_SRGB) - 1)).astype(np.int64)
    return _SRGB[steps]


def decode_srgb(encoded: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in 0 ... 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


#: Linear light of each 8-bit sRGB level.
LINEAR = decode_srgb(np.arange(256) / 255).astype(np.float32)
_STEPS = np.linspace(0, 1, 2**16 + 1)
_ENCODED = np.where(_STEPS <= 0.0031308, 12.92 * _STEPS, 1.055 * _STEPS ** (1 / 2.4) - 0.055)
_SRGB = np.rint(255 * _ENCODED).astype(np.uint8)


def encode_png(image: np.ndarray) -> bytes:
    """PNG file of an RGB image (H, W, 3) uint8."""
    # Level 3 is twice as fast as libpng's default for files a few percent larger.
    good, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not good:
        raise RuntimeError("OpenCV could not encode a PNG")
    return data.tobytes()


def decode_image(data: bytes, where: str, how: int = cv2.IMREAD_COLOR) -> np.ndarray:
    """An image file's content as OpenCV reads it, blue first (H, W, 3) uint8; else BadInput."""
    check_image(data, where)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), how)
    if image is None:
        raise BadInput(f"{where}: not an image that OpenCV can read")
    return image


# The read noise of a sensor, as a share of the shot noise at full white.
_READ_NOISE = 0.1


@dataclass(frozen=True)
class CameraEffects:
    """What one video's camera does to the light."""

    exposure_stops: float = 0.0
    # factors of the light; green stays
    red: float = 1.0
    blue: float = 1.0
    noise: float = 0.0  # standard deviation of the noise at full white, in linear light
    jpeg_quality: int = 100  # 100 for images that are not compressed

    def light(self, linear: np.ndarray) -> np.ndarray:
        """Linear light (..., 3) as this camera exposes it."""
        if (self.exposure_stops, self.red, self.blue) == (0.0, 1.0, 1.0):
            return linear
        return linear * (2**self.exposure_stops * np.array([self.red, 1.0, self.blue]))

    def photograph(self, linear: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The image (H, W, 3) uint8 that this camera makes of linear light (H, W, 3)."""
        linear = self.light(linear)
        if self.noise > 0:
            # Photons are counted: their variance is in proportion to the light.
            spread = np.sqrt(np.clip(linear, 0, None) + _READ_NOISE**2)
            linear = linear + self.noise * spread * rng.standard_normal(linear.shape)
        image = encode_srgb(linear)
        if self.jpeg_quality == 100:
            return image
        quality = [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality]
        good, data = cv2.imencode(".jpg", image[..., ::-1], quality)
        if not good:
            raise RuntimeError("OpenCV could not encode a JPEG")
        return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])


def draw_camera_effects(
    settings: AugmentationSettings, seed: int, simulation: str, texture: str, viewpoint: str
) -> CameraEffects:
    """The camera of one video: by its bench (`drawn_by`), texture and viewpoint."""
    rng = generator(seed, drawn_by(simulation, viewpoint), texture, viewpoint, "augmentation")
    exposure, red, blue = rng.uniform(-1, 1, 3)
    noise, compression = rng.uniform(0, 1, 2)
    return CameraEffects(
        float(exposure * settings.exposure_stops),
        float(1 + red * settings.colour_cast),
        float(1 + blue * settings.colour_cast),
        float(noise * settings.noise),
        round(100 - compression * (100 - settings.jpeg_quality)),
    )
