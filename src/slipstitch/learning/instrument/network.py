"""The instrument's network: a distribution of mu and the fabric from the frames of a video.

    frame --> convolutions of stride 2, features shifted in time between them
          --> a few channels of the last map with their position --> features
    features --> keypoints: places of nine points of the cloth --> features (if it goes through
          them)
    features of all frames --> bidirectional GRU --> attention over frames --> heads

The shift in time is that of Lin, Gan & Han (TSM, 2019): an eighth of the channels comes from the
frame before, an eighth from the frame after. It costs nothing and lets convolutions see motion.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from slipstitch.base.errors import BadInput
from slipstitch.config.train import InstrumentSettings
from slipstitch.images.camera import KEYPOINTS_UV, POSE
from slipstitch.learning.instrument.distribution import friction_grid

POSITION_CHANNELS = 16  # of the last feature map, flattened with their positions
RECURRENT_UNITS = 96  # in each direction
COMPONENTS = 3  # of the normal mixture for mu
SHARE_SHIFTED = 8  # one channel in so many, either way


class _TimeShift(torch.autograd.Function):
    """The shift and its transpose, without leaving the memory's order (channels last).

    Written out because torch's own derivative of slicing and joining turns the gradients to
    channels first, after which the rectifiers' derivative takes four times as long.
    """

    @staticmethod
    def forward(context, maps: Tensor, frames: int) -> Tensor:
        context.frames = frames
        return _TimeShift.moved(maps, frames, 1)

    @staticmethod
    def backward(context, gradient: Tensor) -> tuple[Tensor, None]:
        return _TimeShift.moved(gradient, context.frames, -1), None

    @staticmethod
    def moved(maps: Tensor, frames: int, sign: int) -> Tensor:
        """Maps whose first channels come from `sign` frames before, the next from after."""
        result = maps.clone(memory_format=torch.channels_last)
        count = maps.shape[1] // SHARE_SHIFTED
        source = maps.unflatten(0, (-1, frames))
        target = result.unflatten(0, (-1, frames))
        for channels, step in ((slice(count), sign), (slice(count, 2 * count), -sign)):
            if step > 0:
                target[:, 1:, channels] = source[:, :-1, channels]
                target[:, 0, channels] = 0
            else:
                target[:, :-1, channels] = source[:, 1:, channels]
                target[:, -1, channels] = 0
        return result


def shifted_in_time(maps: Tensor, frames: int) -> Tensor:
    """Maps (videos * frames, C, H, W): some channels from the frame before, some from the next."""
    return _TimeShift.apply(maps, frames)


class InstrumentNetwork(nn.Module):
    """Mixture of mu, material logits, order logit, attention weights of the frames."""

    grid: Tensor
    points_mean_m: Tensor
    points_spread_m: Tensor

    def __init__(self, settings: InstrumentSettings, materials: int, pixels: int):
        super().__init__()
        self.settings, self.pixels = settings, pixels
        side, inputs = pixels, 3
        self.convolutions = nn.ModuleList()
        self.multiply_accumulates = 0
        for outputs in settings.channels:
            self.convolutions.append(nn.Conv2d(inputs, outputs, 3, stride=2, padding=1))
            side = (side + 1) // 2
            self.multiply_accumulates += 9 * inputs * outputs * side**2
            inputs = outputs
        if side < 2:
            raise BadInput(
                f"{pixels} pixels are too few for {len(settings.channels)} convolutions of stride 2"
            )
        self.place = nn.Conv2d(inputs, POSITION_CHANNELS, 1)
        self.frame_features = nn.Sequential(
            nn.Linear(POSITION_CHANNELS * side**2, settings.features),
            nn.LayerNorm(settings.features),
            nn.GELU(),
            nn.Dropout(settings.dropout),
        )
        self.pose = None
        if settings.knows_pose:
            self.pose = nn.Linear(len(POSE), settings.features, bias=False)
        self.points = self.of_points = None
        if settings.points_weight:
            self.points = nn.Linear(settings.features, 3 * len(KEYPOINTS_UV))
            # Of the videos that train, by coordinate: the unit of their places in the network.
            self.register_buffer("points_mean_m", torch.zeros(len(KEYPOINTS_UV), 3))
            self.register_buffer("points_spread_m", torch.ones(len(KEYPOINTS_UV), 3))
        if settings.through_points:
            self.of_points = nn.Sequential(
                nn.Linear(3 * len(KEYPOINTS_UV), settings.features), nn.GELU()
            )
        units = RECURRENT_UNITS
        self.recurrent = nn.GRU(settings.features, units, batch_first=True, bidirectional=True)
        self.attention = nn.Linear(2 * units, 1)
        self.friction = nn.Sequential(
            nn.Linear(2 * units, units), nn.GELU(), nn.Linear(units, 3 * COMPONENTS)
        )
        self.material = nn.Linear(2 * units, materials)
        self.order = nn.Linear(2 * units, 1)
        self._initialise()
        self.convolutions.to(memory_format=torch.channels_last)
        grid = torch.from_numpy(friction_grid(settings.friction_max))
        self.register_buffer("grid", grid.float(), persistent=False)

    def _initialise(self) -> None:
        """He's variances; the mixture's means spread over the grid, its deviations wide."""
        if self.place.weight.is_meta:  # shapes alone; drawing them would load torch's compiler
            return
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        count, largest = COMPONENTS, self.settings.friction_max
        last = self.friction[-1]
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias[:count] = 0.0
            last.bias[count : 2 * count] = (torch.arange(count) + 0.5) / count * largest
            last.bias[2 * count :] = torch.tensor(0.2 * largest).log()

    @property
    def middles(self) -> Tensor:
        """Middles between the grid's points, where the cumulative distribution is wanted."""
        return (self.grid[1:] + self.grid[:-1]) / 2

    def forward(
        self, frames: Tensor, bfloat16: bool = False, poses: Tensor | None = None
    ) -> dict[str, Tensor]:
        """Answers for a batch of standardised frames (videos, frames, pixels, pixels, 3).

        With `bfloat16` the convolutions compute in bfloat16. Poses (videos, 4) as `poses.scaled`
        gives them are used if the network knows poses; by default the calibrated one. Returns
        ``friction`` (n, 3, components), see `mixture_cumulative`; logits ``material`` (n,
        materials) and ``order`` (n,); ``attention_weights`` (n, frames), sum 1; ``embedding`` (n, 2
        * `RECURRENT_UNITS`); ``points`` (n, frames, points, 3) in the network's unit, if the
        network learns them.
        """
        videos, count = frames.shape[:2]
        maps = frames.flatten(0, 1).permute(0, 3, 1, 2)  # NHWC in memory: channels last
        with torch.autocast(maps.device.type, torch.bfloat16, enabled=bfloat16):
            for number, convolution in enumerate(self.convolutions):
                if number:
                    maps = shifted_in_time(maps, count)
                maps = convolution(maps).relu_()
            maps = self.place(maps)
        features = self.frame_features(maps.float().flatten(1)).view(videos, count, -1)
        if self.pose is not None and poses is not None:
            features = features + self.pose(poses)[:, None]
        if self.points is None:
            return self._answers(features)
        points = self.points(features).unflatten(-1, (-1, 3))
        if self.of_points is None:
            return {**self._answers(features), "points": points}
        # Friction does not teach where the points are: it would be told by heart through them.
        return {**self.of_keypoints(points.detach()), "points": points}

    def keypoints_m(self, points: Tensor) -> Tensor:
        """Places in metres of points in the network's unit, as `forward` returns them."""
        return self.points_mean_m + self.points_spread_m * points

    def in_unit(self, points_m: Tensor) -> Tensor:
        """Places in the network's unit of points in metres."""
        return (points_m - self.points_mean_m) / self.points_spread_m

    def of_keypoints(self, points: Tensor) -> dict[str, Tensor]:
        """Answers from places (videos, frames, points, 3), of a network that goes through them."""
        assert self.of_points is not None
        return self._answers(self.of_points(points.flatten(2)))

    def _answers(self, features: Tensor) -> dict[str, Tensor]:
        """Answers from the features (videos, frames, features) of the frames."""
        states, _ = self.recurrent(features)
        attention_weights = self.attention(states)[..., 0].softmax(1)
        embedding = (states * attention_weights[..., None]).sum(1)
        raw = self.friction(embedding).unflatten(1, (3, -1))
        # Deviations between a third of the grid's step and its length.
        smallest = torch.log(self.grid[1] / 3)
        spread = raw[:, 2].clamp(smallest, torch.log(self.grid[-1]))
        return {
            "friction": torch.stack([raw[:, 0], raw[:, 1], spread], dim=1),
            "material": self.material(embedding),
            "order": self.order(embedding)[..., 0],
            "attention_weights": attention_weights,
            "embedding": embedding,
        }


KEYPOINT_SPREAD_MIN_M = 1e-3
# The unit of the loss of places: in that of their spread, tails count little.
KEYPOINT_ERROR_M = 0.005


def set_unit_of_keypoints(network: InstrumentNetwork, points_m: Tensor) -> None:
    """Give the network its unit of places, from those that train, (n, frames, points, 3)."""
    known_m = points_m.double()
    mean_m = known_m.mean((0, 1))
    spread_m = (known_m - mean_m).abs().mean((0, 1)).clamp(min=KEYPOINT_SPREAD_MIN_M)
    network.points_mean_m.copy_(mean_m)
    network.points_spread_m.copy_(spread_m)


def keypoint_errors(network: InstrumentNetwork, differences: Tensor) -> Tensor:
    """Distances along the axes of places (..., points, 3), in units of `KEYPOINT_ERROR_M`.

    In metres: the tail, which moves most and tells friction, weighs as a point that hardly moves.
    """
    return differences.abs() * (network.points_spread_m / KEYPOINT_ERROR_M)


def next_frictions(rows: Sequence[dict[str, Any]], training: np.ndarray) -> np.ndarray:
    """For every video, one of the same cloth at the next larger coefficient, or itself.

    Of videos that train, and only where one of the two lies between simulations: there a cloth
    changes smoothly with the coefficient, so that places between theirs are a cloth's too.
    """
    result = np.arange(len(rows))
    of_cloth: dict[tuple[str, str], list[int]] = {}
    for number in np.flatnonzero(training):
        cloth = rows[number]["material_id"], rows[number]["replicate_id"]
        of_cloth.setdefault(cloth, []).append(int(number))
    for numbers in of_cloth.values():
        numbers.sort(key=lambda number: rows[number]["friction"])
        for place, number in enumerate(numbers):
            larger = numbers[place + 1 :]
            friction = rows[number]["friction"]
            other = next((one for one in larger if rows[one]["friction"] > friction), number)
            if rows[number].get("interpolated") or rows[other].get("interpolated"):
                result[number] = other
    return result


def noisy_keypoints(
    points: Tensor, spread_m: Tensor, noise_m: float, generator: np.random.Generator
) -> Tensor:
    """Places (n, frames, points, 3) in the network's unit as they might be found in images.

    Shifted as a whole, as by a calibration's error; each point; each point in every frame.
    """
    videos, _, count, axes = points.shape
    shapes = (videos, 1, 1, axes), (videos, 1, count, axes), points.shape
    noise = sum(generator.standard_normal(shape, np.float32) for shape in shapes)
    return points + noise_m * torch.from_numpy(noise) / spread_m
