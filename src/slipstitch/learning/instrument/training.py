"""Training the instrument's network, then calibrating its error bars and its alarm."""

import math
from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import start_clock
from slipstitch.config.train import REFLECTIVE, InstrumentSettings
from slipstitch.dataset.videos import Videos
from slipstitch.design.grid import sampled_frames
from slipstitch.learning.instrument.augmentation import (
    augmented,
    disordered,
    phase_frames,
    standardised,
)
from slipstitch.learning.instrument.calibration import calibrated
from slipstitch.learning.instrument.distribution import (
    medians,
    mixture_cumulative,
    ranked_probability_score,
)
from slipstitch.learning.instrument.measuring import (
    CARD,
    WEIGHTS,
    Instrument,
    check_fits,
    load_instrument,
    save_instrument,
)
from slipstitch.learning.instrument.network import (
    InstrumentNetwork,
    keypoint_errors,
    next_frictions,
    noisy_keypoints,
    set_unit_of_keypoints,
)
from slipstitch.learning.instrument.poses import pose_range, poses_of, scaled
from slipstitch.learning.prediction import classes_of
from slipstitch.learning.torch_setup import set_up_torch
from slipstitch.learning.trainer import Phase, Run, Trainer, simulations

DISORDERED = 4  # for so many videos, one is also shown in disorder
WEIGHT_DECAY = 0.02  # AdamW's
# Of the losses of fabric and order, relative to that of mu: they shape features and the alarm.
MATERIAL_WEIGHT = 0.1
ORDER_WEIGHT = 0.1
# Videos a step of whose simulated keypoints, with this error (of the cloth's shift, each point's
# and each frame's), the recurrent layer learns beside images.
POINTS_VIDEOS = 32
POINTS_NOISE_M = 0.0015
UNKNOWN = -1  # number of a fabric that does not train


def _training_videos(
    settings: InstrumentSettings, run: Run, viewpoints: Sequence[str]
) -> tuple[Videos, np.ndarray]:
    """Return the videos, and which of them train; BadInput if they cannot train or calibrate."""
    videos, training = run.videos(settings.pixels, None, viewpoints)
    dataset = run.dataset
    check_fits(videos, run.frames or 0, settings, dataset)
    trained = list(compress(videos.rows, training))
    for key, least in (("material", 1), ("friction", 2)):
        found = {row[f"{key}_id"] for row in trained}
        if len(found) < least:
            raise BadInput(f"{dataset}: {len(found)} {key}(s) for training; {least} are required")
    if settings.points_weight and videos.points_m is None:
        raise BadInput(
            f"{dataset}: has no keypoints of the cloth, as instrument.points_weight "
            "requires: render and sample it again"
        )
    # A fabric may be for the error bars alone (sample.validation_materials).
    absent = [row["friction"] for row in videos.rows if row["friction_id"] not in found]
    if absent:
        raise BadInput(f"{dataset}: friction {min(absent)} has no training video")
    return videos, training


def chance_score(friction: np.ndarray) -> float:
    """Score of always saying the labels' own distribution (Gneiting & Raftery 2007, eq. 21)."""
    return float(abs(friction[:, None] - friction[None]).mean() / 2)


def losses(
    network: InstrumentNetwork,
    views: Tensor,
    friction: Tensor,
    material: Tensor,
    ordered: Tensor,
    bfloat16: bool,
    poses: Tensor | None = None,
    points: Tensor | None = None,
) -> dict[str, Tensor]:
    """Mean losses of a batch of views (n, frames, side, side, 3) whose last are in disorder.

    The first m have friction and material (m,), and places of points (m, frames, points, 3) where
    the network learns them; `ordered` (n,) is 1 for these, else 0; both kinds weigh the same.
    Returns ``friction`` (in mu), ``material``, ``order``, ``points`` (see `keypoint_errors`); and
    ``median_error``, without gradient.
    """
    outputs = network(views, bfloat16, poses)
    count, spoilt = len(friction), len(ordered) - len(friction)
    cumulative = mixture_cumulative(outputs["friction"][:count], network.middles)
    score = ranked_probability_score(cumulative, friction, network.grid).mean()
    with torch.no_grad():
        median = medians(cumulative, network.grid)
    off = torch.zeros(())
    if points is not None:
        off = keypoint_errors(network, outputs["points"][:count] - points).mean()
    return {
        "points": off,
        "friction": score,
        "material": torch.nn.functional.cross_entropy(outputs["material"][:count], material),
        "order": torch.nn.functional.binary_cross_entropy_with_logits(
            outputs["order"], ordered, weight=torch.where(ordered > 0, 1 / count, 1 / spoilt) / 2
        )
        * len(ordered),
        "median_error": (median - friction).abs().mean(),
    }


def learning_rate(settings: InstrumentSettings, done: float) -> float:
    """One cycle: up in the first tenth, then down a cosine; `done` in 0 ... 1."""
    if done < 0.1:
        return settings.learning_rate * (0.05 + 0.95 * done / 0.1)
    return settings.learning_rate * (0.505 + 0.495 * math.cos(math.pi * (done - 0.1) / 0.9))


def training_views(
    pixels: np.ndarray, frames: int, settings: InstrumentSettings, generator: np.random.Generator
) -> tuple[Tensor, Tensor, np.ndarray, np.ndarray]:
    """Augmented videos at random phase, then some of them in disorder: n views of m videos.

    Returns the views (n, frames, side, side, 3), 1 for those in order, else 0 (n,), the number
    of the video that each shows (n,), and the frames that those in order show (m, frames).
    """
    places = phase_frames(len(pixels), pixels.shape[1], frames, generator)
    videos = pixels[np.arange(len(pixels))[:, None], places]
    chosen = generator.permutation(len(videos))[: max(1, len(videos) // DISORDERED)]
    spoilt = np.stack([disordered(video, generator) for video in videos[chosen]])
    whole = np.concatenate([videos, spoilt])
    ordered = (torch.arange(len(whole)) < len(videos)).float()
    shown = np.concatenate([np.arange(len(videos)), chosen])
    return augmented(whole, settings, generator), ordered, shown, places


class InstrumentTrainer(Trainer):
    """Trains the instrument's network.

    Labels are class numbers of the fabrics, int64 of shape (n,), `UNKNOWN` of one that does not
    train; `points` the places of points in the network's unit (n, stored frames, points, 3), where
    the network learns them.
    """

    stage = "instrument"
    gradient_norm_max = 1.0
    network: InstrumentNetwork

    def __init__(
        self, network: InstrumentNetwork, frames: int, labels: Tensor, points: Tensor | None,
        viewpoints: Sequence[str], *training: Any,
    ):  # fmt: skip
        super().__init__(*training)
        settings, rows = self.settings, self.videos.rows
        self.network, self.frames, self.labels, self.points = network, frames, labels, points
        self.name = f"instrument {self.run.split} seed {self.run.seed}"
        # Twice as many videos, each shown half as often.
        epochs = -(-settings.epochs // (1 + (self.run.split == REFLECTIVE)))
        self.phases = [Phase("", tuple(viewpoints), epochs)]
        self.friction = torch.tensor([row["friction"] for row in rows])
        self.poses = scaled(poses_of(rows))
        self.next_friction = next_frictions(rows, self.training)
        self.optimizer = torch.optim.AdamW(network.parameters(), weight_decay=WEIGHT_DECAY)
        self.chance_loss = chance_score(self.friction.numpy()[self.training])
        self.diverged_hint = f"a smaller instrument.learning_rate than {settings.learning_rate:g}"
        self.plateau_hint = "instrument.epochs, instrument.learning_rate"

    def learning_rate(self, phase: Phase, epoch: int, step: int, videos: int) -> float:
        """As the function of this name, by the share of the steps that are done."""
        steps = -(-videos // self.settings.batch_size)
        return learning_rate(self.settings, (epoch + step / steps) / phase.epochs)

    def batch_loss(
        self, batch: np.ndarray, generator: np.random.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """Weighted sum of the losses; sums of the friction's score and of the median's error."""
        views, ordered, shown, places = training_views(
            self.videos.pixels[batch], self.frames, self.settings, generator
        )
        friction, labels = self.friction[batch], self.labels[batch]
        poses = self.poses[batch][shown]
        points = None if self.points is None else self.points[batch[:, None], places]
        part = losses(self.network, views, friction, labels, ordered, self.bfloat16, poses, points)
        loss = (
            part["friction"] / self.chance_loss
            + MATERIAL_WEIGHT * part["material"]
            + ORDER_WEIGHT * part["order"]
            + self.settings.points_weight * part["points"]
        )
        if self.settings.through_points:
            loss = loss + self._loss_of_keypoints(generator)
        kept = {"loss": part["friction"], "error": part["median_error"]}
        if points is not None:
            kept["points"] = part["points"]
        return loss, {f"train_{name}": one.item() * len(batch) for name, one in kept.items()}

    def _loss_of_keypoints(self, generator: np.random.Generator) -> Tensor:
        """Loss of what is read from simulated places of videos drawn at random, without images."""
        chosen = generator.choice(np.flatnonzero(self.training), POINTS_VIDEOS)
        others = self.next_friction[chosen]
        places = phase_frames(len(chosen), self.videos.pixels.shape[1], self.frames, generator)
        share = torch.from_numpy(generator.random(len(chosen), np.float32))
        friction = torch.lerp(self.friction[chosen], self.friction[others], share)
        points = torch.lerp(
            self.points[chosen[:, None], places],
            self.points[others[:, None], places],
            share[:, None, None, None],
        )
        answers = self.network.of_keypoints(
            noisy_keypoints(points, self.network.points_spread_m, POINTS_NOISE_M, generator)
        )
        cumulative = mixture_cumulative(answers["friction"], self.network.middles)
        score = ranked_probability_score(cumulative, friction, self.network.grid)
        material = torch.nn.functional.cross_entropy(answers["material"], self.labels[chosen])
        return score.mean() / self.chance_loss + MATERIAL_WEIGHT * material

    def validation(self, numbers: np.ndarray) -> dict[str, float]:
        """Loss, error and accuracy."""
        names = ["loss", "error", "accuracy"] + ["points"] * (self.points is not None)
        if not len(numbers):
            return {f"validation_{name}": math.nan for name in names}
        self.network.eval()
        parts: dict[str, list[Tensor]] = {name: [] for name in names}
        kept = sampled_frames(self.videos.pixels.shape[1], self.frames)
        with torch.inference_mode():
            for batch in np.array_split(numbers, -(-len(numbers) // 8)):
                views = standardised(self.videos.pixels[batch].take(kept, axis=1))
                outputs = self.network(views, self.bfloat16, self.poses[batch])
                cumulative = mixture_cumulative(outputs["friction"], self.network.middles)
                truth, grid, labels = self.friction[batch], self.network.grid, self.labels[batch]
                parts["loss"].append(ranked_probability_score(cumulative, truth, grid))
                parts["error"].append((medians(cumulative, grid) - truth).abs())
                right = outputs["material"].argmax(1) == labels
                parts["accuracy"].append(right[labels != UNKNOWN].float())
                if self.points is not None:
                    off = outputs["points"] - self.points[batch][:, kept]
                    parts["points"].append(keypoint_errors(self.network, off).mean((1, 2, 3)))
        return {f"validation_{name}": float(torch.cat(each).mean()) for name, each in parts.items()}

    def summary(self, row: dict[str, Any]) -> str:
        """Errors, validation loss, and share of fabrics that are right."""
        return (
            f"error {row['train_error']:.3f}, validation loss {row['validation_loss']:.4f}, "
            f"error {row['validation_error']:.3f}, material {row['validation_accuracy']:.2f}"
        )


def load_start(
    network: InstrumentNetwork, settings: InstrumentSettings, materials: list[str], seed: int
) -> str | None:
    """Give the network the weights that `settings.starts_from` names; return their file's SHA-256.

    None where it starts from drawn weights. Of other fabrics, the layer that tells them keeps those
    that were drawn. BadInput if the instrument's network has other sizes.
    """
    if settings.starts_from is None:
        return None
    before = load_instrument(Path(settings.starts_from) / WEIGHTS)
    weights = before.networks[seed % len(before.networks)].state_dict()
    if before.card["materials"] != materials:
        drawn = network.state_dict().items()
        weights |= {name: one for name, one in drawn if name.startswith("material.")}
    try:
        network.load_state_dict(weights)
    except RuntimeError:
        raise BadInput(
            f"instrument.starts_from: {settings.starts_from}: its network has other sizes than the "
            "settings instrument.channels, features, pixels, knows_pose, points_weight and "
            "through_points give"
        ) from None
    return str(before.card["weights_sha256"])


def train_instrument(
    settings: InstrumentSettings, run: Run, viewpoints: Sequence[str]
) -> dict[str, Any]:
    """Train, calibrate by the validation videos, and write an instrument; return its card."""
    started = start_clock()
    set_up_torch(run.threads)
    videos, training = _training_videos(settings, run, viewpoints)
    frames = run.frames or videos.pixels.shape[1]
    materials = classes_of(list(compress(videos.rows, training)), "material")
    numbers = {entry["id"]: number for number, entry in enumerate(materials)}
    torch.manual_seed(run.seed)
    network = InstrumentNetwork(settings, len(materials), videos.pixels.shape[2])
    started_from = load_start(network, settings, [entry["name"] for entry in materials], run.seed)
    labels = torch.tensor([numbers.get(row["material_id"], UNKNOWN) for row in videos.rows])
    points = None
    if settings.points_weight:
        points_m = torch.from_numpy(videos.points_m)
        if started_from is None:
            set_unit_of_keypoints(network, points_m[training])
        points = network.in_unit(points_m)
    of_training = settings, run, videos, training, started, {"started_from": started_from}
    trainer = InstrumentTrainer(network, frames, labels, points, viewpoints, *of_training)
    trainer.train()
    card = {
        "materials": [entry["name"] for entry in materials],
        "frames": frames,
        "pixels": network.pixels,
        "viewpoints": list(viewpoints),
        "pose_range": pose_range(poses_of(list(compress(videos.rows, training)))),
        "split": run.split,
        "seed": run.seed,
        "frictions": sorted(
            {row["friction"] for row in videos.rows if not row.get("interpolated")}
        ),
        "started_from": started_from,
        "interpolated_videos": sum(bool(row.get("interpolated")) for row in videos.rows),
        "calibration_simulations": len(simulations(videos, ~training)),
        **trainer.facts(trainer.progress.history),
        "use": "measures friction in drop-and-drag videos recorded as in this dataset; for other "
        "videos it should raise its alarm, and its intervals are not valid",
    }
    instrument = calibrated(Instrument((network,), card, None), videos, training)
    card = save_instrument(instrument, run.out)
    others = [Path(settings.starts_from) / WEIGHTS] if settings.starts_from else []
    trainer.write_record((WEIGHTS, CARD), others)
    return card
