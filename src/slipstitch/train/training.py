"""Training one network: cycles of one viewpoint more, then the calibrated viewpoint alone."""

import csv
import ctypes
import hashlib
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from slipstitch.config.train import NETWORKS, SPLITS, TrainSettings
from slipstitch.errors import BadInput, SlipstitchError
from slipstitch.provenance import (
    atomic_path,
    code_digest,
    provenance_record,
    start_clock,
    write_sidecar,
)
from slipstitch.sample.videos import Videos, read_videos, takes_part
from slipstitch.train.checkpoint import CHECKPOINT, Progress, load_checkpoint, save_checkpoint
from slipstitch.train.curves import curve
from slipstitch.train.model_file import CARD, WEIGHTS, TrainedModel, load_model, save_model
from slipstitch.train.network import (
    LRCN,
    chance_loss,
    computes_bfloat16,
    cross_entropy,
    probabilities,
)

HISTORY = "history.csv"
FINE_TUNING = "fine-tuning"
# Numbers of options in glibc's malloc.h.
GLIBC_M_TRIM_THRESHOLD, GLIBC_M_MMAP_THRESHOLD = -1, -3


class PlateauError(SlipstitchError):
    """The loss stayed at chance: the network has learnt nothing."""


class DivergedError(SlipstitchError):
    """The loss is no finite number any more."""


@dataclass(frozen=True)
class Stage:
    """Epochs with the same viewpoints."""

    name: str
    viewpoints: tuple[str, ...]
    epochs: int


def schedule(settings: TrainSettings, view_order: list[str]) -> list[Stage]:
    """The progressive schedule: cycles of one, two ... viewpoints, then the first one alone."""
    stages = [
        Stage(f"cycle {count}", tuple(view_order[:count]), settings.epochs_per_cycle)
        for count in range(1, len(view_order) + 1)
    ]
    if settings.fine_tuning_epochs:
        stages.append(Stage(FINE_TUNING, (view_order[0],), settings.fine_tuning_epochs))
    return stages


def learning_rate(
    settings: TrainSettings, stages: Sequence[Stage], stage: Stage, done: float
) -> float:
    """Adadelta's rate: constant, down a cosine in the last cycle, at its end's while fine-tuning.

    Parameters
    ----------
    settings : TrainSettings
    stages : sequence of Stage
        All of the training.
    stage : Stage
        The one at work.
    done : float
        Share of it that is done, 0 ... 1.
    """
    last_cycle = [one for one in stages if one.name != FINE_TUNING][-1]
    if stage.name == FINE_TUNING:
        height = 0.0
    elif stage is last_cycle:
        height = 0.5 * (1.0 + math.cos(math.pi * done))
    else:
        height = 1.0
    lowest = settings.annealed_share
    return settings.learning_rate * (lowest + (1.0 - lowest) * height)


def names_digest(rows: list[dict[str, Any]]) -> str:
    """SHA-256 of the videos' names: which part of a dataset a training uses."""
    return hashlib.sha256("\n".join(row["video"] for row in rows).encode()).hexdigest()


def set_up_torch(threads: int) -> None:
    """Deterministic algorithms and a fixed number of threads (more of them, other roundings)."""
    torch.use_deterministic_algorithms(True)
    # Else every new tensor is filled with NaN first: an eighth of the time.
    torch.utils.deterministic.fill_uninitialized_memory = False
    _keep_freed_memory()
    torch.set_num_threads(threads)


def _keep_freed_memory() -> None:
    """Let glibc keep large blocks, of which every step takes and frees the same.

    Else the system hands them out anew, page by page: a twentieth of a step's time at 64 pixels, a
    twelfth at 112. Other C libraries are left as they are.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(GLIBC_M_MMAP_THRESHOLD, 2**30)
        set_option(GLIBC_M_TRIM_THRESHOLD, 2**31 - 1)


def classes_of(rows: list[dict[str, Any]], target: str) -> list[dict[str, Any]]:
    """The classes in manifest rows, in the order of their ids: ``{id, name | value}``.

    Raises
    ------
    BadInput
        If an id stands for two materials or coefficients.
    """
    key = "name" if target == "material" else "value"
    found = {row[f"{target}_id"]: row[target] for row in rows}
    for row in rows:
        if found[row[f"{target}_id"]] != row[target]:
            raise BadInput(
                f"{target} {row[f'{target}_id']} is {row[target]!r} in {row['video']} "
                f"and {found[row[f'{target}_id']]!r} elsewhere"
            )
    return [{"id": name, key: found[name]} for name in sorted(found)]


def labels_of(rows: list[dict[str, Any]], classes: list[dict[str, Any]], target: str) -> np.ndarray:
    """Class numbers of videos, int64 of shape (n,); BadInput for a class that is not listed."""
    number = {one["id"]: index for index, one in enumerate(classes)}
    try:
        return np.array([number[row[f"{target}_id"]] for row in rows], np.int64)
    except KeyError as unknown:
        raise BadInput(
            f"a video has {target} {unknown.args[0]}, the classes are: {', '.join(number)}"
        ) from None


def predict(
    network: LRCN,
    pixels: np.ndarray,
    condition: np.ndarray | None = None,
    *,
    bfloat16: bool = False,
    batch_size: int = 8,
) -> np.ndarray:
    """Class probabilities of videos.

    Parameters
    ----------
    network : LRCN
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
            parts.append(probabilities(logits.double()))
    return torch.cat(parts).numpy()


def predicted_materials(model: TrainedModel, videos: Videos, batch_size: int = 8) -> np.ndarray:
    """Material class numbers as the material network sees them, int64 of shape (n,)."""
    card = model.card
    shares = predict(model.network, videos.pixels, bfloat16=card["bfloat16"], batch_size=batch_size)
    return shares.argmax(1)


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
    stages: list[Stage] | None = None,
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
    split : {"by_video", "by_simulation"}
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
    stages : list of Stage, optional
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
        raise BadInput(f"no network {network_name!r}; there are: {', '.join(NETWORKS)}")
    if split not in SPLITS:
        raise BadInput(f"no split {split!r}; there are: {', '.join(SPLITS)}")
    conditional = network_name == "friction_conditional"
    listens = conditional and not true_materials
    if listens != (material_model is not None):
        raise BadInput(f"{network_name} {'needs' if listens else 'takes no'} --material-model")
    set_up_torch(threads)
    column = f"split_{split}"
    videos = read_videos(
        dataset,
        lambda row: takes_part(row) and row[column] != "test" and (uses is None or uses(row)),
        settings.pixels,
        frames,
    )
    target = network_name.split("_")[0]
    classes = classes_of(videos.rows, target)
    labels = labels_of(videos.rows, classes, target)
    training = np.array([row[column] == "train" for row in videos.rows])
    views = np.array([row["viewpoint"] for row in videos.rows])
    _check(videos, labels, classes, training, view_order, target, expected_classes)
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
    network = LRCN(settings, len(classes), pixels, len(condition_classes))
    if settings.input_scaling == "standardised":
        mean, deviation = _colour_statistics(videos.pixels[training])
    else:
        mean, deviation = np.zeros(3), np.full(3, 255.0)
    network.mean.copy_(torch.from_numpy(mean))
    network.deviation.copy_(torch.from_numpy(deviation))
    optimizer = torch.optim.Adadelta(
        network.parameters(), lr=settings.learning_rate, rho=settings.rho, eps=settings.epsilon
    )
    bfloat16 = computes_bfloat16(settings.precision)

    stages = stages or schedule(settings, view_order)
    of_epoch = [(stage, epoch) for stage in stages for epoch in range(stage.epochs)]
    out = Path(out_dir)
    checkpoint = out / CHECKPOINT
    identity = {
        "network": network_name,
        "split": split,
        "seed": seed,
        "settings": settings.model_dump(mode="json", exclude={"checkpoint_interval_s"}),
        "view_order": view_order,
        "stages": [[stage.name, *stage.viewpoints, stage.epochs] for stage in stages],
        "dataset_digest": videos.digest,
        "videos_sha256": names_digest(videos.rows),
        "condition_sha256": condition_digest,
        "true_materials": true_materials,
        "threads": threads,
        "bfloat16": bfloat16,
        "code_digest": code_digest("train"),
    }
    progress, message = load_checkpoint(checkpoint, identity, network, optimizer)
    progress = progress or Progress()
    if message:
        print(message, file=sys.stderr)
    chance = chance_loss(labels[training].tolist())
    saved_at = time.monotonic()

    bar = tqdm(
        total=len(of_epoch),
        initial=progress.epoch,
        desc=f"{network_name} {split}",
        unit="epoch",
        disable=not sys.stderr.isatty(),
    )
    while progress.epoch < len(of_epoch):
        stage, epoch_of_stage = of_epoch[progress.epoch]
        in_view = np.isin(views, stage.viewpoints)
        chosen = np.flatnonzero(training & in_view)
        order = np.random.default_rng([seed, progress.epoch]).permutation(chosen)
        network.train()
        while (first := progress.step * settings.batch_size) < len(order):
            done = (epoch_of_stage + first / len(order)) / stage.epochs
            for group in optimizer.param_groups:
                group["lr"] = learning_rate(settings, stages, stage, done)
            batch = order[first : first + settings.batch_size]
            given = None if condition is None else torch.from_numpy(condition[batch])
            truth = torch.from_numpy(labels[batch])
            logits = network(torch.from_numpy(videos.pixels[batch]), given, bfloat16)
            loss = cross_entropy(logits, truth)
            if not math.isfinite(loss.item()):
                raise DivergedError(
                    f"{network_name} {split} seed {seed}: the loss became {loss.item()} in epoch "
                    f"{progress.epoch + 1}, step {progress.step + 1}; no model is written "
                    f"(try a smaller train.learning_rate than {settings.learning_rate:g}, or "
                    "train.gradient_norm_max)"
                )
            optimizer.zero_grad()
            loss.backward()
            if settings.gradient_norm_max is not None:
                torch.nn.utils.clip_grad_norm_(network.parameters(), settings.gradient_norm_max)
            optimizer.step()
            progress.step += 1
            progress.loss_sum += loss.item() * len(batch)
            progress.correct += int((probabilities(logits).argmax(1) == truth).sum())
            if time.monotonic() - saved_at >= settings.checkpoint_interval_s:
                save_checkpoint(checkpoint, identity, progress, network, optimizer)
                saved_at = time.monotonic()
            if after_step is not None:
                after_step(progress)

        watching = np.flatnonzero(~training & in_view)
        row = {
            "epoch": progress.epoch + 1,
            "stage": stage.name,
            "viewpoints": "+".join(stage.viewpoints),
            "videos": len(order),
            "train_loss": progress.loss_sum / len(order),
            "train_accuracy": progress.correct / len(order),
            "validation_videos": len(watching),
            **_validation(network, videos, labels, condition, watching, bfloat16, settings),
            "chance_loss": chance,
        }
        progress = Progress(epoch=progress.epoch + 1, history=[*progress.history, row])
        bar.update()
        bar.set_postfix_str(
            f"{curve([past['train_loss'] for past in progress.history])} "
            f"loss {row['train_loss']:.3f}, accuracy {row['train_accuracy']:.2f}"
        )
        if bar.disable:
            print(_epoch_line(network_name, split, row, len(of_epoch)), file=sys.stderr)
        if progress.epoch in (settings.plateau_epochs, len(of_epoch)):
            _check_plateau(progress.history, chance, len(classes), network_name, split, settings)
    bar.close()

    out.mkdir(parents=True, exist_ok=True)
    write_history(progress.history, out / HISTORY)
    last = progress.history[-1]
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
            "bfloat16": bfloat16,
            "settings": settings.model_dump(mode="json"),
            "dataset_digest": videos.digest,
            "training_videos": int(training.sum()),
            "training_simulations": len(
                {r["simulation"] for r in videos.rows if r[column] == "train"}
            ),
            "epochs": len(of_epoch),
            "train_loss": last["train_loss"],
            "chance_loss": chance,
            "parameters": sum(weight.numel() for weight in network.parameters()),
            "multiply_accumulates_per_frame": network.multiply_accumulates,
            "use": "reads the class off drop-and-drag videos rendered as this dataset was; on "
            "other videos, real ones included, nothing is known of it",
        },
        out,
    )
    inputs = [Path(dataset) / "manifest.parquet"]
    inputs += [Path(dataset) / name for name in sorted({row["file"] for row in videos.rows})]
    if material_model is not None:
        inputs += [Path(material_model) / WEIGHTS, Path(material_model) / CARD]
    record = provenance_record(
        "train", inputs=inputs, config={"train": settings}, seed=seed, started=started
    )
    record["threads"] = threads
    for name in (WEIGHTS, CARD, HISTORY):
        write_sidecar(out / name, record)
    checkpoint.unlink(missing_ok=True)
    return card


def _check(videos, labels, classes, training, view_order, target, expected) -> None:
    """Refuse data that cannot train what is asked for."""
    for kind, values in (expected or {}).items():
        key = "name" if kind == "material" else "value"
        found = [one[key] for one in classes_of(videos.rows, kind)]
        if found != list(values):
            raise BadInput(
                f"the dataset has {len(found)} {kind} classes ({', '.join(map(str, found))}), "
                f"the configuration {len(values)} ({', '.join(map(str, values))})"
            )
    if len(classes) < 2:
        raise BadInput(f"{len(classes)} {target} class: there is nothing to tell apart")
    for number, one in enumerate(classes):
        if not np.any(labels[training] == number):
            raise BadInput(f"{target} class {one['id']} has no training video")
    present = {row["viewpoint"] for row in videos.rows}
    absent = [name for name in view_order if name not in present]
    if absent:
        raise BadInput(
            f"the dataset has no training viewpoint {absent[0]!r}; there are: "
            f"{', '.join(sorted(present))}"
        )
    for name in view_order:
        if not any(
            row["viewpoint"] == name and trains
            for row, trains in zip(videos.rows, training, strict=True)
        ):
            raise BadInput(f"viewpoint {name!r} has no training video")


def _colour_statistics(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each colour over all pixels, from exact integer sums."""
    count = pixels[..., 0].size
    histogram = np.stack([np.bincount(pixels[..., c].ravel(), minlength=256) for c in range(3)])
    values = np.arange(256.0)
    mean = histogram @ values / count
    variance = histogram @ values**2 / count - mean**2
    return mean, np.sqrt(np.maximum(variance, 1.0))


def _validation(network, videos, labels, condition, chosen, bfloat16, settings) -> dict[str, float]:
    """Loss and accuracy on the validation videos; NaN where there are none."""
    if not len(chosen):
        return {"validation_loss": math.nan, "validation_accuracy": math.nan}
    shares = predict(
        network,
        videos.pixels[chosen],
        None if condition is None else condition[chosen],
        bfloat16=bfloat16,
        batch_size=settings.batch_size,
    )
    right = shares[np.arange(len(chosen)), labels[chosen]]
    return {
        "validation_loss": float(-np.log(np.maximum(right, 1e-12)).mean()),
        "validation_accuracy": float((shares.argmax(1) == labels[chosen]).mean()),
    }


def _check_plateau(history, chance, classes, network_name, split, settings) -> None:
    """Fail if the loss of the last epochs, as many as a cycle has, is still that of guessing."""
    recent = history[-settings.epochs_per_cycle :]
    videos = sum(row["videos"] for row in recent)
    loss = sum(row["train_loss"] * row["videos"] for row in recent) / videos
    if settings.plateau_margin is not None and loss > (1.0 - settings.plateau_margin) * chance:
        raise PlateauError(
            f"{network_name} {split}: after {len(history)} epochs the training loss is still "
            f"{loss:.4f}, at chance ({chance:.4f} for {classes} classes): nothing was learnt, no "
            f"model is written (initialisation {settings.initialisation!r}, "
            f"train.epochs_per_cycle {settings.epochs_per_cycle})"
        )


def _epoch_line(network_name: str, split: str, row: dict[str, Any], epochs: int) -> str:
    return (
        f"{network_name} {split}: epoch {row['epoch']}/{epochs} {row['stage']}: "
        f"loss {row['train_loss']:.4f} (chance {row['chance_loss']:.4f}), accuracy "
        f"{row['train_accuracy']:.3f}, validation {row['validation_accuracy']:.3f}"
    )


def write_history(history: list[dict[str, Any]], path: Path) -> None:
    """Write the epochs as CSV, a row each, in the columns of the first one."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="") as stream:
        writer = csv.DictWriter(stream, list(history[0]))
        writer.writeheader()
        writer.writerows(history)
