"""The frames of a video used by the networks."""

import numpy as np

from slipstitch.base.errors import BadInput


def sampled_frames(frames_total: int, frames_sampled: int) -> np.ndarray:
    """Numbers of the frames at regular intervals, the first frame included.

    Frame k of n sampled is ``floor(k frames_total / n)``: where n divides the total (the paper's 30
    of 300) the interval is exactly regular, otherwise it differs by one frame at most. BadInput if
    a number is not positive or more frames are asked for than there are.

    Returns
    -------
    ndarray of int64, shape (frames_sampled,)
        Strictly increasing, starts with 0.
    """
    if not 1 <= frames_sampled <= frames_total:
        raise BadInput(
            f"{frames_sampled} frames cannot be sampled of {frames_total}: "
            "must be at least 1 and at most the number of frames"
        )
    return np.arange(frames_sampled, dtype=np.int64) * frames_total // frames_sampled
