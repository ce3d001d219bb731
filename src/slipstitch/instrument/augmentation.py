"""What may differ between videos without meaning anything: put into training, and averaged over.

Exposure and the cast of colours need no augmentation: every video's colours are standardised.
"""

import numpy as np
import torch
from torch import Tensor

from slipstitch.instrument.settings import InstrumentSettings

EVERY = 2  # every so many pixels count in a video's mean and deviation


def standardised(videos: Tensor) -> Tensor:
    """Colours minus the video's mean, over its deviation; so exposure and colour cast are gone.

    Parameters
    ----------
    videos : uint8 tensor, shape (n, frames, side, side, 3)

    Returns
    -------
    float32 tensor, same shape
    """
    colours = videos.float()
    some = colours[:, :, ::EVERY, ::EVERY]
    mean = some.mean((1, 2, 3), keepdim=True)
    deviation = some.std((1, 2, 3), keepdim=True).clamp(min=1.0)
    return (colours - mean) / deviation


def augmented(
    videos: Tensor, settings: InstrumentSettings, generator: np.random.Generator
) -> Tensor:
    """Standardised videos, each with its colours in another order, moved a little, and noisy.

    The order of the colours is that of another lamp or dye; the move that of a crop that does not
    sit as in training (the border is repeated); noise is drawn once for all frames' rows shifted
    from frame to frame, which costs a tenth of drawing every pixel.
    """
    n, frames, side = videos.shape[:3]
    reach = round(settings.shift_share * side)
    result = torch.empty_like(videos)
    for number in range(n):
        video = videos[number][..., torch.from_numpy(generator.permutation(3))]
        down, across = generator.integers(-reach, reach + 1, 2) if reach else (0, 0)
        rows = (torch.arange(side) + int(down)).clamp(0, side - 1)
        columns = (torch.arange(side) + int(across)).clamp(0, side - 1)
        result[number] = video[:, rows][:, :, columns]
        if settings.noise:
            size = settings.noise * float(generator.random())
            grain = generator.standard_normal((side + frames) * side * 3, np.float32) * size
            strip = torch.from_numpy(grain).view(side + frames, side, 3)
            result[number] += strip.unfold(0, side, 1).permute(0, 3, 1, 2)[:frames]
    return result
