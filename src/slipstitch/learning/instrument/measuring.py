"""The instrument: from the frames of a video to mu, its error bar, the fabric and the alarm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.special import ndtri, softmax

from slipstitch.base.errors import BadInput, first_line
from slipstitch.config.train import InstrumentSettings, split_of
from slipstitch.dataset.videos import Videos, resized
from slipstitch.design.grid import sampled_frames
from slipstitch.images.camera import POSE
from slipstitch.learning.instrument.alarm import Alarm
from slipstitch.learning.instrument.augmentation import augmented
from slipstitch.learning.instrument.distribution import (
    conformal_intervals,
    conformal_scales,
    friction_grid,
    least_groups,
    mixture_cumulative,
    probabilities_on_grid,
    spread,
)
from slipstitch.learning.instrument.network import InstrumentNetwork
from slipstitch.learning.instrument.poses import poses_of, scaled
from slipstitch.learning.model_file import read_weights, write_weights
from slipstitch.learning.prediction import Prediction

FORMAT = "slipstitch-instrument-3"
WEIGHTS = "instrument.safetensors"
CARD = "instrument.json"
ALARM = "alarm."
NETWORKS_MAX = 16
COVERAGE = 0.9  # of intervals: pages, columns and combined intervals say 90 %
HALF_WIDTH = float(ndtri((1 + COVERAGE) / 2))  # standard deviations, of a normal distribution
NOT_CALIBRATED = "the instrument is not calibrated: its errors are unknown"


@dataclass(frozen=True)
class Answers:
    """Uncalibrated answers for n videos, averaged over views and networks; all embeddings."""

    probabilities: np.ndarray
    material_logits: np.ndarray
    order: np.ndarray
    attention_weights: np.ndarray
    embedding: np.ndarray
    points_m: np.ndarray | None = None


@dataclass(frozen=True)
class ErrorBars:
    """Calibration on held-out simulations."""

    spread: float  # by which the distributions are spread about their medians
    material_temperature: float  # by which the fabrics' logits are divided
    # by which half-intervals are multiplied; infinite: too few simulations to promise anything
    conformal_scale: float
    alarm: Alarm


@dataclass(frozen=True)
class Instrument:
    """One network, or several that are averaged, with its card and, once calibrated, error bars.

    Networks that differ only in their seed err in part independently: their mean errs less than
    one of them (deep ensembles: Lakshminarayanan, Pritzel & Blundell 2017, arXiv 1612.01474).
    """

    # at least one; trained on the same videos with the same settings
    networks: tuple[InstrumentNetwork, ...]
    card: dict[str, Any]
    error_bars: ErrorBars | None

    @property
    def settings(self) -> InstrumentSettings:
        """As it was trained."""
        return self.networks[0].settings

    @property
    def grid(self) -> np.ndarray:
        """Grid of mu, float64 of shape (G,)."""
        # Not the network's, whose end is 1.29999995 in float32 where a truth of 1.3 may lie.
        return friction_grid(self.settings.friction_max)

    def answers(
        self, videos: np.ndarray, generator: np.random.Generator, poses: np.ndarray
    ) -> Answers:
        """Uncalibrated answers for uint8 videos (n, frames, pixels, pixels, 3) and poses (n, 4)."""
        for network in self.networks:
            network.eval()
        parts = []
        with torch.inference_mode():
            for video, pose in zip(videos, scaled(poses), strict=True):
                repeated = np.repeat(video[None], self.settings.draws, axis=0)
                views = augmented(repeated, self.settings, generator)
                poses_told = pose.expand(self.settings.draws, -1)
                of_each = [
                    _answer(network, network(views, self.card["bfloat16"], poses_told))
                    for network in self.networks
                ]
                told_of = {name: [answer[name] for answer in of_each] for name in of_each[0]}
                embedding = np.concatenate(told_of.pop("embedding"))
                means = {name: np.mean(answers, axis=0) for name, answers in told_of.items()}
                parts.append(means | {"embedding": embedding})
        return Answers(**{name: np.stack([part[name] for part in parts]) for name in parts[0]})

    def distributions(self, probabilities: np.ndarray) -> np.ndarray:
        """Calibrated distributions on the grid, from those of uncalibrated answers, (n, G)."""
        bars = self.error_bars
        return spread(probabilities, self.grid, bars.spread if bars else 1.0)

    def intervals(self, distributions: np.ndarray) -> np.ndarray:
        """Median, lower and upper end of the intervals, shape (n, 3)."""
        return conformal_intervals(distributions, self.grid, COVERAGE, self.conformal_scale)

    def needed_scale(self, distributions: np.ndarray, friction: np.ndarray) -> np.ndarray:
        """Return the scale at which each interval would just hold its truth, shape (n,)."""
        unscaled = conformal_intervals(distributions, self.grid, COVERAGE, 1.0)
        return conformal_scales(unscaled, friction)

    @property
    def conformal_scale(self) -> float:
        """Return by what the half-intervals are multiplied; infinite without error bars."""
        return self.error_bars.conformal_scale if self.error_bars else math.inf

    @property
    def without_error_bar(self) -> str:
        """Why intervals are the whole grid, as they are then; empty where they are not."""
        if math.isfinite(self.conformal_scale):
            return ""
        groups = self.card.get("calibration_simulations", 0)
        of_them = f"{groups} simulation{'' if groups == 1 else 's'}"
        return f"no error bar: calibrated on {of_them}; {least_groups(COVERAGE)} are needed"

    @property
    def caveats(self) -> list[str]:
        """What an error bar of this instrument does not cover."""
        if split_of(self.card.get("split", "")) != "by_video":
            return []
        return [
            "the instrument was trained with the split by video: other videos of the simulations "
            "that calibrate its error bars trained it; expect larger errors than the interval says"
        ]

    def measure(self, frames: np.ndarray, pose: np.ndarray | None = None) -> Prediction:
        """Measure one video; BadInput if the array is of another shape or type.

        Parameters
        ----------
        frames : ndarray of uint8, shape (frames, height, width, 3)
            RGB, at regular intervals from the start of the stage's motion, square, cropped as the
            training images are. Resized to the network's side where they differ.
        pose : ndarray, shape (4,), optional
            How the camera stands (`slipstitch.images.camera.POSE`); as calibrated by default.
        """
        video = self._fitted(frames)[None]
        poses = np.zeros((1, len(POSE))) if pose is None else np.asarray(pose)[None]
        # Always the same augmented views.
        answers = self.answers(video, np.random.default_rng(0), poses)
        distribution = self.distributions(answers.probabilities)
        median, low, high = self.intervals(distribution)[0]
        bars = self.error_bars
        logits = answers.material_logits[0] / (bars.material_temperature if bars else 1.0)
        reason = NOT_CALIBRATED
        if bars:
            scores = bars.alarm.raw(video, answers.embedding, answers.order)
            reason = bars.alarm.reason(scores[0])
        return Prediction(
            friction_coefficient=float(median),
            distribution=(self.grid, distribution[0]),
            interval_90=(float(low), float(high)),
            material_probabilities=dict(
                zip(self.card["materials"], softmax(logits).tolist(), strict=True)
            ),
            alarm=bool(reason),
            alarm_reason=reason,
            attention_weights=answers.attention_weights[0],
            points_m=None if answers.points_m is None else answers.points_m[0],
        )

    def sees(self, row: Mapping[str, Any]) -> bool:
        """Return whether the model predicts for the video of a manifest row.

        Whoever knows the camera's pose learnt from rectified images: of the calibrated viewpoint
        too, but of turned ones, which test, only where they are rectified.
        """
        if self.settings.knows_pose:
            return row["viewpoint"] in (*self.card["viewpoints"], "calibrated")
        return row["viewpoint"] in self.card["viewpoints"] or row["viewpoint_role"] == "test"

    def predict(self, videos: Videos) -> list[Prediction]:
        """Return a prediction for every video, each with the same augmented views as any other."""
        seen = self.frames_of(videos)
        return [
            self.measure(video, pose=pose)
            for video, pose in zip(seen.pixels, poses_of(seen.rows), strict=True)
        ]

    def frames_of(self, videos: Videos) -> Videos:
        """Return the videos with the frames that the network sees, from the first on."""
        kept = sampled_frames(videos.pixels.shape[1], self.card["frames"])
        return Videos(videos.rows, videos.pixels.take(kept, axis=1), videos.digest)

    def _fitted(self, frames: np.ndarray) -> np.ndarray:
        """The frames at the network's size; BadInput if they are no such frames."""
        shape, kind = np.shape(frames), getattr(frames, "dtype", type(frames))
        wanted = (self.card["frames"], *2 * shape[1:2], 3)
        if kind != np.uint8 or shape != wanted or shape[1] < 8:
            need = f"uint8 of shape ({self.card['frames']}, side, side, 3) is required"
            raise BadInput(f"the frames are {kind} of shape {shape}: {need}")
        side = self.networks[0].pixels
        return resized(frames, side)


def check_fits(
    videos: Videos, frames: int, settings: InstrumentSettings, dataset: str | Path
) -> None:
    """Refuse videos with fewer frames, or larger coefficients, than an instrument is for."""
    stored = videos.pixels.shape[1]
    if stored < frames:
        raise BadInput(f"{dataset}: videos have {stored} frames; the instrument requires {frames}")
    largest = max(row["friction"] for row in videos.rows)
    if largest > settings.friction_max:
        raise BadInput(
            f"{dataset}: friction {largest:g} is above the grid's end, {settings.friction_max:g} "
            "(instrument.friction_max)"
        )


def _answer(network: InstrumentNetwork, outputs: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """What a network says of a video, averaged over its augmented views: fields of `Answers`."""
    # In float64: in float32 a distribution's tail would end at five deviations.
    cumulative = mixture_cumulative(outputs["friction"].double(), network.middles.double())
    answer = {
        "probabilities": probabilities_on_grid(cumulative.numpy()).mean(0),
        "material_logits": outputs["material"].double().mean(0).numpy(),
    }
    for name in ("order", "attention_weights", "embedding"):
        answer[name] = outputs[name].double().mean(0).numpy()
    if network.points is not None:
        answer["points_m"] = network.keypoints_m(outputs["points"]).mean(0).numpy()
    return answer


def save_instrument(instrument: Instrument, folder: str | Path) -> dict[str, Any]:
    """Write ``instrument.safetensors`` and ``instrument.json``; the card as written."""
    networks = instrument.networks
    tensors = {
        prefix + name: value
        for prefix, network in zip(_prefixes(len(networks)), networks, strict=True)
        for name, value in network.state_dict().items()
    }
    card = {"format": FORMAT, **instrument.card, "error_bars": None}
    bars = instrument.error_bars
    if bars:
        card["error_bars"] = {
            "spread": bars.spread,
            "material_temperature": bars.material_temperature,
            "factor": bars.conformal_scale if math.isfinite(bars.conformal_scale) else None,
            "alarm_threshold": bars.alarm.threshold,
        }
        for field in fields(Alarm):
            if field.name != "threshold":
                tensors[ALARM + field.name] = torch.from_numpy(getattr(bars.alarm, field.name))
    if len(networks) > 1:
        tensors = {name: halved(value) for name, value in tensors.items()}
    return write_weights(tensors, card, Path(folder) / WEIGHTS, Path(folder) / CARD)


def halved(value: torch.Tensor) -> torch.Tensor:
    """Matrices in float16, so that several networks take the space of two; the rest as it is."""
    return value.half() if value.ndim > 1 else value


def restored(value: torch.Tensor) -> torch.Tensor:
    """What `halved` gave, in float32."""
    return value.float() if value.dtype == torch.float16 else value


def _prefixes(count: int) -> list[str]:
    """Of the names of each network's tensors, of so many."""
    return [""] if count == 1 else [f"{number}." for number in range(count)]


class _Card(BaseModel):
    """The entries of a card required to build and use the network."""

    model_config = ConfigDict(strict=True)

    settings: InstrumentSettings = Field(strict=False)
    materials: list[str] = Field(min_length=1)
    pixels: int = Field(ge=8, le=1024)
    frames: int = Field(ge=1, le=10_000)
    bfloat16: bool
    networks: int = Field(1, ge=1, le=NETWORKS_MAX)


def load_instrument(path: str | Path) -> Instrument:
    """Read what `save_instrument` wrote, from its folder or one of its files; else BadInput."""
    given = Path(path)
    folder = given.parent if given.name in (WEIGHTS, CARD) else given
    weights = folder / WEIGHTS
    tensors, card = read_weights(weights, folder / CARD, FORMAT)
    try:
        known = _Card.model_validate(card)
        arguments = (known.settings, len(known.materials), known.pixels)
        learnt = {
            name: restored(value) for name, value in tensors.items() if not name.startswith(ALARM)
        }
        with torch.device("meta"):  # no memory yet for what a card claims
            shapes = InstrumentNetwork(*arguments).state_dict()
        prefixes = _prefixes(known.networks)
        if {
            prefix + name: value.shape for prefix in prefixes for name, value in shapes.items()
        } != {name: value.shape for name, value in learnt.items()}:
            raise BadInput(f"{weights}: weights do not match the card: different sizes")
        networks = tuple(InstrumentNetwork(*arguments).eval() for _ in prefixes)
        for prefix, network in zip(prefixes, networks, strict=True):
            network.load_state_dict({name: learnt[prefix + name] for name in shapes})
        noted = card["error_bars"]
        bars = None
        if noted is not None:
            arrays = {
                name.removeprefix(ALARM): restored(value).numpy()
                for name, value in tensors.items()
                if name.startswith(ALARM)
            }
            bars = ErrorBars(
                noted["spread"],
                noted["material_temperature"],
                math.inf if noted["factor"] is None else noted["factor"],
                Alarm(**arrays, threshold=noted["alarm_threshold"]),
            )
    except (ValidationError, RuntimeError, KeyError, TypeError) as error:
        raise BadInput(f"{weights}: weights do not match the card: {first_line(error)}") from None
    inside = {key: value for key, value in card.items() if key != "error_bars"}
    return Instrument(networks, inside, bars)
