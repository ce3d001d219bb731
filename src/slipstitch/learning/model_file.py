"""Trained networks on disk: weights as safetensors, model cards as JSON."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from slipstitch.base.errors import BadInput, Damaged
from slipstitch.base.provenance import atomic_path, file_digest, write_json


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
