"""Irrelevant variation between videos: applied in training, and averaged over in prediction.

Exposure and the cast of colours need no augmentation: every video's colours are standardised.
"""

import cv2
import numpy as np
import torch
from torch import Tensor

from slipstitch.config.train import InstrumentSettings

BLUR_PX = 0.7  # largest standard deviation
NOISE = 0.1  # largest, in standard deviations of the video
EVERY = 4  # every so many rows and columns count in a video's mean and deviation


def standardised(videos: np.ndarray) -> Tensor:
    """Colours of uint8 videos (n, frames, side, side, 3) minus their mean, over their deviation."""
    some = videos[:, :, ::EVERY, ::EVERY].astype(np.float32)
    mean = some.mean((1, 2, 3), keepdims=True)
    deviation = np.maximum(some.std((1, 2, 3), keepdims=True), 1.0)
    colours = torch.from_numpy(np.ascontiguousarray(videos)).float()
    return colours.sub_(torch.from_numpy(mean)).mul_(torch.from_numpy(1.0 / deviation))


def rectified_with_errors(frame: np.ndarray, corners_px: np.ndarray, blur_px: float) -> np.ndarray:
    """A uint8 image (side, side, 3) as a rectification gives it that puts the corners elsewhere.

    `corners_px` (3, 2): how far, across and down, the upper left, upper right and lower left corner
    move. The border is repeated; a Gaussian of `blur_px` (0: none) comes before.
    """
    last = frame.shape[1] - 1
    corners = np.array([[0, 0], [last, 0], [0, last]], np.float32)
    affine = cv2.getAffineTransform(corners, corners + corners_px.astype(np.float32))
    if blur_px > 0:
        frame = cv2.GaussianBlur(frame, (5, 5), blur_px)
    return cv2.warpAffine(frame, affine, frame.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)


def augmented(
    videos: np.ndarray, settings: InstrumentSettings, generator: np.random.Generator
) -> Tensor:
    """Standardised uint8 videos, rectified with errors, their colours in another order, and noisy.

    Errors as of a calibration, blur of another lens, colours of another lamp: the same in all
    frames. The noise is one random field that moves on by a row a frame: a tenth of the cost of
    every pixel.
    """
    frames, side = videos.shape[1:3]
    reach = settings.rectification_error * side
    moved = np.empty_like(videos)
    for video, result in zip(videos, moved, strict=True):
        corners = generator.uniform(-reach, reach, (3, 2))
        blur = BLUR_PX * generator.random()
        source = np.stack([generator.permutation(3), np.arange(3)], axis=1).ravel().tolist()
        for frame, target in zip(video, result, strict=True):
            seen = rectified_with_errors(frame, corners, blur)
            cv2.mixChannels([seen], [target], source)
    result = standardised(moved)
    for video in result:
        size = NOISE * float(generator.random())
        grain = generator.standard_normal((side + frames) * side * 3, np.float32) * size
        strip = torch.from_numpy(grain).view(side + frames, side, 3)
        video += strip.unfold(0, side, 1).permute(0, 3, 1, 2)[:frames]
    return result


def phase_frames(count: int, total: int, frames: int, generator: np.random.Generator) -> np.ndarray:
    """Which `frames` of the `total` of each of `count` videos train, from a drawn phase on."""
    spare = -(-total // frames)  # phases that differ
    starts = generator.integers(spare, size=count) / spare
    return ((np.arange(frames)[None] + starts[:, None]) * total / frames).astype(np.int64)


def disordered(video: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A video reversed, frozen, halves exchanged, shuffled, or the first half at half speed."""
    count = len(video)
    straight = np.arange(count)
    orders = (
        straight[::-1],
        np.full(count, generator.integers(count)),
        np.roll(straight, count // 2),
        generator.permutation(count),
        straight // 2,
    )
    return video[orders[generator.integers(len(orders))]]
