"""Training the instrument's network, then calibrating its error bars and its alarm."""

import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from slipstitch.config.instrument import InstrumentSettings
from slipstitch.config.train import SPLITS
from slipstitch.errors import BadInput
from slipstitch.instrument.augmentation import augmented, disordered, phased, standardised
from slipstitch.instrument.calibration import calibrated
from slipstitch.instrument.distribution import mixture_cumulative, ranked_probability_score
from slipstitch.instrument.measuring import CARD, WEIGHTS, Instrument, save_instrument
from slipstitch.instrument.network import InstrumentNetwork
from slipstitch.provenance import (
    code_digest,
    provenance_record,
    start_clock,
    write_sidecar,
)
from slipstitch.sample.videos import Videos, read_videos, takes_part
from slipstitch.train.checkpoint import CHECKPOINT, Progress, load_checkpoint, save_checkpoint
from slipstitch.train.curves import curve
from slipstitch.train.network import computes_bfloat16
from slipstitch.train.training import (
    HISTORY,
    DivergedError,
    PlateauError,
    classes_of,
    labels_of,
    names_digest,
    set_up_torch,
    write_history,
)

DISORDERED = 4  # for so many videos, one is also shown in disorder


def read_training_videos(
    settings: InstrumentSettings,
    dataset: str | os.PathLike,
    split: str,
    viewpoint: str,
    frames: int,
    uses: Callable[[dict[str, Any]], bool] | None = None,
) -> tuple[Videos, np.ndarray]:
    """The videos of one viewpoint that train or calibrate, and which of them train.

    `uses` says of a manifest row whether its video may do either; by default all may.

    Raises
    ------
    BadInput
        If the dataset is damaged, leaks, or has too few frames, fabrics or coefficients.
    """
    if split not in SPLITS:
        raise BadInput(f"no split {split!r}; there are: {', '.join(SPLITS)}")
    column = f"split_{split}"
    videos = read_videos(
        dataset,
        lambda row: (
            takes_part(row)
            and row[column] != "test"
            and row["viewpoint"] == viewpoint
            and (uses is None or uses(row))
        ),
        settings.pixels,
    )
    training = np.array([row[column] == "train" for row in videos.rows])
    stored = videos.pixels.shape[1]
    if stored < frames:
        raise BadInput(f"{dataset}: videos have {stored} frames, the instrument needs {frames}")
    trained = [row for row, trains in zip(videos.rows, training, strict=True) if trains]
    for key, least in (("material", 1), ("friction", 2)):
        found = {row[key] for row in trained}
        if len(found) < least:
            raise BadInput(f"{dataset}: {len(found)} {key}(s) to train on, {least} are needed")
        absent = {row[key] for row in videos.rows} - found
        if absent:
            raise BadInput(f"{dataset}: {key} {sorted(absent)[0]} has no training video")
    largest = max(row["friction"] for row in videos.rows)
    if largest > settings.friction_max:
        raise BadInput(
            f"{dataset}: friction {largest:g} is above the grid's end, {settings.friction_max:g} "
            "(instrument.friction_max)"
        )
    return videos, training


def chance_score(friction: np.ndarray) -> float:
    """Ranked probability score, in mu, of always saying the labels' own distribution.

    Half the mean distance of two labels (Gneiting & Raftery 2007, eq. 21).
    """
    return float(abs(friction[:, None] - friction[None]).mean() / 2)


def losses(
    network: InstrumentNetwork,
    looks: torch.Tensor,
    friction: torch.Tensor,
    material: torch.Tensor,
    ordered: torch.Tensor,
    bfloat16: bool,
) -> dict[str, torch.Tensor]:
    """Mean losses of a batch whose last videos are in disorder.

    Parameters
    ----------
    looks : float tensor, shape (n, frames, side, side, 3)
    friction, material : tensor, shape (m,)
        Of the first m videos; the rest is in disorder and has none.
    ordered : float tensor, shape (n,)
        1 for the first m videos, else 0. Both kinds weigh the same.

    Returns
    -------
    dict
        ``friction`` (in mu), ``material``, ``order``; and ``median_error``, without gradient.
    """
    said = network(looks, bfloat16)
    count, spoilt = len(friction), len(ordered) - len(friction)
    cumulative = mixture_cumulative(said["friction"][:count], network.middles)
    score = ranked_probability_score(cumulative, friction, network.grid).mean()
    with torch.no_grad():
        median = network.middles[(cumulative < 0.5).sum(1).clamp(max=len(network.middles) - 1)]
    return {
        "friction": score,
        "material": torch.nn.functional.cross_entropy(said["material"][:count], material),
        "order": torch.nn.functional.binary_cross_entropy_with_logits(
            said["order"], ordered, weight=torch.where(ordered > 0, 1 / count, 1 / spoilt) / 2
        )
        * len(ordered),
        "median_error": (median - friction).abs().mean(),
    }


def learning_rate(settings: InstrumentSettings, done: float) -> float:
    """One cycle: up in the first tenth, then down a cosine; `done` in 0 ... 1."""
    if done < 0.1:
        return settings.learning_rate * (0.05 + 0.95 * done / 0.1)
    return settings.learning_rate * (0.505 + 0.495 * math.cos(math.pi * (done - 0.1) / 0.9))


def train_instrument(
    settings: InstrumentSettings,
    dataset: str | os.PathLike,
    split: str,
    seed: int,
    out_dir: str | os.PathLike,
    *,
    viewpoint: str,
    frames: int = 30,
    uses: Callable[[dict[str, Any]], bool] | None = None,
    threads: int = 1,
    after_step: Callable[[Progress], None] | None = None,
) -> dict[str, Any]:
    """Train, calibrate and write an instrument.

    Parameters
    ----------
    settings : InstrumentSettings
    dataset : path
        Folder that the sample stage wrote.
    split : {"by_video", "by_simulation"}
        Its validation videos calibrate the error bars and the alarm.
    seed : int
        Of weights, order of the videos, augmentation and dropout.
    out_dir : path
        Gets ``instrument.safetensors``, ``instrument.json``, ``history.csv`` and, until it is
        done, ``checkpoint.safetensors``.
    viewpoint : str
        Name of the one viewpoint that it measures from.
    frames : int
        Frames of a video that it sees; where the dataset has more, at a random phase in training.
    uses : callable, optional
        Says of a manifest row whether its video may train or calibrate; by default all may.
    threads : int
    after_step : callable, optional
        Called after every step with the progress; what it raises stops the training.

    Returns
    -------
    dict
        The card.

    Raises
    ------
    BadInput
        If dataset or arguments do not fit.
    PlateauError
        If the loss of the last epoch is not below chance by `settings.plateau_margin`.
    DivergedError
        If the loss is not finite.
    """
    started = start_clock()
    set_up_torch(threads)
    videos, training = read_training_videos(settings, dataset, split, viewpoint, frames, uses)
    materials = classes_of(videos.rows, "material")
    labels = torch.from_numpy(labels_of(videos.rows, materials, "material"))
    friction = torch.tensor([row["friction"] for row in videos.rows])
    chance = chance_score(friction.numpy()[training])
    bfloat16 = computes_bfloat16(settings.precision)
    torch.manual_seed(seed)
    network = InstrumentNetwork(settings, len(materials), videos.pixels.shape[2])
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=settings.weight_decay)

    out = Path(out_dir)
    checkpoint = out / CHECKPOINT
    identity = {
        "settings": settings.model_dump(mode="json", exclude={"checkpoint_interval_s"}),
        "dataset_digest": videos.digest,
        "videos_sha256": names_digest(videos.rows),
        "network": "instrument",
        "viewpoint": viewpoint,
        "frames": frames,
        "split": split,
        "seed": seed,
        "threads": threads,
        "bfloat16": bfloat16,
        "code_digest": code_digest("instrument"),
    }
    progress, message = load_checkpoint(checkpoint, identity, network, optimizer)
    progress = progress or Progress()
    if message:
        print(message, file=sys.stderr)
    saved_at = time.monotonic()
    name = f"instrument {split} seed {seed}"
    chosen = np.flatnonzero(training)
    steps = -(-len(chosen) // settings.batch_size)
    bar = tqdm(
        total=settings.epochs,
        initial=progress.epoch,
        desc=name,
        unit="epoch",
        disable=not sys.stderr.isatty(),
    )
    while progress.epoch < settings.epochs:
        order = np.random.default_rng([seed, progress.epoch]).permutation(chosen)
        network.train()
        while progress.step < steps:
            done = (progress.epoch + progress.step / steps) / settings.epochs
            for group in optimizer.param_groups:
                group["lr"] = learning_rate(settings, done)
            batch = order[progress.step * settings.batch_size :][: settings.batch_size]
            generator = np.random.default_rng([seed, progress.epoch, progress.step])
            looks, ordered = training_looks(videos.pixels[batch], frames, settings, generator)
            part = losses(network, looks, friction[batch], labels[batch], ordered, bfloat16)
            loss = (
                part["friction"] / chance
                + settings.material_weight * part["material"]
                + settings.order_weight * part["order"]
            )
            if not math.isfinite(loss.item()):
                raise DivergedError(
                    f"{name}: the loss became {loss.item()} in epoch {progress.epoch + 1}, step "
                    f"{progress.step + 1}; no instrument is written (try a smaller "
                    f"instrument.learning_rate than {settings.learning_rate:g})"
                )
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            progress.step += 1
            progress.loss_sum += part["friction"].item() * len(batch)
            progress.error_sum += part["median_error"].item() * len(batch)
            if time.monotonic() - saved_at >= settings.checkpoint_interval_s:
                save_checkpoint(checkpoint, identity, progress, network, optimizer)
                saved_at = time.monotonic()
            if after_step is not None:
                after_step(progress)
        row = {
            "epoch": progress.epoch + 1,
            "videos": len(order),
            "train_loss": progress.loss_sum / len(order),
            "train_error": progress.error_sum / len(order),
            **_validation(network, videos, frames, ~training, friction, labels, bfloat16),
            "chance_loss": chance,
        }
        progress = Progress(epoch=progress.epoch + 1, history=[*progress.history, row])
        bar.update()
        bar.set_postfix_str(
            f"{curve([past['train_loss'] for past in progress.history])} "
            f"loss {row['train_loss']:.4f} of {chance:.4f}, error {row['validation_error']:.3f}"
        )
        if bar.disable:
            print(_epoch_line(name, row, settings.epochs), file=sys.stderr)
    bar.close()
    last = progress.history[-1]
    if settings.plateau_margin is not None and (
        last["train_loss"] > (1.0 - settings.plateau_margin) * chance
    ):
        raise PlateauError(
            f"{name}: after {settings.epochs} epochs the training loss is still "
            f"{last['train_loss']:.4f}, at chance ({chance:.4f}): nothing was learnt, no "
            "instrument is written (instrument.epochs, instrument.learning_rate)"
        )

    card = {
        "materials": [one["name"] for one in materials],
        "frames": frames,
        "pixels": network.pixels,
        "bfloat16": bfloat16,
        "viewpoint": viewpoint,
        "split": split,
        "seed": seed,
        "settings": settings.model_dump(mode="json"),
        "dataset_digest": videos.digest,
        "frictions": sorted({row["friction"] for row in videos.rows}),
        "training_videos": int(training.sum()),
        "training_simulations": len(_simulations(videos, training)),
        "calibration_simulations": len(_simulations(videos, ~training)),
        "epochs": settings.epochs,
        "train_loss": last["train_loss"],
        "chance_loss": chance,
        "parameters": sum(weight.numel() for weight in network.parameters()),
        "multiply_accumulates_per_frame": network.multiply_accumulates,
        "use": "measures friction in drop-and-drag videos seen as this dataset's are; elsewhere "
        "its alarm says so, and its intervals promise nothing",
    }
    instrument = calibrated(Instrument(network, card, None), videos, training)
    out.mkdir(parents=True, exist_ok=True)
    write_history(progress.history, out / HISTORY)
    card = save_instrument(instrument, out)
    inputs = [Path(dataset) / "manifest.parquet"]
    inputs += [Path(dataset) / file for file in sorted({row["file"] for row in videos.rows})]
    record = provenance_record(
        "instrument", inputs=inputs, config={"instrument": settings}, seed=seed, started=started
    )
    record["threads"] = threads
    for file in (WEIGHTS, CARD, HISTORY):
        write_sidecar(out / file, record)
    checkpoint.unlink(missing_ok=True)
    return card


def _simulations(videos: Videos, chosen: np.ndarray) -> set[str]:
    return {row["simulation"] for row, use in zip(videos.rows, chosen, strict=True) if use}


def training_looks(
    pixels: np.ndarray, frames: int, settings: InstrumentSettings, generator: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Augmented videos at random phase, then some of them in disorder; and which are in order."""
    videos = phased(pixels, frames, generator)
    spoilt = videos[generator.permutation(len(videos))[: max(1, len(videos) // DISORDERED)]]
    spoilt = np.stack([disordered(video, generator) for video in spoilt])
    whole = np.concatenate([videos, spoilt])
    ordered = (torch.arange(len(whole)) < len(videos)).float()
    return augmented(whole, settings, generator), ordered


def _validation(network, videos, frames, chosen, friction, labels, bfloat16) -> dict[str, float]:
    """Loss, error and accuracy on the videos that do not train; NaN where there are none."""
    indices = np.flatnonzero(chosen)
    if not len(indices):
        names = ("videos", "loss", "error", "accuracy")
        return {f"validation_{name}": math.nan for name in names}
    network.eval()
    scores, errors, hits = [], [], []
    with torch.inference_mode():
        for batch in np.array_split(indices, -(-len(indices) // 8)):
            looks = standardised(phased(videos.pixels[batch], frames, None))
            said = network(looks, bfloat16)
            cumulative = mixture_cumulative(said["friction"], network.middles)
            scores.append(ranked_probability_score(cumulative, friction[batch], network.grid))
            median = network.grid[(cumulative < 0.5).sum(1)]
            errors.append((median - friction[batch]).abs())
            hits.append((said["material"].argmax(1) == labels[batch]).float())
    return {
        "validation_videos": len(indices),
        "validation_loss": float(torch.cat(scores).mean()),
        "validation_error": float(torch.cat(errors).mean()),
        "validation_accuracy": float(torch.cat(hits).mean()),
    }


def _epoch_line(name: str, row: dict[str, Any], epochs: int) -> str:
    return (
        f"{name}: epoch {row['epoch']}/{epochs}: loss {row['train_loss']:.4f} "
        f"(chance {row['chance_loss']:.4f}), error {row['train_error']:.3f}, "
        f"validation loss {row['validation_loss']:.4f}, error {row['validation_error']:.3f}, "
        f"material {row['validation_accuracy']:.2f}"
    )
