"""Checkpoints: the complete state, to resume a training with identical results.

One safetensors file with the weights, the optimiser's memory and the state of the random numbers,
and JSON for the rest. Nothing in it is pickled: reading one cannot run anything.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from slipstitch.base.provenance import atomic_path, count_earlier_attempts, start_clock

CHECKPOINT = "checkpoint.safetensors"


@dataclass
class Progress:
    """Progress of a training: finished epochs, steps of the current one and its sums."""

    draws: int = 1  # of the initial weights
    epoch: int = 0
    step: int = 0
    # losses and other columns of the history, summed over the current epoch's videos so far
    sums: dict[str, float] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)  # one row per finished epoch
    kept: dict[str, torch.Tensor] = field(default_factory=dict)  # weights before the last phase


def save_checkpoint(
    path: Path,
    identity: dict[str, Any],
    progress: Progress,
    network: nn.Module,
    optimizer: torch.optim.Optimizer,
    started: tuple[float, float],
) -> None:
    """Write everything, atomically, and the time that the training took so far.

    `identity` says which training this is; only the same one may continue from the file.
    `started` is what `start_clock` returned before `load_checkpoint`.
    """
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    for number, memory in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{number}.{name}": value for name, value in memory.items()}
    tensors |= {f"kept.{name}": value for name, value in progress.kept.items()}
    tensors["random"] = torch.get_rng_state()
    tensors = {name: value.contiguous() for name, value in tensors.items()}
    notes = {
        "identity": json.dumps(identity, sort_keys=True),
        "progress": json.dumps(asdict(replace(progress, kept={}))),
    }
    taken_s = [now - then for now, then in zip(start_clock(), started, strict=True)]
    notes["taken_s"] = json.dumps(taken_s)  # wall and CPU
    notes["sha256"] = _digest(notes, tensors)
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, notes)


def _digest(notes: dict[str, str], tensors: dict[str, torch.Tensor]) -> str:
    """SHA-256 of everything: a flipped bit must restart a training, not distort it."""
    digest = hashlib.sha256(json.dumps(notes, sort_keys=True).encode())
    for name, value in sorted(tensors.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        digest.update(value.detach().contiguous().numpy().tobytes())
    return digest.hexdigest()


def load_checkpoint(
    path: Path, identity: dict[str, Any], network: nn.Module, optimizer: torch.optim.Optimizer
) -> tuple[Progress, str]:
    """Put a training back where a checkpoint left it, and count the time that it took until then.

    Returns the progress, that of a start if there is nothing to go on from (network, optimiser and
    random numbers are untouched then), and what happened, to be shown; empty if there is no
    checkpoint.
    """
    if not path.is_file():
        return Progress(), ""
    try:
        with safe_open(path, "pt") as file:
            notes = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        if notes.pop("sha256") != _digest(notes, tensors):
            raise ValueError("damaged")
        progress = Progress(**json.loads(notes["progress"]))
        same = json.loads(notes["identity"]) == json.loads(json.dumps(identity))
        wall_s, cpu_s = json.loads(notes["taken_s"])
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        return Progress(), f"{path}: no readable checkpoint; starting from scratch"
    if not same:
        why = "from another training (data, settings or code differ)"
        return Progress(), f"{path}: {why}; starting from scratch"
    weights, progress.kept = (
        {name.removeprefix(of): value for name, value in tensors.items() if name.startswith(of)}
        for of in ("network.", "kept.")
    )
    network.load_state_dict(weights)
    memory: dict[int, dict[str, torch.Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, number, key = name.split(".")
            # As the running optimiser lays it out: beside the channels-last convolutions.
            layout = torch.channels_last if value.dim() == 4 else torch.contiguous_format
            memory.setdefault(int(number), {})[key] = value.to(memory_format=layout)
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": memory, "param_groups": groups})
    torch.set_rng_state(tensors["random"])
    count_earlier_attempts(wall_s, cpu_s)
    return progress, f"continuing from {path}: epoch {progress.epoch + 1}, step {progress.step + 1}"
