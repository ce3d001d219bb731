"""Training a classifier: cycles that add a viewpoint each, then the calibrated viewpoint only."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import start_clock
from slipstitch.config.train import NETWORKS, REFLECTIVE, TrainSettings
from slipstitch.learning.checkpoint import Progress
from slipstitch.learning.classes import chance_loss, classes_of, labels_of
from slipstitch.learning.loop import (
    Phase,
    read_training_videos,
    train_learner,
    training_facts,
    training_identity,
    write_record,
)
from slipstitch.learning.model_file import CARD, WEIGHTS, load_model, save_model
from slipstitch.learning.network import build_network, class_probabilities, cross_entropy
from slipstitch.learning.prediction import check_material_model, predict, predicted_materials
from slipstitch.learning.torch_setup import computes_bfloat16, set_up_torch

FINE_TUNING = "fine-tuning"


def progressive_schedule(
    settings: TrainSettings, view_order: list[str], twice_as_many: bool = False
) -> list[Phase]:
    """Cycles of one, two ... viewpoints, then the first one alone.

    With `twice_as_many` videos there are half as many epochs, which is the same work.
    """
    share = 2 if twice_as_many else 1
    epochs, last = (
        -(-count // share) for count in (settings.epochs_per_cycle, settings.fine_tuning_epochs)
    )
    cycles = [
        Phase(f"cycle {count}", tuple(view_order[:count]), epochs)
        for count in range(1, len(view_order) + 1)
    ]
    if last:
        cycles.append(Phase(FINE_TUNING, (view_order[0],), last))
    return cycles


def learning_rate(
    settings: TrainSettings, phases: Sequence[Phase], phase: Phase, done: float
) -> float:
    """Adadelta's rate: constant, down a cosine in the last cycle, at its end's while fine-tuning.

    Parameters
    ----------
    settings : TrainSettings
    phases : sequence of Phase
        All of the training.
    phase : Phase
        The one at work.
    done : float
        Share of it that is done, 0 ... 1.
    """
    last_cycle = [other for other in phases if other.name != FINE_TUNING][-1]
    if phase.name == FINE_TUNING:
        height = 0.0
    elif phase is last_cycle:
        height = 0.5 * (1.0 + math.cos(math.pi * done))
    else:
        height = 1.0
    lowest = settings.annealed_share
    return settings.learning_rate * (lowest + (1.0 - lowest) * height)


@dataclass
class ClassLearner:
    """A network that tells classes, with the videos that it learns from: a `loop.Learner`.

    Attributes
    ----------
    pixels : ndarray of uint8, shape (n, frames, side, side, 3)
    labels : ndarray of int64, shape (n,)
    condition : ndarray of int64, shape (n,), or None
        Material class numbers that a conditional network is told.
    training : ndarray of bool, shape (n,)
        Which of the videos train; the others validate.
    viewpoints : ndarray of str, shape (n,)
    """

    name: str
    settings: TrainSettings
    network: nn.Module
    phases: Sequence[Phase]
    pixels: np.ndarray
    labels: np.ndarray
    condition: np.ndarray | None
    training: np.ndarray
    viewpoints: np.ndarray
    bfloat16: bool

    def __post_init__(self):
        settings = self.settings
        self.optimizer = torch.optim.Adadelta(
            self.network.parameters(),
            lr=settings.learning_rate,
            rho=settings.rho,
            eps=settings.epsilon,
        )
        self.batch_size = settings.batch_size
        self.gradient_norm_max = settings.gradient_norm_max
        self.chance_loss = chance_loss(self.labels[self.training])
        self.plateau_margin = settings.plateau_margin
        self.plateau_window = settings.epochs_per_cycle
        self.plateau_epochs = settings.plateau_epochs
        self.diverged_hint = (
            f"a smaller train.learning_rate than {settings.learning_rate:g}, or "
            "train.gradient_norm_max"
        )
        self.plateau_hint = (
            f"initialisation {settings.initialisation!r}, train.epochs_per_cycle "
            f"{settings.epochs_per_cycle}"
        )

    def videos(self, phase: Phase) -> tuple[np.ndarray, np.ndarray]:
        """Those of the phase's viewpoints."""
        in_view = np.isin(self.viewpoints, phase.viewpoints)
        return np.flatnonzero(self.training & in_view), np.flatnonzero(~self.training & in_view)

    def learning_rate(self, phase: Phase, epoch: int, step: int, videos: int) -> float:
        """As the function of this name, by the share of the phase's videos that were shown."""
        done = (epoch + step * self.batch_size / videos) / phase.epochs
        return learning_rate(self.settings, self.phases, phase, done)

    def batch_loss(
        self, batch: np.ndarray, generator: np.random.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """Cross-entropy; its sum and the number of right answers."""
        logits = self.network(
            torch.from_numpy(self.pixels[batch]),
            None if self.condition is None else torch.from_numpy(self.condition[batch]),
            self.bfloat16,
        )
        truth = torch.from_numpy(self.labels[batch])
        loss = cross_entropy(logits, truth)
        right = int((class_probabilities(logits).argmax(1) == truth).sum())
        return loss, {"train_loss": loss.item() * len(batch), "train_accuracy": right}

    def validation(self, numbers: np.ndarray) -> dict[str, float]:
        """Loss and accuracy."""
        if not len(numbers):
            return {"validation_loss": math.nan, "validation_accuracy": math.nan}
        probabilities = predict(
            self.network,
            self.pixels[numbers],
            None if self.condition is None else self.condition[numbers],
            bfloat16=self.bfloat16,
            batch_size=self.batch_size,
        )
        labels = self.labels[numbers]
        of_truth = probabilities[np.arange(len(labels)), labels]
        return {
            "validation_loss": float(-np.log(np.maximum(of_truth, 1e-12)).mean()),
            "validation_accuracy": float((probabilities.argmax(1) == labels).mean()),
        }

    def columns(self, phase: Phase) -> dict[str, Any]:
        """Name and viewpoints of the phase."""
        return {"stage": phase.name, "viewpoints": "+".join(phase.viewpoints)}

    def summary(self, row: dict[str, Any]) -> str:
        """Both accuracies."""
        return f"accuracy {row['train_accuracy']:.3f}, validation {row['validation_accuracy']:.3f}"


def train_network(
    settings: TrainSettings,
    dataset: str | os.PathLike,
    network_name: str,
    split: str,
    seed: int,
    out_dir: str | os.PathLike,
    *,
    view_order: list[str],
    frames: int | None = None,
    material_model: str | os.PathLike | None = None,
    expected_classes: dict[str, list] | None = None,
    phases: list[Phase] | None = None,
    uses: Callable[[dict[str, Any]], bool] | None = None,
    true_materials: bool = False,
    threads: int = 1,
    after_step: Callable[[Progress], None] | None = None,
) -> dict[str, Any]:
    """Train one network on one split and write it.

    Parameters
    ----------
    settings : TrainSettings
    dataset : path
        Folder that the sample stage wrote.
    network_name : {"material_baseline", "friction_baseline", "friction_conditional"}
    split : {"by_video", "by_simulation", "by_video_reflective"}
    seed : int
        Of weights, order of the videos and dropout.
    out_dir : path
        Gets ``model.safetensors``, ``model.json``, ``history.csv`` and, until it is done,
        ``checkpoint.safetensors``.
    view_order : list of str
        Training viewpoints by name; the first is the calibrated one.
    frames : int, optional
        Frames of a video that the network sees; by default all that the dataset has.
    material_model : path, optional
        Folder of the material_baseline of the same dataset, split and seed; for
        friction_conditional only.
    expected_classes : dict, optional
        ``{"material": [names], "friction": [coefficients]}`` that the dataset must have.
    phases : list of Phase, optional
        Epochs by viewpoints; by default the progressive `schedule`.
    uses : callable, optional
        Says of a manifest row whether its video may train or validate; by default all may.
    true_materials : bool
        Condition friction_conditional on the true materials instead of predicted ones.
    threads : int
    after_step : callable, optional
        Called after every step with the progress; what it raises stops the training.

    Returns
    -------
    dict
        The model card.

    Raises
    ------
    BadInput
        If dataset, material model or arguments do not fit.
    PlateauError
        If the training loss is not below chance by `settings.plateau_margin` in the end, or after
        `settings.plateau_epochs`.
    DivergedError
        If the loss is not finite.
    """
    started = start_clock()
    if network_name not in NETWORKS:
        raise BadInput(f"unknown network {network_name!r}; known: {', '.join(NETWORKS)}")
    conditional = network_name == "friction_conditional"
    listens = conditional and not true_materials
    if listens != (material_model is not None):
        raise BadInput(
            f"{network_name} {'requires' if listens else 'does not take'} --material-model"
        )
    set_up_torch(threads)
    videos, training = read_training_videos(dataset, split, uses, settings.pixels, frames)
    target = network_name.split("_")[0]
    classes = classes_of(videos.rows, target)
    labels = labels_of(videos.rows, classes, target)
    _check_dataset(videos, labels, classes, training, view_order, target, expected_classes)
    condition, condition_classes, condition_digest = None, [], None
    if true_materials:
        condition_classes = classes_of(videos.rows, "material")
        condition = labels_of(videos.rows, condition_classes, "material")
    elif conditional:
        model = load_model(material_model)
        check_material_model(model, split, seed, videos.digest)
        condition = predicted_materials(model, videos, settings.batch_size)
        condition_classes = model.card["classes"]
        condition_digest = model.card["weights_sha256"]

    torch.manual_seed(seed)
    pixels = videos.pixels.shape[2]
    network = build_network(settings, len(classes), pixels, len(condition_classes))
    if settings.input_scaling == "standardised":
        mean, deviation = _colour_statistics(videos.pixels[training])
    else:
        mean, deviation = np.zeros(3), np.full(3, 255.0)
    network.mean.copy_(torch.from_numpy(mean))
    network.deviation.copy_(torch.from_numpy(deviation))
    learner = ClassLearner(
        name=f"{network_name} {split} seed {seed}",
        settings=settings,
        network=network,
        phases=phases or progressive_schedule(settings, view_order, split == REFLECTIVE),
        pixels=videos.pixels,
        labels=labels,
        condition=condition,
        training=training,
        viewpoints=np.array([row["viewpoint"] for row in videos.rows]),
        bfloat16=computes_bfloat16(settings.precision),
    )
    identity = training_identity(
        "train",
        learner,
        videos,
        network=network_name,
        split=split,
        seed=seed,
        view_order=view_order,
        condition_sha256=condition_digest,
        true_materials=true_materials,
        threads=threads,
    )
    out = Path(out_dir)
    history = train_learner(learner, seed, out, identity, after_step)
    card = save_model(
        network,
        {
            "network": network_name,
            "target": target,
            "split": split,
            "seed": seed,
            "classes": classes,
            "condition_classes": condition_classes,
            "condition_sha256": condition_digest,
            "true_materials": true_materials,
            "pixels": pixels,
            "frames": videos.pixels.shape[1],
            "viewpoints": view_order,
            **training_facts(learner, videos, history),
            "use": "predicts the class in drop-and-drag videos rendered like this dataset; its "
            "performance on other videos, real ones included, is unknown",
        },
        out,
    )
    told = [] if material_model is None else [Path(material_model) / n for n in (WEIGHTS, CARD)]
    write_record(
        "train",
        out,
        history,
        (WEIGHTS, CARD),
        dataset=dataset,
        videos=videos,
        other_inputs=told,
        settings=settings,
        seed=seed,
        threads=threads,
        started=started,
    )
    return card


def _check_dataset(videos, labels, classes, training, view_order, target, expected) -> None:
    """Refuse data that cannot train what is asked for."""
    for kind, values in (expected or {}).items():
        key = "name" if kind == "material" else "value"
        found = [entry[key] for entry in classes_of(videos.rows, kind)]
        if found != list(values):
            raise BadInput(
                f"the dataset has {len(found)} {kind} classes ({', '.join(map(str, found))}), "
                f"the configuration {len(values)} ({', '.join(map(str, values))})"
            )
    if len(classes) < 2:
        raise BadInput(f"{len(classes)} {target} class: at least two are required")
    for number, entry in enumerate(classes):
        if not np.any(labels[training] == number):
            raise BadInput(f"{target} class {entry['id']} has no training video")
    present = {row["viewpoint"] for row in videos.rows}
    absent = [name for name in view_order if name not in present]
    if absent:
        raise BadInput(
            f"the dataset has no training viewpoint {absent[0]!r}; known: "
            f"{', '.join(sorted(present))}"
        )
    for name in view_order:
        if not any(row["viewpoint"] == name for row in compress(videos.rows, training)):
            raise BadInput(f"viewpoint {name!r} has no training video")


def _colour_statistics(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each colour over all pixels, from exact integer sums."""
    count = pixels[..., 0].size
    histogram = np.stack([np.bincount(pixels[..., c].ravel(), minlength=256) for c in range(3)])
    values = np.arange(256.0)
    mean = histogram @ values / count
    variance = histogram @ values**2 / count - mean**2
    return mean, np.sqrt(np.maximum(variance, 1.0))
