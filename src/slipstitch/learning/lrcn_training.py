"""Training of the paper's networks.

Cycles of the training add a viewpoint each; the calibrated viewpoint alone is fine-tuned.
"""

import math
import sys
from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import start_clock
from slipstitch.config.train import REFLECTIVE, TrainSettings
from slipstitch.dataset.videos import Videos
from slipstitch.learning.lrcn import (
    ALL_VIEWS,
    CARD,
    LRCN,
    TRUE,
    WEIGHTS,
    class_probabilities,
    load_model,
    save_model,
)
from slipstitch.learning.prediction import chance_loss, classes_of, labels_of
from slipstitch.learning.torch_setup import set_up_torch
from slipstitch.learning.trainer import Phase, Run, Trainer

# Adadelta's decay and the constant below its root: the paper's, and Keras' default.
RHO, EPSILON = 0.95, 1e-7
PLATEAU_EPOCHS = 40  # after which a training that is still at chance is given up
FINE_TUNING, UNTIL_FLAT = "fine-tuning", "until flat"
# Share of the learning rate to which it falls in the last cycle, and at which fine-tuning goes on.
ANNEALED_SHARE = 0.05
CYCLES_MAX = 8  # of epochs until the validation loss is flat
# Of the initial weights: the first steps at Adadelta's rate of 1 may silence every rectifier of the
# connected layers, which then learn nothing more.
DRAWS_MAX = 3


def progressive_schedule(
    settings: TrainSettings, view_order: Sequence[str], twice_as_many: bool = False
) -> list[Phase]:
    """Return cycles of one, two ... viewpoints, then the first one alone.

    With `settings.flat_epochs` epochs of all viewpoints come before the last cycle, which lowers
    the rate: until the lowest validation loss is so many epochs old and the network has left
    chance, at most `CYCLES_MAX` cycles. With `twice_as_many` videos there are half as many epochs.
    """
    share = 2 if twice_as_many else 1
    epochs, last = (
        -(-count // share) for count in (settings.epochs_per_cycle, settings.fine_tuning_epochs)
    )
    cycles = [
        Phase(f"cycle {count}", tuple(view_order[:count]), epochs)
        for count in range(1, len(view_order) + 1)
    ]
    if settings.flat_epochs is not None:
        most = CYCLES_MAX * epochs
        cycles.insert(-1, Phase(UNTIL_FLAT, tuple(view_order), most, settings.flat_epochs))
    if last:
        cycles.append(Phase(FINE_TUNING, (view_order[0],), last))
    return cycles


def learning_rate(
    settings: TrainSettings, phases: Sequence[Phase], phase: Phase, done: float
) -> float:
    """Return Adadelta's rate: constant, down a cosine in the last cycle, then as at its end."""
    last_cycle = [other for other in phases if other.name != FINE_TUNING][-1]
    if phase.name == FINE_TUNING:
        height = 0.0
    elif phase is last_cycle:
        height = 0.5 * (1.0 + math.cos(math.pi * done))
    else:
        height = 1.0
    return settings.learning_rate * (ANNEALED_SHARE + (1.0 - ANNEALED_SHARE) * height)


class LrcnTrainer(Trainer):
    """Trains a network that tells classes.

    Labels are int64 of shape (n,), so are the material class numbers that a conditional network is
    told, its `condition`.
    """

    stage = "train"
    network: LRCN

    def __init__(
        self, network: LRCN, phases: Sequence[Phase], labels: np.ndarray,
        condition: np.ndarray | None, *training: Any,
    ):  # fmt: skip
        super().__init__(*training)
        self.network, self.phases, self.labels, self.condition = network, phases, labels, condition
        settings = self.settings
        self.name = f"{self.identity['network']} {self.run.split} seed {self.run.seed}"
        self.optimizer = torch.optim.Adadelta(
            network.parameters(), lr=settings.learning_rate, rho=RHO, eps=EPSILON
        )
        self.chance_loss = chance_loss(labels[self.training])
        self.plateau_window = settings.epochs_per_cycle
        self.plateau_epochs = PLATEAU_EPOCHS
        self.keeps_before_last = settings.keep_all_views and phases[-1].name == FINE_TUNING
        self.diverged_hint = f"a smaller train.learning_rate than {settings.learning_rate:g}"
        self.plateau_hint = (
            f"initialisation {settings.initialisation!r}, train.epochs_per_cycle "
            f"{settings.epochs_per_cycle}"
        )

    def learning_rate(self, phase: Phase, epoch: int, step: int, videos: int) -> float:
        """Return that of the function of this name, by the share of the videos that were shown."""
        done = (epoch + step * self.settings.batch_size / videos) / phase.epochs
        return learning_rate(self.settings, self.phases, phase, done)

    def begins_anew(self, phase: Phase) -> bool:
        """Draw the weights anew if the connected layers are silent after the first cycle."""
        if phase is not self.phases[0] or self.progress.draws == DRAWS_MAX or not self._silent():
            return False
        what = f"the rectifiers are silent after {phase.name}: weights are drawn anew"
        print(f"{self.name}: {what}", file=sys.stderr)
        for module in self.network.modules():
            if reset := getattr(module, "reset_parameters", None):
                reset()
        self.network.initialise()
        self.optimizer.state.clear()
        return True

    def _silent(self) -> bool:
        """Whether under a hundredth of the rectifiers between the connected layers passes on."""
        passing: list[float] = []

        def note(rectifier: nn.Module, inputs: tuple[Tensor], outputs: Tensor) -> None:
            passing.append(float((outputs > 0).float().mean()))

        hook = self.network.fully_connected[1].register_forward_hook(note)
        self._probabilities(self.videos_of(self.phases[0])[0][:64])
        hook.remove()
        return float(np.mean(passing)) < 0.01

    def batch_loss(
        self, batch: np.ndarray, generator: np.random.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the cross-entropy; its sum and the number of right answers."""
        logits = self.network(
            torch.from_numpy(self.videos.pixels[batch]),
            None if self.condition is None else torch.from_numpy(self.condition[batch]),
            self.bfloat16,
        )
        truth = torch.from_numpy(self.labels[batch])
        loss = nn.functional.cross_entropy(logits, truth)
        right = int((logits.softmax(-1).argmax(1) == truth).sum())
        return loss, {"train_loss": loss.item() * len(batch), "train_accuracy": right}

    def _probabilities(self, numbers: np.ndarray) -> np.ndarray:
        """Of the classes (n, classes), for the videos with these numbers."""
        return class_probabilities(
            self.network,
            self.videos.pixels[numbers],
            None if self.condition is None else self.condition[numbers],
            bfloat16=self.bfloat16,
            batch_size=self.settings.batch_size,
        )

    def validation(self, numbers: np.ndarray) -> dict[str, float]:
        """Return loss and accuracy."""
        if not len(numbers):
            return {"validation_loss": math.nan, "validation_accuracy": math.nan}
        probabilities = self._probabilities(numbers)
        labels = self.labels[numbers]
        of_truth = probabilities[np.arange(len(labels)), labels]
        return {
            "validation_loss": float(-np.log(np.maximum(of_truth, 1e-12)).mean()),
            "validation_accuracy": float((probabilities.argmax(1) == labels).mean()),
        }

    def columns(self, phase: Phase) -> dict[str, Any]:
        """Return name and viewpoints of the phase."""
        return {"stage": phase.name, "viewpoints": "+".join(phase.viewpoints)}

    def summary(self, row: dict[str, Any]) -> str:
        """Return both accuracies."""
        return f"accuracy {row['train_accuracy']:.3f}, validation {row['validation_accuracy']:.3f}"


def train_network(
    settings: TrainSettings,
    run: Run,
    network_name: str,
    view_order: Sequence[str],
    *,
    material_model: str | Path | None = None,
    expected_classes: dict[str, list] | None = None,
    phases: list[Phase] | None = None,
) -> dict[str, Any]:
    """Train one network and write it; return its card.

    BadInput if dataset, material model or arguments do not fit; else as `Trainer.train`.

    Parameters
    ----------
    network_name : {"material_baseline", "friction_baseline", "friction_conditional"}
    view_order : sequence of str
        Training viewpoints by name; the first is the calibrated one.
    material_model : path, optional
        What friction_conditional, and it only, is conditioned on: folder of the material_baseline
        of the same dataset, split and seed; or `TRUE`.
    expected_classes : dict, optional
        ``{"material": [names], "friction": [coefficients]}`` that the dataset must have.
    phases : list of Phase, optional
        Epochs by viewpoints; by default the `progressive_schedule`.
    """
    started = start_clock()
    conditional = network_name == "friction_conditional"
    if conditional != (material_model is not None):
        verb = "requires" if conditional else "does not take"
        raise BadInput(f"{network_name} {verb} --material-model")
    set_up_torch(run.threads)
    videos, training = run.videos(settings.pixels, run.frames)
    target = network_name.split("_")[0]
    classes = classes_of(videos.rows, target)
    labels = labels_of(videos.rows, classes, target)
    _check_dataset(videos, expected_classes)
    _check_training(videos, labels, classes, training, view_order, target)
    condition, condition_classes, condition_digest = _conditioned_on(
        material_model, run, videos, settings
    )
    torch.manual_seed(run.seed)
    network = LRCN(settings, len(classes), videos.pixels.shape[2], len(condition_classes))
    mean, deviation = _colour_statistics(videos.pixels[training])
    network.mean.copy_(torch.from_numpy(mean))
    network.deviation.copy_(torch.from_numpy(deviation))
    named = {
        "network": network_name,
        "condition_sha256": condition_digest,
        "true_materials": material_model == TRUE,
    }
    phases = phases or progressive_schedule(settings, view_order, run.split == REFLECTIVE)
    identity = {"view_order": list(view_order), **named}
    of_training = settings, run, videos, training, started, identity
    trainer = LrcnTrainer(network, phases, labels, condition, *of_training)
    trainer.train()
    known = named | {
        "target": target,
        "classes": classes,
        "condition_classes": condition_classes,
        "split": run.split,
        "seed": run.seed,
        "pixels": videos.pixels.shape[2],
        "frames": videos.pixels.shape[1],
        "viewpoints": list(view_order),
    }
    told = [] if condition_digest is None else _weights_of(material_model, settings)
    return _write(trainer, known, told)


def _write(trainer: LrcnTrainer, known: dict[str, Any], told: list[Path]) -> dict[str, Any]:
    """Write the network, also before fine-tuning if that is kept; return the card."""
    use = (
        "predicts the class in drop-and-drag videos rendered like this dataset; its performance "
        "on other videos, real ones included, is unknown"
    )
    done, files = trainer.progress, [WEIGHTS, CARD]
    known = {**known, "draws": done.draws}
    if done.kept:
        files += [f"{ALL_VIEWS}/{name}" for name in files]
        before = [row for row in done.history if row["stage"] != FINE_TUNING]
        card = {**known, **trainer.facts(before), "use": use}
        save_model(done.kept, card, trainer.out / ALL_VIEWS)
    card = {**known, **trainer.facts(done.history), "use": use}
    card = save_model(trainer.network.state_dict(), card, trainer.out)
    trainer.write_record(files, told)
    return card


def _weights_of(material_model: str | Path, settings: TrainSettings) -> list[Path]:
    """Files of the network that tells a conditional one the material."""
    folder = Path(material_model)
    if settings.keep_all_views and (folder / ALL_VIEWS).is_dir():
        folder /= ALL_VIEWS
    return [folder / name for name in (WEIGHTS, CARD)]


def _conditioned_on(
    material_model: str | Path | None, run: Run, videos: Videos, settings: TrainSettings
) -> tuple[np.ndarray | None, list[dict[str, Any]], str | None]:
    """Material class numbers that a network is told of videos, the classes, the teller's digest."""
    if material_model is None:
        return None, [], None
    if material_model == TRUE:
        classes = classes_of(videos.rows, "material")
        return labels_of(videos.rows, classes, "material"), classes, None
    model = load_model(_weights_of(material_model, settings)[0].parent)
    model.check_is_material_network_of(run.split, run.seed, videos.digest)
    told = model.probabilities(videos, settings.batch_size).argmax(1)
    return told, model.card["classes"], model.card["weights_sha256"]


def _check_dataset(videos: Videos, expected: dict[str, list] | None) -> None:
    """Refuse a dataset of other classes than those expected."""
    for kind, values in (expected or {}).items():
        key = "name" if kind == "material" else "value"
        found = [entry[key] for entry in classes_of(videos.rows, kind)]
        if found != list(values):
            raise BadInput(
                f"the dataset has {len(found)} {kind} classes ({', '.join(map(str, found))}), "
                f"the configuration {len(values)} ({', '.join(map(str, values))})"
            )


def _check_training(videos, labels, classes, training, view_order, target) -> None:
    """Refuse data that cannot train what is asked for."""
    if len(classes) < 2:
        raise BadInput(f"{len(classes)} {target} class: at least two are required")
    for number, entry in enumerate(classes):
        if not np.any(labels[training] == number):
            raise BadInput(f"{target} class {entry['id']} has no training video")
    trained = sorted({row["viewpoint"] for row in compress(videos.rows, training)})
    for name in view_order:
        if name not in trained:
            raise BadInput(f"viewpoint {name!r} has no training video; {', '.join(trained)} have")


def _colour_statistics(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each colour over all pixels, from exact integer sums."""
    count = pixels[..., 0].size
    histogram = np.stack([np.bincount(pixels[..., c].ravel(), minlength=256) for c in range(3)])
    values = np.arange(256.0)
    mean = histogram @ values / count
    variance = histogram @ values**2 / count - mean**2
    return mean, np.sqrt(np.maximum(variance, 1.0))
