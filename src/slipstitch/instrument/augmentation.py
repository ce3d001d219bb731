"""What may differ between videos without meaning anything: put into training, and averaged over.

Exposure and the cast of colours need no augmentation: every video's colours are standardised.
"""

import numpy as np
import torch
from torch import Tensor

from slipstitch.instrument.settings import InstrumentSettings

EVERY = 4  # every so many rows and columns count in a video's mean and deviation


def standardised(videos: np.ndarray) -> Tensor:
    """Colours minus the video's mean, over its deviation; so exposure and colour cast are gone.

    Parameters
    ----------
    videos : ndarray of uint8, shape (n, frames, side, side, 3)

    Returns
    -------
    float32 tensor, same shape
    """
    some = videos[:, :, ::EVERY, ::EVERY].astype(np.float32)
    mean = some.mean((1, 2, 3), keepdims=True)
    deviation = np.maximum(some.std((1, 2, 3), keepdims=True), 1.0)
    colours = torch.from_numpy(np.ascontiguousarray(videos)).float()
    return colours.sub_(torch.from_numpy(mean)).mul_(torch.from_numpy(1.0 / deviation))


def augmented(
    videos: np.ndarray, settings: InstrumentSettings, generator: np.random.Generator
) -> Tensor:
    """Standardised videos, each with its colours in another order, moved a little, and noisy.

    The order of the colours is that of another lamp or dye; the move that of a crop that does not
    sit as in training (the border is repeated); the noise is one field of random numbers that
    moves on by a row from frame to frame, which costs a tenth of drawing every pixel.

    Parameters
    ----------
    videos : ndarray of uint8, shape (n, frames, side, side, 3)

    Returns
    -------
    float32 tensor, same shape
    """
    frames, side = videos.shape[1:3]
    reach = round(settings.shift_share * side)
    moved = np.empty_like(videos)
    for number, video in enumerate(videos):
        down, across = generator.integers(-reach, reach + 1, 2)
        rows = np.clip(np.arange(side) + down, 0, side - 1)
        columns = np.clip(np.arange(side) + across, 0, side - 1)
        order = generator.permutation(3)
        pixels = (columns[:, None] * 3 + order).ravel()
        np.take(
            video.reshape(frames, side, -1)[:, rows],
            pixels,
            axis=2,
            out=moved[number].reshape(frames, side, -1),
        )
    result = standardised(moved)
    for video in result:
        size = settings.noise * float(generator.random())
        grain = generator.standard_normal((side + frames) * side * 3, np.float32) * size
        strip = torch.from_numpy(grain).view(side + frames, side, 3)
        video += strip.unfold(0, side, 1).permute(0, 3, 1, 2)[:frames]
    return result


def phased(videos: np.ndarray, frames: int, generator: np.random.Generator | None) -> np.ndarray:
    """`frames` of each video at regular intervals, from a phase within the first interval.

    Parameters
    ----------
    videos : ndarray of uint8, shape (n, F, side, side, 3), F >= frames
    frames : int
    generator : numpy Generator or None
        Draws each video's phase; without, all begin with the first frame.

    Returns
    -------
    ndarray of uint8, shape (n, frames, side, side, 3)
    """
    total = videos.shape[1]
    spare = -(-total // frames)  # phases that differ
    starts = (
        np.zeros(len(videos))
        if generator is None
        else generator.integers(spare, size=len(videos)) / spare
    )
    places = ((np.arange(frames)[None] + starts[:, None]) * total / frames).astype(np.int64)
    return videos[np.arange(len(videos))[:, None], places]


def disordered(video: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A video whose frames do not follow one another as they should.

    By chance: reversed; frozen at one frame; halves exchanged; shuffled; the first half at half
    speed, as from a stage that moves slower.

    Parameters
    ----------
    video : ndarray, shape (frames, side, side, 3)
    """
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
