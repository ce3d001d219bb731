"""Detection of videos outside the training distribution.

Four scores, larger for stranger videos:

appearance   distance of the video, as thumbnails in time, from the subspace that training videos
             span (principal components): another viewpoint, an empty scene, another object
combination  Mahalanobis distance within that subspace: known pieces put together in a new way
features     Mahalanobis distance of the network's embedding
order        logit of "frames in disorder" that the network learnt on videos reversed, frozen,
             stretched or shuffled

Each is put on the scale of held-out training-like videos (median and spread), and the largest
counts. Its threshold is conformal over simulations (`distribution.grouped_quantile`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from slipstitch.learning.instrument.distribution import grouped_quantile

SCORES = ("appearance", "combination", "features", "order")
REASONS = {
    "appearance": "the images differ from those of the training videos (viewpoint, object, scene?)",
    "combination": "the motion differs from that in all training videos (protocol, object?)",
    "features": "the video is outside the training distribution",
    "order": "the order of the frames does not match the protocol (reversed, cut, stretched?)",
}
THUMBNAIL = 12  # side, in pixels
EXPLAINED = 0.9  # share of the variance that the principal components hold


def thumbnails(videos: np.ndarray) -> np.ndarray:
    """Videos as grey thumbnails of mean 0 and deviation 1, float32 (n, frames * 144)."""
    n, frames, side = videos.shape[:3]
    edges = np.arange(THUMBNAIL + 1) * side // THUMBNAIL
    grey = np.empty((n, frames, THUMBNAIL, THUMBNAIL), np.float32)
    for number, video in enumerate(videos):
        image = video.mean(-1, dtype=np.float32)
        rows = np.add.reduceat(image, edges[:-1], axis=1)
        cells = np.add.reduceat(rows, edges[:-1], axis=2)
        grey[number] = cells / np.outer(np.diff(edges), np.diff(edges))
    flat = grey.reshape(n, -1)
    deviation = np.maximum(flat.std(1, keepdims=True), 1.0)
    return (flat - flat.mean(1, keepdims=True)) / deviation


@dataclass(frozen=True)
class Alarm:
    """Statistics of the training videos, and the thresholds of the alarm."""

    mean: np.ndarray  # (frames * 144,)
    components: np.ndarray  # (K, frames * 144)
    variances: np.ndarray  # (K,)
    embedding_mean: np.ndarray  # (N * E,): of the embeddings of N networks, one after another
    embedding_whitening: np.ndarray  # (N * E, E): each network's own, one below another
    # (4,): median and spread of each score on held-out videos
    centre: np.ndarray = field(default_factory=lambda: np.zeros(len(SCORES)))
    scale: np.ndarray = field(default_factory=lambda: np.ones(len(SCORES)))
    threshold: float = 0.0  # of the largest scaled score

    def raw(self, videos: np.ndarray, embedding: np.ndarray, order: np.ndarray) -> np.ndarray:
        """The four scores (n, 4) of uint8 frames, embeddings (n, N * E), logits of order (n,)."""
        away = thumbnails(videos) - self.mean
        inside = away @ self.components.T
        rest = np.maximum((away**2).sum(1) - (inside**2).sum(1), 0.0)
        size = self.embedding_whitening.shape[1]
        of_each = (embedding - self.embedding_mean).reshape(len(embedding), -1, size)
        white = of_each.swapaxes(0, 1) @ self.embedding_whitening.reshape(-1, size, size)
        return np.stack(
            [
                np.sqrt(rest / away.shape[1]),
                np.sqrt((inside**2 / self.variances).mean(1)),
                np.sqrt((white**2).mean((0, 2))),
                -order,
            ],
            axis=1,
        ).astype(np.float64)

    def scaled(self, raw: np.ndarray) -> np.ndarray:
        """Scores in spreads of held-out videos, shape (n, 4)."""
        return (raw - self.centre) / self.scale

    def reason(self, raw: np.ndarray) -> str:
        """Why one video (scores of shape (4,)) is strange; empty if it is not."""
        scaled = self.scaled(raw)
        if np.isfinite(scaled).all() and scaled.max() <= self.threshold:
            return ""
        worst = SCORES[int(np.nan_to_num(scaled, nan=math.inf).argmax())]
        return REASONS[worst]

    def calibrated(self, raw: np.ndarray, groups: Sequence[str], false_alarms: float) -> "Alarm":
        """The alarm with the threshold that so large a share of videos like those held out exceeds.

        From their scores (n, 4); groups are simulations. If these are too few: their largest score.
        """
        centre = np.median(raw, axis=0)
        scale = np.maximum(1.4826 * np.median(abs(raw - centre), axis=0), 1e-6)
        largest = ((raw - centre) / scale).max(1)
        threshold = grouped_quantile(largest, groups, 1.0 - false_alarms)
        if not math.isfinite(threshold):
            threshold = float(largest.max())
        return replace(self, centre=centre, scale=scale, threshold=threshold)


def describe(videos: np.ndarray, embedding: np.ndarray) -> Alarm:
    """An alarm that scores videos by those that train, and knows no threshold yet."""
    vectors = thumbnails(videos)
    mean = vectors.mean(0)
    _, sizes, axes = np.linalg.svd(vectors - mean, full_matrices=False)
    variances = sizes**2 / max(1, len(vectors) - 1)
    share = np.cumsum(variances) / variances.sum()
    count = int(np.searchsorted(share, EXPLAINED)) + 1
    covariance = np.cov(embedding.T.astype(np.float64))
    diagonal = np.diag(np.diag(covariance) + 1e-8)
    values, vectors_e = np.linalg.eigh(0.9 * covariance + 0.1 * diagonal)
    whitening = vectors_e / np.sqrt(values)
    return Alarm(mean, axes[:count], variances[:count], embedding.mean(0), whitening)
