"""The trainer of all networks: epochs, checkpoints, resumption, history, and how a training ends.

A network brings a subclass of `Trainer`: the loss of a batch, the learning rate and the validation.
"""

import csv
import hashlib
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from slipstitch.base.errors import SlipstitchError
from slipstitch.base.provenance import atomic_path, code_digest, provenance_record, write_sidecar
from slipstitch.config.train import split_of
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import Videos, read_videos, takes_part
from slipstitch.learning.checkpoint import CHECKPOINT, Progress, load_checkpoint, save_checkpoint
from slipstitch.learning.torch_setup import computes_bfloat16

HISTORY = "history.csv"
_BARS = "▁▂▃▄▅▆▇█"


class PlateauError(SlipstitchError):
    """The loss stayed at chance: the network has learnt nothing."""


class DivergedError(SlipstitchError):
    """The loss is no finite number any more."""


@dataclass(frozen=True)
class Phase:
    """Epochs of the schedule with the same viewpoints."""

    name: str
    viewpoints: tuple[str, ...]
    epochs: int
    # it ends earlier once its lowest validation loss is so old, if the network has left chance
    flat_epochs: int | None = None

    def length(self, rows: Sequence[Mapping[str, Any]], left_chance: float) -> int:
        """Return how many epochs the phase has; below a training loss the network `left_chance`."""
        lowest, age, least = math.inf, 0, math.inf
        for number, row in enumerate(rows[: self.epochs], 1):
            least = min(least, row["train_loss"])
            age = 0 if row["validation_loss"] < lowest else age + 1
            lowest = min(lowest, row["validation_loss"])
            if self.flat_epochs is not None and age >= self.flat_epochs and least < left_chance:
                return number
        return self.epochs


def place(
    phases: Sequence[Phase], history: Sequence[Mapping[str, Any]], left_chance: float
) -> tuple[Phase, int] | None:
    """Return the phase of the next epoch and its number there, from 0; None at the end."""
    first = 0
    for phase in phases:
        length = phase.length(history[first:], left_chance)
        if len(history) < first + length:
            return phase, len(history) - first
        first += length
    return None


@dataclass(frozen=True)
class Run:
    """What every training is told."""

    dataset: str | Path  # folder that the sample stage wrote
    split: str  # one of `slipstitch.config.train.TRAINED_ON`
    seed: int  # of weights, order of the videos, augmentations and dropout
    out: str | Path  # folder of model, history and, until the training is finished, checkpoint
    # frames of a video that the network sees; by default all that the dataset has
    frames: int | None = None
    # says of a manifest row whether its video may train or validate; by default all may
    uses: Callable[[dict[str, Any]], bool] | None = None
    threads: int = 1
    # called after every step with the progress; what it raises stops the training
    after_step: Callable[[Progress], None] | None = None

    def videos(
        self, pixels: int | None, frames: int | None, viewpoints: Sequence[str] | None = None
    ) -> tuple[Videos, np.ndarray]:
        """Return the videos that train or validate, as `read_videos`, and which of them train."""
        column = f"split_{split_of(self.split)}"

        def chosen(row: dict[str, Any]) -> bool:
            in_view = viewpoints is None or row["viewpoint"] in viewpoints
            used = in_view and (self.uses is None or self.uses(row))
            return used and row[column] != "test" and takes_part(row, self.split)

        videos = read_videos(self.dataset, chosen, pixels, frames)
        return videos, np.array([row[column] == "train" for row in videos.rows])


class Trainer:
    """Trains a network, from the start or from the checkpoint of the same training.

    The base of every network's own, which sets what is declared here. `started` is what
    `start_clock` returned before the videos were read, `identity` is, in JSON's types, what tells
    this training from others beside data, settings and code.
    """

    stage: str  # whose code and settings the training depends on
    name: str  # names the training in messages
    network: nn.Module
    optimizer: torch.optim.Optimizer
    phases: Sequence[Phase]  # the schedule
    chance_loss: float  # of the best guess that ignores the video, as ``train_loss`` counts it
    gradient_norm_max: float | None = None  # gradients are clipped to it
    plateau_window: int = 1  # last epochs whose mean loss is compared with chance
    plateau_epochs: int | None = None  # after which it is so first; None: in the end only
    diverged_hint: str  # which settings to look at, for the messages
    plateau_hint: str
    keeps_before_last: bool = False  # whether the weights before the last phase are kept

    def __init__(
        self, settings: Any, run: Run, videos: Videos, training: np.ndarray, started: Any,
        identity: dict[str, Any] | None = None,
    ):  # fmt: skip
        # with ``batch_size``, ``checkpoint_interval_s``, ``plateau_margin`` and ``precision``
        self.settings = settings
        self.run, self.videos, self.started, self.identity = run, videos, started, identity or {}
        self.training = training  # (n,) bool: which of the videos train; the others validate
        # whether convolutions are derived in bfloat16
        self.bfloat16 = computes_bfloat16(settings.precision)
        self.out = Path(run.out)
        self.progress = Progress()

    def videos_of(self, phase: Phase) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers of the videos that train in a phase, and of those that validate it."""
        in_view = np.isin([row["viewpoint"] for row in self.videos.rows], phase.viewpoints)
        return np.flatnonzero(self.training & in_view), np.flatnonzero(~self.training & in_view)

    def learning_rate(self, phase: Phase, epoch: int, step: int, videos: int) -> float:
        """Return the rate of a step of an epoch of so many videos, both counted from 0."""
        raise NotImplementedError

    def batch_loss(
        self, batch: np.ndarray, generator: np.random.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the loss to derive, and columns of the history, ``train_loss`` first, of a batch.

        `generator` is the same at the same step, however often a training was stopped before.
        """
        raise NotImplementedError

    def validation(self, numbers: np.ndarray) -> dict[str, float]:
        """Return columns of the history from videos that do not train; NaN without any."""
        raise NotImplementedError

    def columns(self, phase: Phase) -> dict[str, Any]:
        """Return columns of the history that say which phase an epoch is of."""
        return {}

    def summary(self, row: dict[str, Any]) -> str:
        """Return what the terminal says of an epoch beside its loss."""
        raise NotImplementedError

    def _identity(self) -> dict[str, Any]:
        """What only the same training may continue from."""
        names = "\n".join(row["video"] for row in self.videos.rows)
        return {
            "settings": self.settings.model_dump(mode="json", exclude={"checkpoint_interval_s"}),
            "dataset_digest": self.videos.digest,
            "videos_sha256": hashlib.sha256(names.encode()).hexdigest(),
            "phases": [
                [phase.name, *phase.viewpoints, phase.epochs, phase.flat_epochs]
                for phase in self.phases
            ],
            "bfloat16": self.bfloat16,
            "code_digest": code_digest(self.stage),
            **{name: getattr(self.run, name) for name in ("split", "seed", "frames", "threads")},
            **self.identity,
        }

    def train(self) -> None:
        """Train to the end; DivergedError if the loss is not finite, PlateauError if at chance."""
        most = sum(phase.epochs for phase in self.phases)
        left_chance = (1.0 - (self.settings.plateau_margin or 0.0)) * self.chance_loss
        self.identity = self._identity()
        self.progress, message = load_checkpoint(
            self.out / CHECKPOINT, self.identity, self.network, self.optimizer
        )
        if message:
            print(message, file=sys.stderr)
        self.saved_at = time.monotonic()
        told = {"desc": self.name, "unit": "epoch", "disable": not sys.stderr.isatty()}
        bar = tqdm(total=most, initial=self.progress.epoch, **told)
        following = place(self.phases, self.progress.history, left_chance)
        while following is not None:
            phase, epoch = following
            history = [*self.progress.history, self._epoch(phase, epoch)]
            following = place(self.phases, history, left_chance)
            kept = self.progress.kept
            # In the checkpoint, not beside: Snakemake removes the files of an unfinished job.
            if self.keeps_before_last and following == (self.phases[-1], 0):
                weights = self.network.state_dict()
                kept = {name: value.clone() for name, value in weights.items()}
            draws = self.progress.draws
            self.progress = Progress(draws, epoch=len(history), history=history, kept=kept)
            self._print_epoch(phase, most, bar)
            if following and following[0] is not phase and self.begins_anew(phase):
                self.progress = Progress(draws + 1)
                bar.reset()
                following = place(self.phases, [], left_chance)
                continue
            if following is None or len(history) == self.plateau_epochs:
                self._check_plateau()
        bar.close()

    def begins_anew(self, phase: Phase) -> bool:
        """Return whether weights were drawn anew after a phase that taught the network nothing."""
        return False

    def _epoch(self, phase: Phase, epoch: int) -> dict[str, Any]:
        """Take the remaining steps of an epoch; return its row of the history."""
        progress = self.progress
        training, validating = self.videos_of(phase)
        order = np.random.default_rng([self.run.seed, progress.epoch]).permutation(training)
        size = self.settings.batch_size
        self.network.train()
        while (first := progress.step * size) < len(order):
            rate = self.learning_rate(phase, epoch, progress.step, len(order))
            self._step(order[first : first + size], rate)
            if time.monotonic() - self.saved_at >= self.settings.checkpoint_interval_s:
                path, learnt = self.out / CHECKPOINT, (self.network, self.optimizer)
                save_checkpoint(path, self.identity, progress, *learnt, self.started)
                self.saved_at = time.monotonic()
            if self.run.after_step is not None:
                self.run.after_step(progress)
        return {
            "epoch": progress.epoch + 1,
            **self.columns(phase),
            "videos": len(order),
            **{name: total / len(order) for name, total in progress.sums.items()},
            "validation_videos": len(validating),
            **self.validation(validating),
            "chance_loss": self.chance_loss,
        }

    def _step(self, batch: np.ndarray, rate: float) -> None:
        """Take a step; add its sums to the progress."""
        progress = self.progress
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        generator = np.random.default_rng([self.run.seed, progress.epoch, progress.step])
        loss, sums = self.batch_loss(batch, generator)
        if not math.isfinite(loss.item()):
            raise DivergedError(
                f"{self.name}: the loss became {loss.item()} in epoch {progress.epoch + 1}, "
                f"step {progress.step + 1}; no model is written (try {self.diverged_hint})"
            )
        self.optimizer.zero_grad()
        loss.backward()
        if self.gradient_norm_max is not None:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.gradient_norm_max)
        self.optimizer.step()
        progress.step += 1
        for name, value in sums.items():
            progress.sums[name] = progress.sums.get(name, 0) + value

    def _print_epoch(self, phase: Phase, epochs: int, bar: tqdm) -> None:
        """Show an epoch's end: the curve so far in a terminal, a line elsewhere."""
        row = self.progress.history[-1]
        summary = self.summary(row)
        bar.update()
        losses = curve([past["train_loss"] for past in self.progress.history])
        bar.set_postfix_str(f"{losses} loss {row['train_loss']:.4f}, {summary}")
        if bar.disable:
            epoch = " ".join(filter(None, (f"epoch {row['epoch']}/{epochs}", phase.name)))
            print(
                f"{self.name}: {epoch}: loss {row['train_loss']:.4f} "
                f"(chance {row['chance_loss']:.4f}), {summary}",
                file=sys.stderr,
            )

    def _check_plateau(self) -> None:
        """Fail if the loss of the last epochs is still that of guessing."""
        recent = self.progress.history[-self.plateau_window :]
        videos = sum(row["videos"] for row in recent)
        loss = sum(row["train_loss"] * row["videos"] for row in recent) / videos
        margin = self.settings.plateau_margin
        if margin is not None and loss > (1.0 - margin) * self.chance_loss:
            raise PlateauError(
                f"{self.name}: after {self.progress.epoch} epochs the training loss is still "
                f"{loss:.4f}, at chance ({self.chance_loss:.4f}): the network did not learn, no "
                f"model is written ({self.plateau_hint})"
            )

    def facts(self, history: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return what all model cards say of a training with this history."""
        return {
            "bfloat16": self.bfloat16,
            "settings": self.settings.model_dump(mode="json"),
            "dataset_digest": self.videos.digest,
            "training_videos": int(self.training.sum()),
            "training_simulations": len(simulations(self.videos, self.training)),
            "epochs": len(history),
            "train_loss": history[-1]["train_loss"],
            "chance_loss": self.chance_loss,
            "parameters": sum(weight.numel() for weight in self.network.parameters()),
            "multiply_accumulates_per_frame": self.network.multiply_accumulates,
        }

    def write_record(self, model_files: Sequence[str], other_inputs: Sequence[Path] = ()) -> None:
        """Write the history and where it and the model come from; remove the checkpoint."""
        run, stage = self.run, self.stage
        with (
            atomic_path(self.out / HISTORY) as temporary,
            open(temporary, "w", newline="") as stream,
        ):
            writer = csv.DictWriter(stream, list(self.progress.history[0]))
            writer.writeheader()
            writer.writerows(self.progress.history)
        shards = sorted({row["file"] for row in self.videos.rows})
        inputs = [Path(run.dataset) / name for name in (MANIFEST, *shards)]
        made = {"config": {stage: self.settings}, "seed": run.seed, "started": self.started}
        record = provenance_record(stage, inputs=[*inputs, *other_inputs], **made)
        record["threads"] = run.threads
        for name in (*model_files, HISTORY):
            write_sidecar(self.out / name, record)
        (self.out / CHECKPOINT).unlink(missing_ok=True)


def simulations(videos: Videos, chosen: np.ndarray) -> set[str]:
    """Return the simulations of the videos where `chosen` (bool, shape (n,)) is true."""
    return {row["simulation"] for row in compress(videos.rows, chosen)}


def curve(values: Sequence[float], width: int = 16) -> str:
    """Return bars from the lowest value to the highest, averaged to `width`; a gap for NaN."""
    if not values:
        return ""
    count = min(width, len(values))
    edges = [place * len(values) // count for place in range(count + 1)]
    means = [sum(values[low:high]) / (high - low) for low, high in pairwise(edges)]
    finite = [value for value in means if math.isfinite(value)]
    if not finite:
        return " " * count
    low, spread = min(finite), max(finite) - min(finite)
    return "".join(
        _BARS[int((len(_BARS) - 1) * (value - low) / spread + 0.5) if spread else 0]
        if math.isfinite(value)
        else " "
        for value in means
    )
