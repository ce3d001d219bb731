"""Models for tests of what surrounds them."""

from pathlib import Path

import torch

from slipstitch.config import Config
from slipstitch.config.train import InstrumentSettings
from slipstitch.dataset.videos import Videos, read_videos
from slipstitch.design.trainable import trainings
from slipstitch.learning.instrument.measuring import Instrument
from slipstitch.learning.instrument.network import InstrumentNetwork
from slipstitch.learning.lrcn_training import train_network
from slipstitch.learning.trainer import Run


def untrained_instrument(
    pixels: int = 32, materials=("denim", "felt"), frames: int = 6, **changes
) -> Instrument:
    """An instrument of random weights: well formed, knows nothing, always raises its alarm."""
    settings = InstrumentSettings(**{"channels": [8, 8, 8], "draws": 1} | changes)
    torch.manual_seed(0)
    network = InstrumentNetwork(settings, len(materials), pixels)
    network.eval()
    card = {"materials": list(materials), "frames": frames, "pixels": pixels, "bfloat16": False}
    card |= {"settings": settings.model_dump(mode="json"), "dataset_digest": None, "seed": 0}
    return Instrument((network,), card, None)


def train_networks(config: Config, folder: Path, split: str) -> Path:
    """Train the paper's networks on a split of ``sample``; the folder ``train/<split>`` of all."""
    networks = folder / "train" / split
    material = networks / "material_baseline/seed0"
    for network, _ in trainings(config.train, split):
        run = Run(folder / "sample", split, 0, networks / network / "seed0")
        told = {"material_model": material} if network == "friction_conditional" else {}
        train_network(config.train, run, network, config.render.viewpoints, **told)
    return networks


def held_out(dataset: Path, side: str = "test") -> Videos:
    """Videos of simulations that do not train, from the measuring viewpoint."""
    return read_videos(
        dataset, lambda row: row["split_by_simulation"] == side and row["viewpoint"] == "calibrated"
    )
