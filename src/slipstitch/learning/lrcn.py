"""The paper's network: a convolutional one for every frame, a recurrent one over the frames.

Rasheed et al., "Learning to Measure the Static Friction Coefficient in Cloth Contact", CVPR 2020,
Table 1: an LRCN (Donahue et al. 2015). What the paper leaves open is decided here, as trials on
validation videos had it: borders are padded; every convolution is batch-normalised before its
rectifier, and so are the features of the frames; the last map is averaged over the image; the class
is read after the last frame; a told material has as many softmax outputs as there are materials.

    frame --> conv1a, conv1b, pool, conv2a, conv2b, pool, conv3a, pool, conv4a --> features
    material --> FC_s, softmax --> beside the features of every frame
    features of all frames --> LSTM --> LSTM --> FC, dropout, FC --> softmax

`LRCN` are the layers, `LrcnModel` is what is stored and predicts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor, nn

from slipstitch.base.errors import BadInput, first_line
from slipstitch.config.train import TrainSettings
from slipstitch.dataset.videos import Videos
from slipstitch.learning.model_file import read_weights, write_weights
from slipstitch.learning.prediction import Prediction, labels_of

LSTM_LAYERS = 2
# At width 1: of each LSTM layer, and of the first fully connected one, before whose output dropout.
UNITS, DROPOUT = 256, 0.2


def scaled(size: int, width: float) -> int:
    """Return a layer's size at a relative width, at least 1."""
    return max(1, round(size * width))


class _Bfloat16Gradient(torch.autograd.Function):
    """A 3 x 3 convolution in float32 that derives in bfloat16.

    Rounding the values to bfloat16 makes rectifiers and poolings choose other pixels, and the
    gradient is then that of another function: cosine 0.992 ... 0.997 to the one in float32 where a
    batch normalisation follows. The derivative itself is linear in what comes back, and its
    roundings average out: cosine 0.99999, at half of float32's cost for two thirds of the work.
    """

    @staticmethod
    def forward(context, maps: Tensor, weight: Tensor, padding) -> Tensor:
        context.save_for_backward(maps.bfloat16(), weight.bfloat16())
        context.padding = padding
        return nn.functional.conv2d(maps, weight, padding=padding)

    @staticmethod
    def backward(context, gradient: Tensor) -> tuple[Tensor | None, ...]:
        maps, weight = context.saved_tensors
        wanted = [*context.needs_input_grad[:2], False]
        by_maps, by_weight, _ = torch.ops.aten.convolution_backward(
            gradient.bfloat16(), maps, weight, None, [1, 1], context.padding, [1, 1], False, [0, 0],
            1, wanted,
        )  # fmt: skip
        return (None if by_maps is None else by_maps.float()), by_weight.float(), None


class Convolution(nn.Conv2d):
    """A convolution of stride 1, without bias, that can use bfloat16."""

    def forward(self, maps: Tensor, bfloat16: bool = False) -> Tensor:
        """Convolve maps (n, channels, height, width); `bfloat16` derives, or computes, in it."""
        if not bfloat16:
            return super().forward(maps)
        if torch.is_grad_enabled():
            return _Bfloat16Gradient.apply(maps, self.weight, self.padding)
        return self._conv_forward(maps.bfloat16(), self.weight.bfloat16(), None)


class ConvolutionBlock(nn.Sequential):
    """3 x 3 convolutions a, b, ... with rectifiers, then 3 x 3 max pooling of stride 2, or none.

    The last rectifier comes after the pooling, with which it commutes, on a quarter of the pixels.
    """

    def __init__(self, inputs: int, outputs: int, convolutions: int, pool: bool):
        layers: list[nn.Module] = []
        for number in range(convolutions):
            layers.append(Convolution(inputs, outputs, 3, padding=1, bias=False))
            layers.append(nn.BatchNorm2d(outputs))
            if pool and number == convolutions - 1:
                layers.append(nn.MaxPool2d(3, stride=2, padding=1))
            layers.append(nn.ReLU(inplace=True))
            inputs = outputs
        super().__init__(*layers)

    def forward(self, maps: Tensor, bfloat16: bool = False) -> Tensor:
        """Return maps of half the side, if they are pooled; `bfloat16` as in `Convolution`."""
        for layer in self:
            maps = layer(maps, bfloat16) if isinstance(layer, Convolution) else layer(maps)
        return maps


class LRCN(nn.Module):
    """Classes from the frames of a video, of a conditional network told one of the materials."""

    def __init__(
        self, settings: TrainSettings, classes: int, pixels: int, condition_classes: int = 0
    ):
        super().__init__()
        self.settings = settings
        self.condition_classes = condition_classes
        # Colour statistics of the training set; part of the model, not learnt.
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(3))

        blocks, channels, side, self.multiply_accumulates = [], 3, pixels, 0
        last = len(settings.channels) - 1
        for number, (size, convolutions) in enumerate(
            zip(settings.channels, settings.convolutions, strict=True)
        ):
            outputs = scaled(size, settings.width)
            pool = number < last
            blocks.append(ConvolutionBlock(channels, outputs, convolutions, pool))
            for _ in range(convolutions):
                self.multiply_accumulates += 9 * channels * outputs * side**2
                channels = outputs
            if pool:
                side = (side + 1) // 2
        self.convolutions = nn.Sequential(*blocks)
        self.feature_norm = nn.BatchNorm1d(channels)
        if condition_classes:
            self.material = nn.Sequential(
                nn.Linear(condition_classes, condition_classes), nn.Softmax(-1)
            )
        units = scaled(UNITS, settings.width)
        self.lstm = nn.LSTM(channels + condition_classes, units, LSTM_LAYERS, batch_first=True)
        self.fully_connected = nn.Sequential(
            nn.Linear(units, units), nn.ReLU(), nn.Dropout(DROPOUT), nn.Linear(units, classes)
        )
        self.initialise()
        # Channels last: two to three times faster in bfloat16 on CPUs.
        self.convolutions.to(memory_format=torch.channels_last)

    def initialise(self) -> None:
        """Draw the weights anew, as `settings.initialisation` says, from torch's generator.

        he: normal (He et al. 2015); glorot: uniform, as Keras; both give the LSTM Keras' defaults:
        Glorot input, orthogonal recurrent weights, forget bias 1. pytorch: uniform within 1 /
        sqrt(fan in).
        """
        kind = self.settings.initialisation
        if kind == "pytorch":
            return
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.Linear):
                if kind == "he":
                    nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                else:
                    nn.init.xavier_uniform_(module.weight)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        units = self.lstm.hidden_size
        for of_input, recurrent, bias, second_bias in self.lstm.all_weights:
            for gate in range(4):  # input, forget, cell, output; each a matrix of its own
                rows = slice(gate * units, (gate + 1) * units)
                with torch.no_grad():
                    nn.init.xavier_uniform_(of_input[rows])
                    nn.init.orthogonal_(recurrent[rows])
            nn.init.zeros_(bias)
            nn.init.zeros_(second_bias)
            with torch.no_grad():
                bias[units : 2 * units] = 1.0

    def forward(
        self, frames: Tensor, condition: Tensor | None = None, bfloat16: bool = False
    ) -> Tensor:
        """Return the logits (videos, classes) of uint8 frames (videos, frames, pixels, pixels, 3).

        The condition is class numbers of materials; `bfloat16` is for the convolutions alone.
        """
        videos, count = frames.shape[:2]
        maps = self._standardised(frames).permute(0, 3, 1, 2)  # NHWC in memory: channels last
        for block in self.convolutions:
            maps = block(maps, bfloat16)
        features = self.feature_norm(maps.float().mean((2, 3))).view(videos, count, -1)
        if self.condition_classes:
            one_hot = nn.functional.one_hot(condition, self.condition_classes).float()
            told = self.material(one_hot)[:, None].expand(-1, count, -1)
            features = torch.cat([told, features], dim=2)
        states, _ = self.lstm(features)
        return self.fully_connected(states[:, -1])

    def _standardised(self, frames: Tensor) -> Tensor:
        """Images (n, side, side, 3) from bytes; whole rows at a time, three numbers are slow."""
        side = frames.shape[2]
        rows = frames.reshape(-1, side, side * 3).float()
        rows = rows.sub_(self.mean.repeat(side)).div_(self.deviation.repeat(side))
        return rows.view(-1, side, side, 3)


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

    def sees(self, row: Mapping[str, Any]) -> bool:
        """Return whether the model predicts for the video of a manifest row."""
        others = self.card["viewpoints"][1:] if self.calibrated_view_alone else []
        return row["viewpoint"] not in others

    def probabilities(self, videos: Videos, batch_size: int = 8) -> np.ndarray:
        """Return the class probabilities of videos, float64 of shape (n, classes)."""
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

    def predict(self, videos: Videos) -> list[Prediction]:
        """Return a prediction for every video."""
        every = self.probabilities(videos)
        if self.card["target"] == "material":
            names = [of_class["name"] for of_class in self.card["classes"]]
            return [
                Prediction(material_probabilities=dict(zip(names, shares.tolist(), strict=True)))
                for shares in every
            ]
        values = np.array([of_class["value"] for of_class in self.card["classes"]])
        return [Prediction(float(values[shares.argmax()]), (values, shares)) for shares in every]

    def check_is_material_network_of(self, split: str, seed: int, digest: str) -> None:
        """Refuse a network that is not the material network of this split, seed and dataset."""
        network = "material_baseline"
        expected = {"network": network, "split": split, "seed": seed, "dataset_digest": digest}
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
    """Return class probabilities (n, classes) of videos, by class numbers of the materials told."""
    network.eval()
    parts = []
    with torch.inference_mode():
        for first in range(0, len(pixels), batch_size):
            batch = slice(first, first + batch_size)
            given = None if condition is None else torch.from_numpy(condition[batch])
            logits = network(torch.from_numpy(pixels[batch]), given, bfloat16)
            parts.append(logits.double().softmax(-1))
    return torch.cat(parts).numpy()


def save_model(
    weights: dict[str, torch.Tensor], card: dict[str, Any], folder: str | Path
) -> dict[str, Any]:
    """Write ``model.safetensors`` and ``model.json``; return the card as written."""
    card = {"format": FORMAT, **card}
    return write_weights(weights, card, Path(folder) / WEIGHTS, Path(folder) / CARD)


def load_model(folder: str | Path) -> LrcnModel:
    """Read a network that `save_model` wrote; BadInput if it is not as it was written."""
    weights, card_path = Path(folder) / WEIGHTS, Path(folder) / CARD
    tensors, card = read_weights(weights, card_path, FORMAT)
    try:
        settings = TrainSettings.model_validate(card["settings"])
        network = LRCN(
            settings, len(card["classes"]), card["pixels"], len(card["condition_classes"])
        )
        network.load_state_dict(tensors)
    except (ValidationError, RuntimeError, KeyError) as error:
        raise BadInput(f"{weights}: weights do not match the card: {first_line(error)}") from None
    network.eval()
    return LrcnModel(network, card)
