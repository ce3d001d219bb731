"""Predictions of trained networks."""

import numpy as np
import torch
from torch import nn

from slipstitch.base.errors import BadInput
from slipstitch.dataset.videos import Videos
from slipstitch.learning.model_file import TrainedModel
from slipstitch.learning.network import class_probabilities


def predict(
    network: nn.Module,
    pixels: np.ndarray,
    condition: np.ndarray | None = None,
    *,
    bfloat16: bool = False,
    batch_size: int = 8,
) -> np.ndarray:
    """Class probabilities of videos.

    Parameters
    ----------
    network : nn.Module
        As `build_network` makes it.
    pixels : ndarray of uint8, shape (n, frames, side, side, 3)
    condition : ndarray of int64, shape (n,), optional
        Material class numbers for a conditional network.

    Returns
    -------
    ndarray of float64, shape (n, classes)
    """
    network.eval()
    parts = []
    with torch.inference_mode():
        for first in range(0, len(pixels), batch_size):
            batch = slice(first, first + batch_size)
            given = None if condition is None else torch.from_numpy(condition[batch])
            logits = network(torch.from_numpy(pixels[batch]), given, bfloat16)
            parts.append(class_probabilities(logits.double()))
    return torch.cat(parts).numpy()


def predicted_materials(model: TrainedModel, videos: Videos, batch_size: int = 8) -> np.ndarray:
    """Material class numbers as the material network sees them, int64 of shape (n,)."""
    probabilities = predict(
        model.network, videos.pixels, bfloat16=model.card["bfloat16"], batch_size=batch_size
    )
    return probabilities.argmax(1)


def check_material_model(model: TrainedModel, split: str, seed: int, digest: str) -> None:
    """Refuse a material network that is not of the same data, split and seed."""
    expected = {
        "network": "material_baseline",
        "split": split,
        "seed": seed,
        "dataset_digest": digest,
    }
    for key, value in expected.items():
        if model.card[key] != value:
            raise BadInput(
                f"the material model has {key} {model.card[key]!r}, {value!r} is needed: "
                "the friction network must be conditioned on predictions for the same data"
            )
