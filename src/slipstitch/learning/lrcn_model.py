"""The paper's networks as models: files and predictions."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError

from slipstitch.base.errors import BadInput, first_line
from slipstitch.config.train import NETWORKS, TRAINED_ON, TrainSettings
from slipstitch.dataset.videos import Videos
from slipstitch.learning.classes import labels_of
from slipstitch.learning.lrcn import LRCN
from slipstitch.learning.model_file import read_weights, write_weights
from slipstitch.learning.prediction import Prediction

FORMAT = "slipstitch-lrcn-2"
WEIGHTS = "model.safetensors"
CARD = "model.json"
#: Folder, in a model's own, of the network before fine-tuning.
ALL_VIEWS = "all_views"
#: Instead of a material network: the videos' true materials.
TRUE = "true materials"


@dataclass(frozen=True)
class LrcnModel:
    """A network with its weights, its card and, if it is conditional, its material network."""

    network: LRCN
    card: dict[str, Any]
    material: "LrcnModel | None" = None  # of a conditional network
    # whether another network predicts for the other training views
    calibrated_view_alone: bool = False

    @property
    def target(self) -> str:
        """Return the kind of the classes: material or friction."""
        return self.card["target"]

    def listening_to(self, material: "LrcnModel") -> "LrcnModel":
        """Return the conditional network with its material network."""
        return dataclasses.replace(self, material=material)

    def sees(self, row: Mapping[str, Any]) -> bool:
        """Return whether the model predicts for the video of a manifest row."""
        others = self.card["viewpoints"][1:] if self.calibrated_view_alone else []
        return row["viewpoint"] not in others

    def probabilities(self, videos: Videos, batch_size: int = 8) -> np.ndarray:
        """Return the class probabilities of videos, float64 of shape (n, classes).

        The frames are those that the network trained on, at its size.
        """
        card, condition = self.card, None
        if self.material is not None:
            condition = self.material.probabilities(videos, batch_size).argmax(1)
        elif card["condition_classes"]:
            condition = labels_of(videos.rows, card["condition_classes"], "material")
        return class_probabilities(
            self.network,
            videos.seen_with(card["pixels"], card["frames"]).pixels,
            condition,
            bfloat16=card["bfloat16"],
            batch_size=batch_size,
        )

    def predict(self, videos: Videos, batch_size: int = 8) -> list[Prediction]:
        """Return a prediction for every video."""
        every = self.probabilities(videos, batch_size)
        if self.target == "material":
            names = [of_class["name"] for of_class in self.card["classes"]]
            return [
                Prediction(material_probabilities=dict(zip(names, shares.tolist(), strict=True)))
                for shares in every
            ]
        values = np.array([of_class["value"] for of_class in self.card["classes"]])
        return [Prediction(float(values[shares.argmax()]), (values, shares)) for shares in every]

    def check_is_material_network_of(self, split: str, seed: int, digest: str) -> None:
        """Refuse a network that is not the material network of this split, seed and dataset."""
        expected = {
            "network": "material_baseline",
            "split": split,
            "seed": seed,
            "dataset_digest": digest,
        }
        for key, value in expected.items():
            if self.card[key] != value:
                raise BadInput(
                    f"the material model has {key} {self.card[key]!r}, {value!r} is needed: "
                    "the friction network must be conditioned on predictions for the same data"
                )


def class_probabilities(
    network: LRCN,
    pixels: np.ndarray,
    condition: np.ndarray | None = None,
    *,
    bfloat16: bool = False,
    batch_size: int = 8,
) -> np.ndarray:
    """Return the class probabilities (n, classes) of uint8 videos (n, frames, side, side, 3).

    A conditional network is told the material class numbers (n,).
    """
    network.eval()
    parts = []
    with torch.inference_mode():
        for first in range(0, len(pixels), batch_size):
            batch = slice(first, first + batch_size)
            given = None if condition is None else torch.from_numpy(condition[batch])
            logits = network(torch.from_numpy(pixels[batch]), given, bfloat16)
            parts.append(logits.double().softmax(-1))
    return torch.cat(parts).numpy()


def save_model(network: LRCN, card: dict[str, Any], folder: str | Path) -> dict[str, Any]:
    """Write ``model.safetensors`` and ``model.json``; return the card as written."""
    return write_weights(
        network.state_dict(),
        {"format": FORMAT, **card},
        Path(folder) / WEIGHTS,
        Path(folder) / CARD,
    )


def load_model(folder: str | Path) -> LrcnModel:
    """Read a network that `save_model` wrote.

    BadInput if a file is missing, is of another kind, or is not as it was written.
    """
    weights, card_path = Path(folder) / WEIGHTS, Path(folder) / CARD
    tensors, card = read_weights(weights, card_path, FORMAT)
    try:
        if card["network"] not in NETWORKS or card["split"] not in TRAINED_ON:
            raise BadInput(f"{card_path}: unknown network {card['network']!r} or split")
        settings = TrainSettings.model_validate(card["settings"])
        network = LRCN(
            settings, len(card["classes"]), card["pixels"], len(card["condition_classes"])
        )
        network.load_state_dict(tensors)
    except (ValidationError, RuntimeError, KeyError) as error:
        raise BadInput(f"{weights}: weights do not match the card: {first_line(error)}") from None
    network.eval()
    return LrcnModel(network, card)
