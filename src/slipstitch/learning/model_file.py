"""Networks on disk: trained ones, and checkpoints to resume a training with identical results.

Weights are safetensors, model cards JSON, checkpoints of torch: reading one cannot run anything.
"""

import json
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import (
    atomic_path,
    count_earlier_attempts,
    file_digest,
    start_clock,
    write_json,
)


def write_weights(
    tensors: dict[str, torch.Tensor], card: dict[str, Any], weights: Path, card_path: Path
) -> dict[str, Any]:
    """Write tensors and their card; return the card as written.

    The card stands inside the weights file too, and outside with the weights' SHA-256.
    """
    weights.parent.mkdir(parents=True, exist_ok=True)
    whole = {name: value.contiguous() for name, value in tensors.items()}
    with atomic_path(weights) as temporary:
        save_file(whole, temporary, {"card": json.dumps(card, sort_keys=True)})
    written = {**card, "weights_sha256": file_digest(weights)}
    write_json(card_path, written, allow_nan=True)
    return written


def read_weights(
    weights: Path, card_path: Path, form: str
) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Tensors and card that `write_weights` wrote; BadInput unless they are, in format `form`."""
    for path in (weights, card_path):
        if not path.is_file():
            raise BadInput(
                f"{path}: no such file; a model consists of {weights.name} and {card_path.name}"
            )
    try:
        card = json.loads(card_path.read_text(encoding="utf-8-sig"))
        known = card["format"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise Damaged(card_path, "not a model card of Slipstitch") from None
    if known != form:
        raise BadInput(f"{card_path}: model format {known!r}, {form!r} is needed")
    if file_digest(weights) != card.get("weights_sha256"):
        raise Damaged(weights, f"altered or damaged: not the weights described by {card_path.name}")
    try:
        with safe_open(weights, "pt") as file:
            inside = json.loads(file.metadata()["card"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, KeyError, TypeError, ValueError):
        raise Damaged(weights, "not a model of Slipstitch") from None
    if inside != {key: value for key, value in card.items() if key != "weights_sha256"}:
        raise Damaged(card_path, f"altered: differs from the card inside {weights.name}")
    return tensors, card


CHECKPOINT = "checkpoint.pt"


@dataclass
class Progress:
    """Progress of a training: finished epochs, steps of the current one and its sums."""

    epoch: int = 0
    step: int = 0
    # losses and other columns of the history, summed over the current epoch's videos so far
    sums: dict[str, float] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)  # one row per finished epoch


def save_checkpoint(
    path: Path,
    identity: dict[str, Any],
    progress: Progress,
    network: nn.Module,
    optimizer: torch.optim.Optimizer,
    started: tuple[float, float],
) -> None:
    """Write everything of the training that `identity` names, with the time since `started`."""
    state = {
        "identity": json.dumps(identity, sort_keys=True),
        "progress": asdict(progress),
        "taken_s": [now - then for now, then in zip(start_clock(), started, strict=True)],
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "random": torch.get_rng_state(),
    }
    with atomic_path(path) as temporary:
        torch.save(state, temporary)


def load_checkpoint(
    path: Path, identity: dict[str, Any], network: nn.Module, optimizer: torch.optim.Optimizer
) -> tuple[Progress | None, str]:
    """Put a training back where a checkpoint left it, and count the time that it took until then.

    Returns the progress, None if there is nothing to go on from, and what is to be shown.
    """
    if not path.is_file():
        return None, ""
    try:
        # A flipped bit must restart a training, not distort it; torch does not look for one.
        with zipfile.ZipFile(path) as file:
            if file.testzip() is not None:
                raise ValueError("damaged")
        state = torch.load(path, weights_only=True)  # data alone
        progress, (wall_s, cpu_s) = Progress(**state["progress"]), state["taken_s"]
    except Exception:  # whatever a damaged file makes of both readers
        return None, f"{path}: no readable checkpoint; starting from scratch"
    if state["identity"] != json.dumps(identity, sort_keys=True):
        what = "from another training (data, settings or code differ)"
        return None, f"{path}: {what}; starting from scratch"
    network.load_state_dict(state["network"])
    optimizer.load_state_dict(state["optimizer"])
    torch.set_rng_state(state["random"])
    count_earlier_attempts(wall_s, cpu_s)
    return progress, f"continuing from {path}: epoch {progress.epoch + 1}, step {progress.step + 1}"
