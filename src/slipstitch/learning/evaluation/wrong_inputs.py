"""Invalid videos, derived from valid ones, to test the alarm of an instrument.

``viewpoint`` comes with the dataset, where it has others than the instrument's; the rest is made.
"""

import numpy as np

from slipstitch.dataset.probes import ever_cloth

OBJECT_SHARE = 0.45  # side of the foreign object, in shares of the image


def wrong_inputs(videos: np.ndarray) -> dict[str, np.ndarray]:
    """Kind -> videos of that kind, as many as given.

    reversed     the frames in reverse order
    protocol     the first half of the motion only, at half the speed
    frozen       the first frame all along
    shuffled     the frames in random order
    empty        the scene without cloth
    object       the empty scene with a rigid chequered box in place of the cloth
    upside_down  the camera turned over

    Parameters
    ----------
    videos : ndarray of uint8, shape (n, frames, side, side, 3)
    """
    random = np.random.default_rng(0)
    count = videos.shape[1]
    empty = _empty(videos, random)
    return {
        "reversed": videos[:, ::-1],
        "protocol": videos[:, np.arange(count) // 2],
        "frozen": np.repeat(videos[:, :1], count, axis=1),
        "shuffled": np.stack([video[random.permutation(count)] for video in videos]),
        "empty": empty,
        "object": _with_box(empty),
        "upside_down": videos[:, :, ::-1],
    }


def _empty(videos: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The scene: its pixels' medians, where no cloth ever is, drawn along the rows elsewhere.

    The cloth is the coloured part, the rest of a rendering is grey. Every frame gets the camera's
    noise of one grey level.
    """
    images = videos.reshape(-1, *videos.shape[2:])
    covered = ever_cloth(images)
    scene = np.median(images, axis=0)
    places = np.arange(scene.shape[1])
    for row, cover in zip(scene, covered, strict=True):
        if cover.any() and not cover.all():
            for colour in range(3):
                row[cover, colour] = np.interp(places[cover], places[~cover], row[~cover, colour])
    return np.clip(scene + random.normal(0.0, 1.0, videos.shape), 0, 255).astype(np.uint8)


def _with_box(empty: np.ndarray) -> np.ndarray:
    """A chequered box in the middle of every frame, where the crop keeps what the stage holds."""
    side = empty.shape[2]
    low, high = (round(side * (1 + sign * OBJECT_SHARE) / 2) for sign in (-1, 1))
    y, x = np.indices((high - low, high - low))
    squares = ((x // 4 + y // 4) % 2)[..., None]
    result = empty.copy()
    result[:, :, low:high, low:high] = np.where(squares, (200, 60, 40), (230, 220, 200))
    return result
