"""The training loop, common to all networks; resumes from checkpoints.

A network brings a `Learner`: which videos a phase has, the loss of a batch, the learning rate of a
step and the validation. The loop brings order, steps, checkpoints, history, and the end of a
training that diverges or stays at chance.
"""

import csv
import hashlib
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor, nn
from tqdm import tqdm

from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.base.provenance import (
    atomic_path,
    code_digest,
    provenance_record,
    start_clock,
    write_sidecar,
)
from slipstitch.config.train import TRAINED_ON, split_of
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import Videos, read_videos, takes_part
from slipstitch.learning.checkpoint import CHECKPOINT, Progress, load_checkpoint, save_checkpoint
from slipstitch.learning.curves import curve

HISTORY = "history.csv"


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


class Learner(Protocol):
    """Interface between a network and the loop.

    Attributes
    ----------
    name : str
        Names the training in messages.
    settings : pydantic model
        With ``checkpoint_interval_s``: least time between checkpoints.
    network : nn.Module
    training : ndarray of bool, shape (n,)
        Which of the videos train; the others validate.
    bfloat16 : bool
        Whether convolutions are derived in bfloat16.
    optimizer : torch.optim.Optimizer
    phases : sequence of Phase
        The schedule.
    batch_size : int
    gradient_norm_max : float or None
        Gradients are clipped to it.
    chance_loss : float
        Loss of the best guess that ignores the video, as ``train_loss`` counts it.
    plateau_margin : float or None
        A training fails whose loss stays above (1 - margin) times chance; None: never.
    plateau_window : int
        Last epochs over which that loss is averaged.
    plateau_epochs : int or None
        Epochs after which it is asked for the first time; None: in the end only.
    diverged_hint, plateau_hint : str
        Which settings to look at, for the messages.
    """

    name: str
    training: np.ndarray
    bfloat16: bool
    optimizer: torch.optim.Optimizer
    phases: Sequence[Phase]
    batch_size: int
    gradient_norm_max: float | None
    chance_loss: float
    plateau_margin: float | None
    plateau_window: int
    plateau_epochs: int | None
    diverged_hint: str
    plateau_hint: str

    @property
    def network(self) -> nn.Module:
        """What learns."""

    @property
    def settings(self) -> Any:
        """How."""

    def videos(self, phase: Phase) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the videos that train in a phase, and of those that validate it."""

    def learning_rate(self, phase: Phase, epoch: int, step: int, videos: int) -> float:
        """Rate of a step of the phase's epoch, both counted from 0; an epoch has so many videos."""

    def batch_loss(
        self, batch: np.ndarray, generator: np.random.Generator
    ) -> tuple[Tensor, dict[str, float]]:
        """Loss to derive, and what the history keeps, ``train_loss`` first, summed over videos.

        `generator` is for augmentations: the same one at the same step, however often a training
        was stopped before.
        """

    def validation(self, numbers: np.ndarray) -> dict[str, float]:
        """Columns of the history from videos that do not train; NaN where there are none."""

    def columns(self, phase: Phase) -> dict[str, Any]:
        """Columns of the history that say which phase an epoch is of."""

    def summary(self, row: dict[str, Any]) -> str:
        """Additional terminal output on an epoch."""


def train_learner(
    learner: Learner,
    seed: int,
    out: Path,
    identity: dict[str, Any],
    after_step: Callable[[Progress], None] | None = None,
) -> list[dict[str, Any]]:
    """Train from the start, or from the checkpoint of the same training, to the end.

    Parameters
    ----------
    learner : Learner
    seed : int
        Of the order of the videos and of the augmentations.
    out : path
        Folder of ``checkpoint.safetensors``, which stays until `write_record`.
    identity : dict
        Which training this is, in JSON's types: see `training_identity`.
    after_step : callable, optional
        Called after every step with the progress; what it raises stops the training.

    Returns
    -------
    list of dict
        The history, one row per epoch.

    Raises
    ------
    DivergedError
        If the loss is not finite.
    PlateauError
        If the training loss is not below chance by the margin.
    """
    network, optimizer = learner.network, learner.optimizer
    schedule = [(phase, epoch) for phase in learner.phases for epoch in range(phase.epochs)]
    checkpoint = out / CHECKPOINT
    started = start_clock()
    progress, message = load_checkpoint(checkpoint, identity, network, optimizer)
    progress = progress or Progress()
    if message:
        print(message, file=sys.stderr)
    saved_at = time.monotonic()
    bar = tqdm(
        total=len(schedule),
        initial=progress.epoch,
        desc=learner.name,
        unit="epoch",
        disable=not sys.stderr.isatty(),
    )
    while progress.epoch < len(schedule):
        phase, phase_epoch = schedule[progress.epoch]
        training, validating = learner.videos(phase)
        order = np.random.default_rng([seed, progress.epoch]).permutation(training)
        network.train()
        while (first := progress.step * learner.batch_size) < len(order):
            for group in optimizer.param_groups:
                group["lr"] = learner.learning_rate(phase, phase_epoch, progress.step, len(order))
            generator = np.random.default_rng([seed, progress.epoch, progress.step])
            loss, sums = learner.batch_loss(order[first : first + learner.batch_size], generator)
            if not math.isfinite(loss.item()):
                raise DivergedError(
                    f"{learner.name}: the loss became {loss.item()} in epoch {progress.epoch + 1}, "
                    f"step {progress.step + 1}; no model is written (try {learner.diverged_hint})"
                )
            optimizer.zero_grad()
            loss.backward()
            if learner.gradient_norm_max is not None:
                nn.utils.clip_grad_norm_(network.parameters(), learner.gradient_norm_max)
            optimizer.step()
            progress.add(sums)
            if time.monotonic() - saved_at >= learner.settings.checkpoint_interval_s:
                save_checkpoint(checkpoint, identity, progress, network, optimizer, started)
                saved_at = time.monotonic()
            if after_step is not None:
                after_step(progress)

        row = {
            "epoch": progress.epoch + 1,
            **learner.columns(phase),
            "videos": len(order),
            **{name: total / len(order) for name, total in progress.sums.items()},
            "validation_videos": len(validating),
            **learner.validation(validating),
            "chance_loss": learner.chance_loss,
        }
        progress = Progress(epoch=progress.epoch + 1, history=[*progress.history, row])
        _print_epoch(learner, progress, phase, len(schedule), bar)
        if progress.epoch in (learner.plateau_epochs, len(schedule)):
            _check_plateau(learner, progress.history)
    bar.close()
    return progress.history


def _print_epoch(
    learner: Learner, progress: Progress, phase: Phase, epochs: int, bar: tqdm
) -> None:
    """An epoch's end: the curve so far in a terminal, a line elsewhere."""
    row = progress.history[-1]
    bar.update()
    losses = curve([past["train_loss"] for past in progress.history])
    bar.set_postfix_str(f"{losses} loss {row['train_loss']:.4f}, {learner.summary(row)}")
    if bar.disable:
        epoch = " ".join(filter(None, (f"epoch {row['epoch']}/{epochs}", phase.name)))
        print(
            f"{learner.name}: {epoch}: loss {row['train_loss']:.4f} "
            f"(chance {row['chance_loss']:.4f}), {learner.summary(row)}",
            file=sys.stderr,
        )


def _check_plateau(learner: Learner, history: list[dict[str, Any]]) -> None:
    """Fail if the loss of the last epochs is still that of guessing."""
    recent = history[-learner.plateau_window :]
    videos = sum(row["videos"] for row in recent)
    loss = sum(row["train_loss"] * row["videos"] for row in recent) / videos
    margin = learner.plateau_margin
    if margin is not None and loss > (1.0 - margin) * learner.chance_loss:
        raise PlateauError(
            f"{learner.name}: after {len(history)} epochs the training loss is still {loss:.4f}, "
            f"at chance ({learner.chance_loss:.4f}): the network did not learn, no model is "
            "written "
            f"({learner.plateau_hint})"
        )


def training_identity(stage: str, learner: Learner, videos: Videos, **others) -> dict[str, Any]:
    """Identity of a training for its checkpoint: data, settings, code, `others`."""
    names = "\n".join(row["video"] for row in videos.rows)
    return {
        "settings": learner.settings.model_dump(mode="json", exclude={"checkpoint_interval_s"}),
        "dataset_digest": videos.digest,
        "videos_sha256": hashlib.sha256(names.encode()).hexdigest(),
        "phases": [[phase.name, *phase.viewpoints, phase.epochs] for phase in learner.phases],
        "bfloat16": learner.bfloat16,
        "code_digest": code_digest(stage),
        **others,
    }


def training_facts(
    learner: Learner, videos: Videos, history: list[dict[str, Any]]
) -> dict[str, Any]:
    """Common entries on the training in all model cards."""
    return {
        "bfloat16": learner.bfloat16,
        "settings": learner.settings.model_dump(mode="json"),
        "dataset_digest": videos.digest,
        "training_videos": int(learner.training.sum()),
        "training_simulations": len(simulations(videos, learner.training)),
        "epochs": len(history),
        "train_loss": history[-1]["train_loss"],
        "chance_loss": learner.chance_loss,
        "parameters": sum(weight.numel() for weight in learner.network.parameters()),
        "multiply_accumulates_per_frame": learner.network.multiply_accumulates,
    }


def read_training_videos(
    dataset: str | os.PathLike,
    split: str,
    uses: Callable[[dict[str, Any]], bool] | None,
    pixels: int | None,
    frames: int | None = None,
) -> tuple[Videos, np.ndarray]:
    """The videos that train or validate, and which of them train.

    Parameters
    ----------
    dataset : path
    split : str
        One of `slipstitch.config.train.TRAINED_ON`.
    uses : callable or None
        Says of a manifest row whether its video may do either; None: all may.
    pixels, frames
        As for `slipstitch.dataset.videos.read_videos`.

    Raises
    ------
    BadInput
        If there is no such split, or the dataset is damaged or leaks.
    """
    if split not in TRAINED_ON:
        raise BadInput(f"unknown split {split!r}; known: {', '.join(TRAINED_ON)}")
    column = f"split_{split_of(split)}"
    videos = read_videos(
        dataset,
        lambda row: (
            takes_part(row, split) and row[column] != "test" and (uses is None or uses(row))
        ),
        pixels,
        frames,
    )
    return videos, np.array([row[column] == "train" for row in videos.rows])


def simulations(videos: Videos, chosen: np.ndarray) -> set[str]:
    """Simulations of the videos where `chosen` (bool, shape (n,)) is true."""
    return {row["simulation"] for row in compress(videos.rows, chosen)}


def write_record(
    stage: str,
    out: Path,
    history: list[dict[str, Any]],
    model_files: Sequence[str],
    *,
    dataset: str | os.PathLike,
    videos: Videos,
    other_inputs: Sequence[Path] = (),
    settings: BaseModel,
    seed: int,
    threads: int,
    started: Any,
) -> None:
    """Write the history and where it and the model come from; remove the checkpoint."""
    with atomic_path(out / HISTORY) as temporary, open(temporary, "w", newline="") as stream:
        writer = csv.DictWriter(stream, list(history[0]))
        writer.writeheader()
        writer.writerows(history)
    shards = sorted({row["file"] for row in videos.rows})
    inputs = [Path(dataset) / name for name in (MANIFEST, *shards)]
    record = provenance_record(
        stage, inputs=[*inputs, *other_inputs], config={stage: settings}, seed=seed, started=started
    )
    record["threads"] = threads
    for name in (*model_files, HISTORY):
        write_sidecar(out / name, record)
    (out / CHECKPOINT).unlink(missing_ok=True)
